"""What is planned: three scenes of the study, with the constants that all contenders share."""

import dataclasses
import functools
import pathlib
import time
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    RrtStar,
    RrtStarSettings,
    SegmentTest,
    line_cost,
    path_cost,
    refine_path,
    search_problem,
    segment_test,
)
from deltasafe.planning.collision.clearance_tables import UNIT_M
from deltasafe.planning.collision.discrete import SampledTest
from deltasafe.planning.collision.scenario_samples import POOL_SIZE
from deltasafe.scene import grid_from_shapes
from deltasafe.studies.planner.scenes import (
    GOAL,
    HIGHEST_POSE,
    LOWEST_POSE,
    START,
    WORKSPACE_M,
    EllipticDisc,
    StudyScene,
    cluttered_scene,
    crowded_scene,
    simple_scene,
)

__all__ = ["DELTA_P_M", "MARGIN_M", "STEERING_M", "Problem", "problems", "write_problem"]

Array = NDArray[np.float64]

DELTA = 0.05
DECAY_M = 0.02
MARGIN_M = 0.0005
DELTA_P_M = 0.02
STEERING_M = 0.2
GOAL_BIAS = 0.05
COST = line_cost("root", 0.01)


@dataclasses.dataclass(frozen=True)
class Problem:
    """A scene between two corners, its field built once."""

    scene: StudyScene

    @functools.cached_property
    def field(self) -> DistanceField:
        """{p_occupied > 0.05} of a linear decay over 2 cm."""
        return DistanceField.build(grid_from_shapes(self.scene.shapes, DECAY_M, *WORKSPACE_M, 0.005), DELTA)

    def test(self, method: str, n_samples: int = 100, seed: int = 0, by_yaw: bool = True) -> SegmentTest:
        """Test of segments of the study's disc."""
        settings = CheckSettings(method, n_samples=n_samples, delta_p_m=DELTA_P_M, by_yaw=by_yaw)
        return segment_test(self.field, EllipticDisc(), MARGIN_M, settings, seed)

    def search(self, constraint: Any, seed: int, **options: Any) -> RrtStar:
        """Our search, not begun."""
        options = {"steering_range_m": STEERING_M, "goal_bias": GOAL_BIAS, "informed": False, **options}
        problem = search_problem(constraint, COST, np.array(LOWEST_POSE), np.array(HIGHEST_POSE))
        return RrtStar(problem, np.array(START), np.array(GOAL), seed, RrtStarSettings(**options))

    def iterations(self, constraint: Any, count: int, seed: int, **options: Any) -> tuple[float, float]:
        """Seconds of this thread and cost of a search of ``count`` iterations."""
        began = time.thread_time()
        search = self.search(constraint, seed, **options)
        search.grow(count)
        taken = time.thread_time() - began
        return taken, float(search.tree.cost[1])

    def best_within(self, constraint: Any, budget_s: float, seed: int, share: float = 0.4) -> tuple[float, float]:
        """Seconds of this thread and cost of an informed search with large near sets, and of the path's refinement."""
        began = time.thread_time()
        search = self.search(constraint, seed, informed=True, near_factor=4.0)
        search.grow(deadline_s=began + (1 - share) * budget_s, clock=time.thread_time)
        poses = search.tree.path()
        if poses is None:
            return time.thread_time() - began, float("inf")
        poses = refine_path(search.problem, poses, None, seed, deadline_s=began + budget_s, clock=time.thread_time)
        return time.thread_time() - began, path_cost(COST, poses)


def problems() -> dict[str, Problem]:
    """Three large obstacles, eight small ones, a hundred spheres."""
    scenes = simple_scene(), cluttered_scene(), crowded_scene(100, seed=0)
    return {scene.name: Problem(scene) for scene in scenes}


def write_problem(problem: Problem, n_samples: int, file: pathlib.Path, with_yaw: bool = True) -> None:
    """The sampled test of a problem as the harness in C++ reads it."""
    test = problem.test("sampled", n_samples, by_yaw=with_yaw)
    assert isinstance(test, SampledTest)
    certificates, pool, steps = test
    lattice, by_yaw = certificates.lattice, certificates.by_yaw
    numbers = np.array(
        [
            *lattice[:3],
            lattice.per_m,
            certificates.cells_per_m,
            UNIT_M,
            steps.rho_max_m,
            steps.delta_p_m,
            steps.need_m,
            pool.floor,
            COST.rotation_weight_m2,
            STEERING_M,
            GOAL_BIAS,
            *START,
            *GOAL,
            *LOWEST_POSE,
            *HIGHEST_POSE,
            by_yaw.bins_per_rad,
        ],
        np.float64,
    )
    shape = lattice.nx, lattice.ny, lattice.nz
    free = by_yaw.free
    sizes = n_samples, pool.points.shape[1], POOL_SIZE, pool.seed, free.shape[0], free.shape[3]
    counts = np.array([*shape, *certificates.distance.shape, *sizes], np.int64)
    arrays = numbers, counts, certificates.distance, pool.unsafe, pool.points, free
    file.write_bytes(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
