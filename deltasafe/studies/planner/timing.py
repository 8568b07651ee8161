"""Fig. 6: time of a search over the number of obstacles, without and with building the field."""

import dataclasses
import pathlib
import time

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.studies.baselines import GaussianCheckSettings
from deltasafe.studies.planner.methods import build_field, build_test, run_search
from deltasafe.studies.planner.scenes import crowded_scene
from deltasafe.studies.planner.settings import TimingSettings
from deltasafe.studies.resumable_jobs import Batch, Effort, run_batches
from deltasafe.studies.stored_runs import load_runs, save_runs

Array = NDArray[np.float64]

TIMED = (
    "ours_few",
    "ours",
    "ours_continuous",
    "chance_constraint",
    "bounding_volume",
    "max_probability_numeric",
    "max_probability",
    "chance_constraint_culled",
    "bounding_volume_culled",
    "max_probability_culled",
)
"""Our method with the smaller N_x, with N_x, and with the continuous test. The others evaluate their formula for every
obstacle at every pose; with the suffix ``culled`` they skip far obstacles. ``numeric`` searches the multiplier
numerically although a closed form exists."""


@dataclasses.dataclass(frozen=True)
class Timing:
    """All runs of Fig. 6.

    Attributes:
        settings: of the study.
        seconds: (counts, methods, runs) CPU time of a search.
        n_nodes: (counts, methods, runs) nodes of its tree.
        field_s: (counts,) CPU time of building the field: the grid from the spheres, and its distances.
        effort: time spent.
    """

    settings: TimingSettings
    seconds: Array
    n_nodes: Array
    field_s: Array
    effort: Effort

    def median_s(self, name: str) -> Array:
        """Compute the median (counts,) over runs."""
        return np.asarray(np.median(self.seconds[:, TIMED.index(name)], axis=1))

    def save(self, folder: str | pathlib.Path) -> None:
        """Write runs.npz and study.json atomically."""
        arrays = {"seconds": self.seconds, "n_nodes": self.n_nodes, "field_s": self.field_s}
        save_runs(folder, self.settings, arrays, self.effort)

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Timing":
        """Read a folder that ``save`` wrote.

        Raises:
            DataError: a file is missing or has other content.
        """
        settings, arrays, effort = load_runs(folder, TimingSettings, _shapes)
        return cls(settings, **arrays, effort=effort)


def _shapes(settings: TimingSettings) -> dict[str, tuple[int, ...]]:
    runs = (len(settings.counts), len(TIMED), settings.n_runs)
    return {"seconds": runs, "n_nodes": runs, "field_s": runs[:1]}


def run_timing(
    settings: TimingSettings,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> Timing:
    """Run or resume the measurement; each batch in ``folder`` is one number of obstacles.

    Times are CPU times of one thread. More ``workers`` than idle cores distort them.
    """
    jobs = [(f"spheres-{count:03d}", (settings, count)) for count in settings.counts]
    batches, effort = run_batches(_time_count, jobs, folder, workers, progress, executor=executor)
    stacked = {name: np.stack([batch[name] for batch in batches]) for name in _shapes(settings)}
    return Timing(settings, **stacked, effort=effort)


def _check(name: str, settings: TimingSettings) -> GaussianCheckSettings | None:
    """Return the settings of a timed method; None is our method."""
    if name.startswith("ours"):
        return None
    method = name.removesuffix("_culled").removesuffix("_numeric")
    return GaussianCheckSettings(
        method,
        settings.delta,
        "boole" if method == "chance_constraint" else "each",
        delta_p_m=settings.delta_p_m,
        cull=name.endswith("_culled"),
        numeric_search=name.endswith("_numeric"),
    )


def _time_count(settings: TimingSettings, count: int) -> Batch:
    """Time all methods in turn in a scene of ``count`` spheres, so that load on the machine affects all alike."""
    shapes = crowded_scene(count, settings.scene_seed, settings.radius_m).shapes
    build_field(shapes[:1], settings.level_m, settings)  # compile before the clock starts
    started_s = time.thread_time()
    field = build_field(shapes, settings.level_m, settings)
    field_s = time.thread_time() - started_s
    few = dataclasses.replace(settings, n_samples=settings.few_samples)
    constraints = [
        build_test(
            _check(name, settings),
            shapes,
            field,
            settings.level_m / 2,
            few if name == "ours_few" else settings,
            "continuous" if name == "ours_continuous" else "sampled",
        )
        for name in TIMED
    ]
    seconds, nodes = np.empty((2, len(TIMED), settings.n_runs))
    for constraint in constraints:
        run_search(constraint, "root", settings, 0)  # compile before the clock starts
    for run in range(settings.n_runs):
        for index, constraint in enumerate(constraints):
            started_s = time.thread_time()
            tree = run_search(constraint, "root", settings, run)
            seconds[index, run] = time.thread_time() - started_s
            nodes[index, run] = len(tree.nodes)
    return {"seconds": seconds, "n_nodes": nodes, "field_s": np.array(field_s)}
