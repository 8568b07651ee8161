"""Fig. 6: time of a search over the number of obstacles, the field given and the field built."""

import dataclasses
import pathlib
import time

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.studies.baselines import GaussianCheckSettings
from deltasafe.studies.planner.methods import constraint_of, field_of, search
from deltasafe.studies.planner.scenes import crowded_scene
from deltasafe.studies.planner.settings import TimingSettings
from deltasafe.studies.resumable_jobs import Batch, Effort, run_batches

__all__ = ["TIMED", "Timing", "measure_times"]

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
"""Our method with the smaller N_x, with N_x, and continuous; the others with their formula asked for every obstacle
at every pose, and with far obstacles culled. ``numeric`` searches the multiplier that has a closed form."""


@dataclasses.dataclass(frozen=True)
class Timing:
    """All runs of Fig. 6.

    Attributes:
        settings: of the study.
        seconds: (counts, contenders, runs) CPU time of a search.
        n_nodes: the same of the nodes of its tree.
        field_s: (counts,) CPU time of the field: the grid from the spheres, and its distances.
        effort: what it took.
    """

    settings: TimingSettings
    seconds: Array
    n_nodes: Array
    field_s: Array
    effort: Effort

    def median_s(self, name: str) -> Array:
        """(counts,) median over runs."""
        return np.asarray(np.median(self.seconds[:, TIMED.index(name)], axis=1))

    def save(self, folder: str | pathlib.Path) -> None:
        """Write all runs and what they were made with, as a whole."""
        with atomic_folder(folder) as temporary:
            np.savez_compressed(
                temporary / "runs.npz", seconds=self.seconds, n_nodes=self.n_nodes, field_s=self.field_s
            )
            write_json(temporary / "study.json", {"settings": self.settings, **dataclasses.asdict(self.effort)})

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Timing":
        """Read what ``save`` wrote.

        Raises:
            DataError: a file is missing, or holds something else.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "study.json")
        try:
            settings = TimingSettings(**{**record["settings"], "counts": tuple(record["settings"]["counts"])})
            effort = Effort(record["minutes"], record["cpu_minutes"])
            with (folder / "runs.npz").open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
                found = cls(settings, arrays["seconds"], arrays["n_nodes"], arrays["field_s"], effort)
        except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
            raise DataError(folder, f"holds no measured times of this version ({error})") from error
        shape = (len(settings.counts), len(TIMED), settings.n_runs)
        if found.seconds.shape != shape:
            raise DataError(folder, f"holds runs of shape {found.seconds.shape}, its settings ask {shape}")
        return found


def measure_times(
    settings: TimingSettings,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> Timing:
    """Measure, or go on measuring; a batch in ``folder`` is a number of obstacles.

    CPU time of one thread. More ``workers`` than idle cores disturb each other.
    """
    jobs = [(f"spheres-{count:03d}", (settings, count)) for count in settings.counts]
    batches, effort = run_batches(_one_count, jobs, folder, workers, progress, executor=executor)
    stacked = {name: np.stack([batch[name] for batch in batches]) for name in ("seconds", "n_nodes", "field_s")}
    return Timing(settings, **stacked, effort=effort)


def _check(name: str, settings: TimingSettings) -> GaussianCheckSettings | None:
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


def _one_count(settings: TimingSettings, count: int) -> Batch:
    shapes = crowded_scene(count, settings.scene_seed, settings.radius_m).shapes
    field_of(shapes[:1], settings.level_m, settings)  # compiled before the clock starts
    began_s = time.thread_time()
    field = field_of(shapes, settings.level_m, settings)
    field_s = time.thread_time() - began_s
    few = dataclasses.replace(settings, n_samples=settings.few_samples)
    constraints = [
        constraint_of(
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
        search(constraint, "root", settings, 0)
    for run in range(settings.n_runs):
        for index, constraint in enumerate(constraints):
            began_s = time.thread_time()
            tree = search(constraint, "root", settings, run)
            seconds[index, run] = time.thread_time() - began_s
            nodes[index, run] = len(tree.nodes)
    return {"seconds": seconds, "n_nodes": nodes, "field_s": np.array(field_s)}
