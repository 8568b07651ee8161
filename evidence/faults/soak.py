"""A hundred runs one after another in one process: memory, open files and threads stay what they were.

A run materialises what is cheap of the chain, with the project's definitions, I/O manager, tracker and registry:
labelled images, an augmented set, a calibration report, the ensemble in use, a scene, its field and a motion. Dagster
and MLflow write to databases of their own.
"""

import contextlib
import ctypes
import dataclasses
import gc
import os
import pathlib
import statistics
import sys
import tempfile
from collections.abc import Iterator, Sequence
from typing import Any

from deltasafe.progress import Progress, silent
from evidence.faults.reporting import conclude, parser, progress_every

__all__ = ["Usage", "growth", "main", "prepared_home", "soak"]

ASSETS = (
    "raw_hands",
    "test_hands",
    "augmented_hands",
    "calibration_report",
    "champion",
    "logged_scenes",
    "occupancy_fields",
    "planned_motions",
)
MOST_GROWTH = 0.05
SHARE = 10
"""The first and the last tenth are compared."""


@dataclasses.dataclass(frozen=True)
class Usage:
    """Of this process: resident memory once what is free has gone back, open file descriptors, threads."""

    rss_bytes: int
    files: int
    threads: int

    @classmethod
    def now(cls) -> "Usage":
        """After a collection; what the allocator keeps for later is given back first, for it is not held by anybody."""
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # glibc alone keeps what was freed
            ctypes.CDLL(None).malloc_trim(0)
        pages = int(pathlib.Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
        files, threads = (len([*pathlib.Path("/proc/self", kind).iterdir()]) for kind in ("fd", "task"))
        return cls(pages * os.sysconf("SC_PAGE_SIZE"), files, threads)


def growth(usages: Sequence[Usage]) -> tuple[float, int]:
    """Of memory, as a fraction, and of files and threads together: medians of the last tenth against the first."""
    count = max(1, len(usages) // SHARE)
    first, last = usages[:count], usages[-count:]

    def median(of: Sequence[Usage], name: str) -> float:
        return statistics.median(getattr(usage, name) for usage in of)

    handles = sum(median(last, name) - median(first, name) for name in ("files", "threads"))
    return median(last, "rss_bytes") / median(first, "rss_bytes") - 1, round(handles)


@contextlib.contextmanager
def prepared_home() -> Iterator[pathlib.Path]:
    """A home with images, members and a frozen ensemble, none of which was trained; it goes at the end."""
    import dagster as dg

    from evidence.faults.ensemble import free_ensemble
    from evidence.faults.sets import tiny_hands
    from pipelines.home import prepare_home
    from pipelines.io import FolderPointers
    from pipelines.tracking import MlflowTracker

    with tempfile.TemporaryDirectory(prefix="deltasafe-faults-") as name:
        os.environ["DELTASAFE_HOME"] = name
        home = prepare_home()
        tiny_hands(home / "hands")
        tiny_hands(home / "test", "test")
        members, frozen = free_ensemble(home / "made")
        pointers = FolderPointers(home=str(home))
        for index, member in enumerate(members):
            pointers.point(dg.AssetKey("ensemble_member"), member, f"member_{index:02d}")
        pointers.point(dg.AssetKey("frozen_ensemble"), frozen)
        MlflowTracker(home).register("f" * 64, frozen)
        yield home


def soak(home: pathlib.Path, runs: int, warm_up: int, progress: Progress = silent) -> tuple[list[Usage], int]:
    """Usage after each of the ``runs`` that follow ``warm_up`` runs, and how many assets were materialised in them.

    Raises:
        RuntimeError: a run failed.
    """
    import dagster as dg

    from pipelines.build import build_defs

    job = build_defs(home).resolve_implicit_global_asset_job_def()
    usages, materialised = [], 0
    with dg.DagsterInstance.get() as instance:
        for number in range(warm_up + runs):
            result = job.execute_in_process(
                instance=instance, asset_selection=[dg.AssetKey(name) for name in ASSETS], run_config=_config(home)
            )
            if not result.success:
                raise RuntimeError(f"run {number + 1} failed")
            if number >= warm_up:
                usages.append(Usage.now())
                materialised += len(result.get_asset_materialization_events())
                memory = f"{usages[-1].rss_bytes / 2**20:.1f} MiB"
                progress(len(usages), runs, f"{memory}, {usages[-1].files} files, {usages[-1].threads} threads")
            del result
    return usages, materialised


def _config(home: pathlib.Path) -> dict[str, Any]:
    steps = {
        "raw_hands": {"folder": str(home / "hands")},
        "test_hands": {"folder": str(home / "test")},
        "augmented_hands": {"augmentation": {"n_variants": 2, "width": 64, "height": 48}, "workers": 1},
        "calibration_report": {"calibration": {"n_folds": 2, "n_bootstrap": 100}},
        "logged_scenes": {"n_scenes": 1},
        "planned_motions": {"motion": {"n_iterations": 300}},
    }
    return {
        "ops": {name: {"config": config} for name, config in steps.items()},
        "loggers": {"console": {"config": {"log_level": "ERROR"}}},
    }


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.soak``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=100, help="runs that are measured (default 100)")
    made.add_argument("--warm-up", type=int, default=20, help="runs before them (default 20)")
    options = made.parse_args(arguments)
    os.environ["DELTASAFE_PRESET"] = "smoke"
    with prepared_home() as home:
        usages, materialised = soak(home, options.count, options.warm_up, progress_every(10))
    grown, handles = growth(usages)
    failures = [f"memory grew by {grown:.1%}"] if grown >= MOST_GROWTH else []
    failures += [f"{handles} more open files and threads"] if handles > 0 else []
    figures = {
        "soak_runs": len(usages),
        "soak_materialisations": materialised,
        "soak_growth": grown,
        "soak_growth_mib": (usages[-1].rss_bytes - usages[0].rss_bytes) / 2**20,
        "soak_handles_growth": handles,
    }
    return conclude("soak", figures, options, failures)


if __name__ == "__main__":
    sys.exit(main())
