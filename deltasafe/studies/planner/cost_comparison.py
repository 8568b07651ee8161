"""Fig. 5: cost of the planned paths over the uncertainty, for all methods in two scenes."""

import dataclasses
import itertools
import math
import pathlib
import time

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning import is_segment_safe, line_cost, path_cost
from deltasafe.studies.planner.methods import MAIN, Method, constraint_of, contenders, field_of, search
from deltasafe.studies.planner.scenes import StudyScene, cluttered_scene, simple_scene
from deltasafe.studies.planner.settings import ComparisonSettings
from deltasafe.studies.resumable_jobs import Batch, Effort, run_batches

__all__ = ["MEASURES", "SCENES", "Comparison", "compare"]

Array = NDArray[np.float64]

SCENES = ("simple", "cluttered")
MEASURES = ("cost_root", "cost_squared", "length_m", "is_safe", "n_nodes", "seconds")
"""What is stored of a run: NaN where no path was found, but for the last two."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """All runs of Fig. 5.

    Attributes:
        settings: of the study.
        runs: by measure, (scenes, levels, contenders, runs); NaN beyond the runs of a contender.
        effort: what it took.
    """

    settings: ComparisonSettings
    runs: dict[str, Array]
    effort: Effort

    @property
    def names(self) -> tuple[str, ...]:
        return tuple(one.name for one in contenders(self.settings))

    def of(self, measure: str, scene: str, name: str) -> Array:
        """(levels, runs) of one contender."""
        return self.runs[measure][SCENES.index(scene), :, self.names.index(name), : self.n_runs(name)]

    def n_runs(self, name: str) -> int:
        return self.settings.n_runs if name in MAIN else self.settings.n_runs_beside

    def mean_cost(self, scene: str, name: str) -> tuple[Array, Array]:
        """Mean (levels,) over the runs that found a path, by the cost that was minimized, and its standard error."""
        cost = self.of("cost_squared" if name.endswith("_squared") else "cost_root", scene, name)
        count = np.isfinite(cost).sum(axis=1)
        safe = np.where(np.isfinite(cost), cost, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = safe.sum(axis=1) / count
            spread = np.where(np.isfinite(cost), cost - mean[:, None], 0.0)
            return mean, np.sqrt((spread**2).sum(axis=1) / (count - 1) / count)

    def normalized_cost(self, scene: str, name: str) -> tuple[Array, Array]:
        """``mean_cost`` over the largest mean of the four methods and all levels of that scene (decision 20)."""
        suffix = "_squared" if name.endswith("_squared") else ""
        largest = max(np.nanmax(self.mean_cost(scene, one + suffix)[0]) for one in MAIN)
        mean, error = self.mean_cost(scene, name)
        return mean / largest, error / largest

    def solved_share(self, scene: str, name: str) -> Array:
        """Share (levels,) of the runs that found a path."""
        return np.asarray(np.isfinite(self.of("cost_root", scene, name)).mean(axis=1))

    def safe_share(self, scene: str, name: str) -> float:
        """Share of the paths of all levels that pass the continuous test of the field."""
        safe = self.of("is_safe", scene, name)
        found = safe[np.isfinite(safe)]
        return float(found.mean()) if found.size else math.nan

    def save(self, folder: str | pathlib.Path) -> None:
        """Write all runs and what they were made with, as a whole."""
        with atomic_folder(folder) as temporary:
            np.savez_compressed(temporary / "runs.npz", **self.runs)  # type: ignore[arg-type]
            write_json(temporary / "study.json", {"settings": self.settings, **dataclasses.asdict(self.effort)})

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Comparison":
        """Read what ``save`` wrote.

        Raises:
            DataError: a file is missing, or holds something else.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "study.json")
        try:
            settings = ComparisonSettings(**record["settings"])
            with (folder / "runs.npz").open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
                runs = {name: arrays[name] for name in MEASURES}
        except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
            raise DataError(folder, f"holds no comparison of this version ({error})") from error
        shape = (len(SCENES), settings.n_levels, len(contenders(settings)), settings.n_runs)
        if runs["cost_root"].shape != shape:
            raise DataError(folder, f"holds runs of shape {runs['cost_root'].shape}, its settings ask {shape}")
        return cls(settings, runs, Effort(record["minutes"], record["cpu_minutes"]))


def compare(
    settings: ComparisonSettings,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> Comparison:
    """Run, or go on with, the comparison; a batch in ``folder`` is a scene at a level.

    Every path is checked again by the continuous test of the field at its level, whatever method found it.
    """
    jobs = [
        (f"{scene}-{level:02d}", (settings, scene, level)) for scene in SCENES for level in range(settings.n_levels)
    ]
    batches, effort = run_batches(_one_level, jobs, folder, workers, progress, executor=executor)
    shape = (len(SCENES), settings.n_levels, len(contenders(settings)), settings.n_runs)
    runs = {name: np.stack([batch[name] for batch in batches]).reshape(shape) for name in MEASURES}
    return Comparison(settings, runs, effort)


def scene_named(name: str) -> StudyScene:
    return {"simple": simple_scene, "cluttered": cluttered_scene}[name]()


def _one_level(settings: ComparisonSettings, scene: str, level: int) -> Batch:
    shapes, level_m = scene_named(scene).shapes, settings.levels_m[level]
    field = field_of(shapes, level_m, settings)
    sigma_m = max(level_m, settings.least_level_m) / 2
    everybody = contenders(settings)
    runs = {name: np.full((len(everybody), settings.n_runs), np.nan) for name in MEASURES}
    verifier = constraint_of(None, shapes, field, sigma_m, settings, "continuous")
    for index, contender in enumerate(everybody):
        constraint = constraint_of(contender.check, shapes, field, sigma_m, settings)
        for run in range(settings.n_runs if contender.is_main else settings.n_runs_beside):
            for name, value in _one_run(contender, constraint, verifier, settings, run).items():
                runs[name][index, run] = value
    return runs


def _one_run(
    contender: Method, constraint: object, verifier: object, settings: ComparisonSettings, run: int
) -> dict[str, float]:
    began_s = time.thread_time()
    tree = search(constraint, contender.cost, settings, run)
    found: dict[str, float] = {"seconds": time.thread_time() - began_s, "n_nodes": len(tree.nodes)}
    poses = tree.path()
    if poses is not None:
        found["cost_root"] = path_cost(line_cost("root", settings.rotation_weight_m2), poses)
        found["cost_squared"] = path_cost(line_cost("squared", settings.rotation_weight_m2), poses)
        found["length_m"] = float(np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1).sum())
        found["is_safe"] = all(is_segment_safe(verifier, a, b) for a, b in itertools.pairwise(poses))  # type: ignore[arg-type]
    return found
