"""The compared methods: our sampled test of a field, the three published methods, and references.

Decision 21: "95 %" is d-tilde = 2 sigma for all methods. Our probability falls linearly to zero at d_stop, so that
P(occupied) = 0.05 lies at d-tilde = 0.95 d_stop. A Gaussian gets sigma = d-tilde / 2 and applies its own rule.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    RrtStarSettings,
    SearchTree,
    grow_tree,
    line_cost,
    search_problem,
    segment_test,
)
from deltasafe.scene import Shape, grid_from_shapes
from deltasafe.studies.baselines import LABELS, GaussianCheckSettings, enclosing_obstacle, gaussian_test
from deltasafe.studies.planner.scenes import GOAL, HIGHEST_POSE, LOWEST_POSE, START, WORKSPACE_M, EllipticDisc
from deltasafe.studies.planner.settings import SearchSettings

MAIN = ("ours", "chance_constraint", "bounding_volume", "max_probability")
"""The four methods of Fig. 5."""

REFERENCES = ("chance_constraint_each", "exact", "equal_margin")
"""Gaussian methods that explain the differences between the four."""


@dataclasses.dataclass(frozen=True)
class Method:
    """A segment test and the cost that the search minimizes under it.

    Attributes:
        name: key of its results.
        label: name in legends and tables.
        check: settings of a Gaussian method; None is our method.
        cost: line cost of the search.
        is_main: whether it is one of the paper's four methods, with the default cost.
    """

    name: str
    label: str
    check: GaussianCheckSettings | None
    cost: str = "root"
    is_main: bool = False


def compared_methods(settings: SearchSettings) -> tuple[Method, ...]:
    """Return the four methods with their own rules, three references, and the four with the paper's squared cost.

    ``chance_constraint_each`` gives each obstacle the whole delta instead of Boole's split. ``exact`` uses the
    Gaussian integral instead of a bound. ``equal_margin`` grows obstacles by 2 sigma = d-tilde. For spheres every
    Gaussian method is a ball around the mean, so at an equal margin all of them equal ``equal_margin``.
    """

    def gaussian(method: str, **options: Any) -> GaussianCheckSettings:
        return GaussianCheckSettings(method, settings.delta, delta_p_m=settings.delta_p_m, **options)

    checks = {
        "ours": None,
        "chance_constraint": gaussian("chance_constraint", joint_risk="boole"),
        "bounding_volume": gaussian("bounding_volume"),
        "max_probability": gaussian("max_probability"),
    }
    four = [Method(name, LABELS.get(name, "Our method"), check, is_main=True) for name, check in checks.items()]
    references = (
        Method("chance_constraint_each", "Chance constraint, no Boole split", gaussian("chance_constraint")),
        Method("exact", "Exact Gaussian", gaussian("exact")),
        Method("equal_margin", "Any Gaussian, margin 2 sigma", gaussian("bounding_volume", sigma_level=2.0)),
    )
    squared = (dataclasses.replace(one, name=f"{one.name}_squared", cost="squared", is_main=False) for one in four)
    return (*four, *references, *squared)


def build_field(shapes: Sequence[Shape], level_m: float, settings: SearchSettings) -> DistanceField:
    """Build the field of a scene at a level of uncertainty: linear decay to zero at d-tilde / (1 - delta)."""
    grid = grid_from_shapes(shapes, level_m / (1 - settings.delta), *WORKSPACE_M, settings.voxel_m)
    return DistanceField.build(grid, settings.delta)


def build_test(
    check: GaussianCheckSettings | None,
    shapes: Sequence[Shape],
    field: DistanceField,
    sigma_m: float,
    settings: SearchSettings,
    test_method: str = "sampled",
) -> Any:
    """Build the segment test of a method: of the field, by ``test_method``, or of obstacles at Gaussian positions."""
    disc = EllipticDisc()
    if check is None:
        options = CheckSettings(test_method, n_samples=settings.n_samples, delta_p_m=settings.delta_p_m)
        return segment_test(field, disc, settings.margin_m, options, settings.first_seed)
    obstacles = [enclosing_obstacle(shape, sigma_m) for shape in shapes]
    return gaussian_test(obstacles, disc.disc_radius_m + settings.margin_m, check)


def run_search(constraint: Any, cost: str, settings: SearchSettings, run: int) -> SearchTree:
    """Search from corner to corner with the seed of run number ``run``."""
    line = line_cost(cost, settings.rotation_weight_m2)
    problem = search_problem(constraint, line, np.array(LOWEST_POSE), np.array(HIGHEST_POSE))
    rrt_star = RrtStarSettings(settings.steering_range_m, settings.goal_bias, settings.near_factor, informed=False)
    return grow_tree(
        problem, np.array(START), np.array(GOAL), settings.n_iterations, settings.first_seed + run, rrt_star
    )
