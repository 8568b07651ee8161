"""The on-disk cache of compiled functions."""

import pytest

from deltasafe.compute import numba_cache


def test_cache_with_unknown_types_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    """A script may define a constraint type that other processes cannot import."""

    def fail(self: object) -> None:
        raise ModuleNotFoundError("No module named 'a_script'")

    monkeypatch.setattr(numba_cache.caching.IndexDataCacheFile, "_load_index", fail)
    assert numba_cache.compiled(_double)(2.5) == 5.0


def _double(value):  # type: ignore[no-untyped-def]
    return 2 * value
