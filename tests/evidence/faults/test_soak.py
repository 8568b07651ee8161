"""``evidence.faults.soak`` with few runs, and leaks that it must detect."""

import os
import pathlib
import sys
import threading

import pytest

from evidence.faults.soak import ASSETS, Usage, growth, prepared_home, soak

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")
MIB = 2**20


@pytest.mark.filterwarnings("ignore")  # raised by MLflow and Dagster themselves
def test_repeated_runs_do_not_grow(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, "")  # the soak overwrites both; this restores them
    with prepared_home() as home:
        usages, materialized = soak(home, runs=3, warm_up=2)
    assert materialized == 3 * len(ASSETS)
    grown, handles = growth(usages)
    assert handles <= 0
    assert grown < 0.05


def test_usage_measures_memory_files_and_threads(tmp_path: pathlib.Path) -> None:
    before, stop = Usage.now(), threading.Event()
    kept = [os.urandom(8 * MIB) for _ in range(8)]
    thread = threading.Thread(target=stop.wait)
    thread.start()
    with (tmp_path / "file").open("w"):
        after = Usage.now()
    stop.set()
    thread.join()
    assert after.rss_bytes - before.rss_bytes > 0.9 * 64 * MIB
    assert (after.files, after.threads) == (before.files + 1, before.threads + 1)
    del kept
    assert Usage.now().rss_bytes - before.rss_bytes < 32 * MIB


def test_growth_compares_last_tenth_with_first_tenth_and_ignores_outliers() -> None:
    steady = [Usage(100 * MIB, 10, 4) for _ in range(100)]
    assert growth(steady) == (0.0, 0)
    peak = [*steady[:-1], Usage(900 * MIB, 10, 4)]
    assert growth(peak) == (0.0, 0)
    leaking = [Usage(100 * MIB + n * MIB // 10, 10 + n // 20, 4) for n in range(100)]
    grown, handles = growth(leaking)
    assert 0.08 < grown < 0.1
    assert handles == 4
