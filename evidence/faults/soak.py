"""Run a hundred runs in sequence in one process: memory, open files and threads must not grow.

A run materializes the cheap assets of the chain with the project's definitions, I/O manager, tracker and registry.
Dagster and MLflow write to their own databases.
"""

import contextlib
import ctypes
import dataclasses
import gc
import os
import pathlib
import statistics
import sys
from collections.abc import Iterator, Sequence
from typing import Any

from deltasafe.compute.progress import Progress, silent
from evidence.reporting import command_parser, finish, print_progress

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
MAX_GROWTH = 0.05


@dataclasses.dataclass(frozen=True)
class Usage:
    """Resources of this process: resident memory, open file descriptors and threads."""

    rss_bytes: int
    files: int
    threads: int

    @classmethod
    def now(cls) -> "Usage":
        """Measure after a garbage collection, with the memory that the allocator caches returned to the system."""
        gc.collect()
        with contextlib.suppress(OSError, AttributeError):  # only glibc has malloc_trim
            ctypes.CDLL(None).malloc_trim(0)
        pages = int(pathlib.Path("/proc/self/statm").read_text(encoding="utf-8").split()[1])
        files, threads = (len([*pathlib.Path("/proc/self", kind).iterdir()]) for kind in ("fd", "task"))
        return cls(pages * os.sysconf("SC_PAGE_SIZE"), files, threads)


def growth(usages: Sequence[Usage]) -> tuple[float, int]:
    """Compare medians of the last tenth of the runs with those of the first tenth.

    Returns the relative growth of memory, and the growth of files plus threads.
    """
    count = max(1, len(usages) // 10)

    def medians(name: str) -> tuple[float, float]:
        values = [getattr(usage, name) for usage in usages]
        return statistics.median(values[:count]), statistics.median(values[-count:])

    (first_bytes, last_bytes), files, threads = (medians(name) for name in ("rss_bytes", "files", "threads"))
    return last_bytes / first_bytes - 1, round(files[1] - files[0] + threads[1] - threads[0])


@contextlib.contextmanager
def prepared_home() -> Iterator[pathlib.Path]:
    """Create a temporary home with images, untrained members and a frozen ensemble."""
    import dagster as dg

    from evidence.fixtures import background_ensemble, temporary_home, tiny_hands
    from pipelines.home import prepare_home
    from pipelines.storage.io_manager import FolderPointers
    from pipelines.tracking.tracker import MlflowTracker

    with temporary_home() as folder:
        os.environ["DELTASAFE_HOME"] = str(folder)
        home = prepare_home()
        tiny_hands(home / "hands")
        tiny_hands(home / "test", "test")
        frozen = background_ensemble(home / "made")
        pointers = FolderPointers(home=str(home))
        for index, member in enumerate(sorted((home / "made").glob("member-*"))):
            pointers.point(dg.AssetKey("ensemble_member"), member, f"member_{index:02d}")
        pointers.point(dg.AssetKey("frozen_ensemble"), frozen)
        MlflowTracker(home).register("f" * 64, frozen)
        yield home


def soak(home: pathlib.Path, runs: int, warm_up: int, progress: Progress = silent) -> tuple[list[Usage], int]:
    """Return the usage after each of ``runs`` runs that follow ``warm_up`` runs, and their number of materializations.

    Raises:
        RuntimeError: a run failed.
    """
    import dagster as dg

    from pipelines.build import build_defs

    job = build_defs(home).resolve_implicit_global_asset_job_def()
    selection, usages, materialized = [dg.AssetKey(name) for name in ASSETS], [], 0
    with dg.DagsterInstance.get() as instance:
        for number in range(warm_up + runs):
            result = job.execute_in_process(instance=instance, asset_selection=selection, run_config=_config(home))
            if not result.success:
                raise RuntimeError(f"run {number + 1} failed")
            if number >= warm_up:
                usages.append(Usage.now())
                materialized += len(result.get_asset_materialization_events())
                memory = f"{usages[-1].rss_bytes / 2**20:.1f} MiB"
                progress(len(usages), runs, f"{memory}, {usages[-1].files} files, {usages[-1].threads} threads")
            del result
    return usages, materialized


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
    """Run ``python -m evidence.faults.soak``."""
    parser = command_parser("faults.soak", __doc__)
    parser.add_argument("--count", type=int, default=100, help="runs that are measured (default 100)")
    parser.add_argument("--warm-up", type=int, default=20, help="runs before them (default 20)")
    options = parser.parse_args(arguments)
    os.environ["DELTASAFE_PRESET"] = "smoke"
    with prepared_home() as home:
        usages, materialized = soak(home, options.count, options.warm_up, print_progress(10))
    memory, handles = growth(usages)
    failures = [f"memory grew by {memory:.1%}"] if memory >= MAX_GROWTH else []
    failures += [f"{handles} more open files and threads"] if handles > 0 else []
    figures = {
        "soak_runs": len(usages),
        "soak_materialisations": materialized,
        "soak_growth": memory,
        "soak_growth_mib": (usages[-1].rss_bytes - usages[0].rss_bytes) / 2**20,
        "soak_handles_growth": handles,
    }
    return finish(options, figures, failures)


if __name__ == "__main__":
    sys.exit(main())
