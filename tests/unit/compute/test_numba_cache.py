"""The on-disk cache of compiled functions."""

import os
import pathlib

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


@pytest.mark.parametrize("is_open", [False, True], ids=["private", "open to others"])
def test_without_a_writable_cache_the_home_is_used_unless_others_can_write_there(tmp_path, monkeypatch, is_open):
    """A read-only checkout, and a user without a cache folder."""
    import numba
    from numba.core import caching

    from deltasafe.compute import numba_cache

    monkeypatch.setattr(caching.CacheImpl, "_locator_classes", [caching.UserProvidedCacheLocator])
    for name, value in {"NUMBA_CACHE_DIR": "", "DELTASAFE_HOME": str(tmp_path)}.items():
        monkeypatch.setenv(name, value)
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    monkeypatch.setattr(numba_cache.tempfile, "gettempdir", lambda: str(tmp_path / "temporary"))
    if is_open:
        (tmp_path / "cache" / "numba").mkdir(parents=True)
        (tmp_path / "cache" / "numba").chmod(0o777)
    dispatcher = numba_cache.compiled(lambda x: x + 1)
    used = pathlib.Path(dispatcher._cache._cache_path)
    expected = tmp_path / "temporary" if is_open else tmp_path / "cache" / "numba"
    assert used.is_relative_to(expected)
    assert os.environ["NUMBA_CACHE_DIR"], "for the processes of this one"
