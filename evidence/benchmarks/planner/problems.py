"""Planning problems: three scenes of the planner study, with the constants that all methods share."""

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
    """A scene with the start and goal of the study; its field is built once."""

    scene: StudyScene

    @functools.cached_property
    def field(self) -> DistanceField:
        """Build the distance field of {p_occupied > 0.05}, where p_occupied decays linearly over 2 cm."""
        return DistanceField.build(grid_from_shapes(self.scene.shapes, DECAY_M, *WORKSPACE_M, 0.005), DELTA)

    def test(self, method: str, n_samples: int = 100, seed: int = 0, by_yaw: bool = True) -> SegmentTest:
        """Create a segment test for the disc of the study."""
        settings = CheckSettings(method, n_samples=n_samples, delta_p_m=DELTA_P_M, by_yaw=by_yaw)
        return segment_test(self.field, EllipticDisc(), MARGIN_M, settings, seed)

    def search(self, constraint: Any, seed: int, **options: Any) -> RrtStar:
        """Create a search."""
        options = {"steering_range_m": STEERING_M, "goal_bias": GOAL_BIAS, "informed": False, **options}
        problem = search_problem(constraint, COST, np.array(LOWEST_POSE), np.array(HIGHEST_POSE))
        return RrtStar(problem, np.array(START), np.array(GOAL), seed, RrtStarSettings(**options))

    def iterations(self, constraint: Any, count: int, seed: int, **options: Any) -> tuple[float, float]:
        """Search for ``count`` iterations; return thread seconds and cost."""
        began_s = time.thread_time()
        search = self.search(constraint, seed, **options)
        search.grow(count)
        taken_s = time.thread_time() - began_s
        return taken_s, float(search.tree.cost[1])

    def path(self, constraint: Any, count: int, seed: int, **options: Any) -> Array | None:
        """Search for ``count`` iterations; return the path (N, 4), or None."""
        search = self.search(constraint, seed, **options)
        search.grow(count)
        return search.tree.path()

    def best_within(self, constraint: Any, budget_s: float, seed: int, refinement: float = 0.4) -> tuple[float, float]:
        """Run an informed search with large near sets and refine the path; return thread seconds and cost."""
        began_s = time.thread_time()
        search = self.search(constraint, seed, informed=True, near_factor=4.0)
        search.grow(deadline_s=began_s + (1 - refinement) * budget_s, clock=time.thread_time)
        poses = search.tree.path()
        if poses is None:
            return time.thread_time() - began_s, float("inf")
        poses = refine_path(search.problem, poses, None, seed, deadline_s=began_s + budget_s, clock=time.thread_time)
        return time.thread_time() - began_s, path_cost(COST, poses)


def problems() -> dict[str, Problem]:
    """Create the three problems: three large obstacles, eight small ones, a hundred spheres."""
    scenes = simple_scene(), cluttered_scene(), crowded_scene(100, seed=0)
    return {scene.name: Problem(scene) for scene in scenes}


def write_problem(problem: Problem, n_samples: int, file: pathlib.Path, by_yaw: bool) -> None:
    """Write the sampled test of a problem in the binary format of the C++ harness."""
    test = problem.test("sampled", n_samples, by_yaw=by_yaw)
    assert isinstance(test, SampledTest)
    tables, pool, steps = test
    lattice, yaw = tables.lattice, tables.by_yaw
    pose = [*START, *GOAL, *LOWEST_POSE, *HIGHEST_POSE]
    scale = [*lattice[:3], lattice.per_m, tables.cells_per_m, UNIT_M]
    limits = [steps.rho_max_m, steps.delta_p_m, steps.needed_m, pool.floor]
    search = [COST.rotation_weight_m2, STEERING_M, GOAL_BIAS]
    numbers = np.array([*scale, *limits, *search, *pose, yaw.bins_per_rad], np.float64)
    shape = lattice.nx, lattice.ny, lattice.nz
    free = yaw.free
    sizes = n_samples, pool.points.shape[1], POOL_SIZE, pool.seed, free.shape[0], free.shape[3]
    counts = np.array([*shape, *tables.steps.shape, *sizes], np.int64)
    arrays = numbers, counts, tables.steps, pool.unsafe_bits, pool.points, free
    file.write_bytes(b"".join(np.ascontiguousarray(array).tobytes() for array in arrays))
