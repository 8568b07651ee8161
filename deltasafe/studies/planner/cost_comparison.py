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
from deltasafe.planning import is_segment_safe, line_cost, path_cost
from deltasafe.studies.planner.methods import MAIN, Method, build_field, build_test, compared_methods, run_search
from deltasafe.studies.planner.scenes import cluttered_scene, simple_scene
from deltasafe.studies.planner.settings import ComparisonSettings
from deltasafe.studies.resumable_jobs import Batch, Effort, run_batches
from deltasafe.studies.stored_runs import load_runs, save_runs

Array = NDArray[np.float64]

SCENES = ("simple", "cluttered")
MEASURES = ("cost_root", "cost_squared", "length_m", "is_safe", "n_nodes", "seconds")
"""Stored values of a run. All but ``n_nodes`` and ``seconds`` are NaN if no path was found."""


@dataclasses.dataclass(frozen=True)
class Comparison:
    """All runs of Fig. 5.

    Attributes:
        settings: of the study.
        runs: by measure, (scenes, levels, methods, runs); NaN beyond the number of runs of a method.
        effort: time spent.
    """

    settings: ComparisonSettings
    runs: dict[str, Array]
    effort: Effort

    @property
    def names(self) -> tuple[str, ...]:
        """Names of all methods, in the order of ``runs``."""
        return tuple(method.name for method in compared_methods(self.settings))

    def of(self, measure: str, scene: str, name: str) -> Array:
        """Select the values (levels, runs) of one method."""
        return self.runs[measure][SCENES.index(scene), :, self.names.index(name), : self.settings.runs_of(name in MAIN)]

    def mean_cost(self, scene: str, name: str) -> tuple[Array, Array]:
        """Average the minimized cost (levels,) over the runs that found a path; return mean and standard error."""
        cost = self.of("cost_squared" if name.endswith("_squared") else "cost_root", scene, name)
        count = np.isfinite(cost).sum(axis=1)
        safe = np.where(np.isfinite(cost), cost, 0.0)
        with np.errstate(invalid="ignore", divide="ignore"):
            mean = safe.sum(axis=1) / count
            spread = np.where(np.isfinite(cost), cost - mean[:, None], 0.0)
            return mean, np.sqrt((spread**2).sum(axis=1) / (count - 1) / count)

    def normalized_cost(self, scene: str, name: str) -> tuple[Array, Array]:
        """Divide ``mean_cost`` by the largest mean of the four methods over all levels of the scene (decision 20)."""
        suffix = "_squared" if name.endswith("_squared") else ""
        largest = max(np.nanmax(self.mean_cost(scene, one + suffix)[0]) for one in MAIN)
        mean, error = self.mean_cost(scene, name)
        return mean / largest, error / largest

    def solved_fraction(self, scene: str, name: str) -> Array:
        """Compute the fraction (levels,) of runs that found a path."""
        return np.asarray(np.isfinite(self.of("cost_root", scene, name)).mean(axis=1))

    def safe_fraction(self, scene: str, name: str) -> float:
        """Compute the fraction of all paths that pass the continuous test of the field; NaN without a path."""
        safe = self.of("is_safe", scene, name)
        found = safe[np.isfinite(safe)]
        return float(found.mean()) if found.size else math.nan

    def save(self, folder: str | pathlib.Path) -> None:
        """Write runs.npz and study.json atomically."""
        save_runs(folder, self.settings, self.runs, self.effort)

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "Comparison":
        """Read a folder that ``save`` wrote.

        Raises:
            DataError: a file is missing or has other content.
        """
        return cls(*load_runs(folder, ComparisonSettings, lambda settings: dict.fromkeys(MEASURES, _shape(settings))))


def _shape(settings: ComparisonSettings) -> tuple[int, ...]:
    return len(SCENES), settings.n_levels, len(compared_methods(settings)), settings.n_runs


def n_plans(settings: ComparisonSettings) -> int:
    """Count the planned paths of the whole study."""
    return len(SCENES) * settings.n_levels * sum(settings.runs_of(one.is_main) for one in compared_methods(settings))


def run_comparison(
    settings: ComparisonSettings,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> Comparison:
    """Run or resume the comparison; each batch in ``folder`` is one scene at one level.

    Every path is tested again by the continuous test of the field at its level, whichever method found it.
    """
    jobs = [
        (f"{scene}-{level:02d}", (settings, scene, level)) for scene in SCENES for level in range(settings.n_levels)
    ]
    batches, effort = run_batches(_run_level, jobs, folder, workers, progress, executor=executor)
    runs = {name: np.stack([batch[name] for batch in batches]).reshape(_shape(settings)) for name in MEASURES}
    return Comparison(settings, runs, effort)


def _run_level(settings: ComparisonSettings, scene: str, level: int) -> Batch:
    """Run all methods in one scene at one level of uncertainty."""
    shapes, level_m = {"simple": simple_scene, "cluttered": cluttered_scene}[scene]().shapes, settings.levels_m[level]
    field = build_field(shapes, level_m, settings)
    sigma_m = max(level_m, settings.least_level_m) / 2
    methods = compared_methods(settings)
    runs = {name: np.full((len(methods), settings.n_runs), np.nan) for name in MEASURES}
    verifier = build_test(None, shapes, field, sigma_m, settings, "continuous")
    for index, method in enumerate(methods):
        constraint = build_test(method.check, shapes, field, sigma_m, settings)
        for run in range(settings.runs_of(method.is_main)):
            for name, value in _run_method(method, constraint, verifier, settings, run).items():
                runs[name][index, run] = value
    return runs


def _run_method(
    method: Method, constraint: object, verifier: object, settings: ComparisonSettings, run: int
) -> dict[str, float]:
    """Plan once; return the values of ``MEASURES`` that exist."""
    started_s = time.thread_time()
    tree = run_search(constraint, method.cost, settings, run)
    found: dict[str, float] = {"seconds": time.thread_time() - started_s, "n_nodes": len(tree.nodes)}
    poses = tree.path()
    if poses is not None:
        found["cost_root"] = path_cost(line_cost("root", settings.rotation_weight_m2), poses)
        found["cost_squared"] = path_cost(line_cost("squared", settings.rotation_weight_m2), poses)
        found["length_m"] = float(np.linalg.norm(np.diff(poses[:, :3], axis=0), axis=1).sum())
        found["is_safe"] = all(is_segment_safe(verifier, a, b) for a, b in itertools.pairwise(poses))  # type: ignore[arg-type]
    return found
