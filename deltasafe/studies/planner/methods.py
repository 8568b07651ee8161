"""Who is compared: our sampled test of a field, the three published methods, and references that explain them.

Decision 21: "95 %" is d-tilde = 2 sigma for all. Our probability falls linearly to zero at d_stop, so that
P(occupied) = 0.05 lies at d-tilde = 0.95 d_stop; a Gaussian gets sigma = d-tilde / 2 and its own rule.
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
from deltasafe.studies.baselines import GaussianCheckSettings, enclosing_obstacle, gaussian_test
from deltasafe.studies.planner.scenes import GOAL, HIGHEST_POSE, LOWEST_POSE, START, WORKSPACE_M, EllipticDisc
from deltasafe.studies.planner.settings import SearchSettings

__all__ = ["MAIN", "Method", "constraint_of", "contenders", "field_of", "search"]

MAIN = ("ours", "chance_constraint", "bounding_volume", "max_probability")
"""The four methods of Fig. 5."""


@dataclasses.dataclass(frozen=True)
class Method:
    """A test of segments and the cost that is minimized under it.

    Attributes:
        name: how results are found again.
        label: how it is called in a legend.
        check: settings of a Gaussian method; None is our method.
        cost: line cost of the search.
        is_main: of the four methods of the paper, with the default cost.
    """

    name: str
    label: str
    check: GaussianCheckSettings | None
    cost: str = "root"
    is_main: bool = False


def contenders(settings: SearchSettings) -> tuple[Method, ...]:
    """The four methods by their own rules, three references, and the four with the paper's squared cost.

    ``equal_margin`` grows obstacles by 2 sigma, which is d-tilde: for spheres every Gaussian method is a ball around
    the mean, so that at an equal margin all of them are this one. ``chance_constraint_each`` is without Boole's
    split of delta, ``exact`` has the Gaussian integral in place of a bound.
    """

    def gaussian(method: str, **options: Any) -> GaussianCheckSettings:
        return GaussianCheckSettings(method, settings.delta, delta_p_m=settings.delta_p_m, **options)

    four = (
        Method("ours", "Our method", None, is_main=True),
        Method(
            "chance_constraint", "Chance constraint", gaussian("chance_constraint", joint_risk="boole"), is_main=True
        ),
        Method("bounding_volume", "Bounding volume", gaussian("bounding_volume"), is_main=True),
        Method("max_probability", "Max. prob. approx.", gaussian("max_probability"), is_main=True),
    )
    references = (
        Method("chance_constraint_each", "Chance constraint, no Boole split", gaussian("chance_constraint")),
        Method("exact", "Exact Gaussian", gaussian("exact")),
        Method("equal_margin", "Any Gaussian, margin 2 sigma", gaussian("bounding_volume", sigma_level=2.0)),
    )
    squared = (dataclasses.replace(one, name=f"{one.name}_squared", cost="squared", is_main=False) for one in four)
    return (*four, *references, *squared)


def field_of(shapes: Sequence[Shape], level_m: float, settings: SearchSettings) -> DistanceField:
    """The field of a scene at a level of uncertainty: linear decay to zero at d-tilde / (1 - delta)."""
    grid = grid_from_shapes(shapes, level_m / (1 - settings.delta), *WORKSPACE_M, settings.voxel_m)
    return DistanceField.build(grid, settings.delta)


def constraint_of(
    check: GaussianCheckSettings | None,
    shapes: Sequence[Shape],
    field: DistanceField,
    sigma_m: float,
    settings: SearchSettings,
    method: str = "sampled",
) -> Any:
    """The compiled test of a method in a scene: of the field by ``method``, or of obstacles at Gaussian positions."""
    disc = EllipticDisc()
    if check is None:
        options = CheckSettings(method, n_samples=settings.n_samples, delta_p_m=settings.delta_p_m)
        return segment_test(field, disc, settings.margin_m, options, settings.first_seed)
    obstacles = [enclosing_obstacle(shape, sigma_m) for shape in shapes]
    return gaussian_test(obstacles, disc.disc_radius_m + settings.margin_m, check)


def search(constraint: Any, cost: str, settings: SearchSettings, run: int) -> SearchTree:
    """Run number ``run`` of the search, from corner to corner."""
    line = line_cost(cost, settings.rotation_weight_m2)
    problem = search_problem(constraint, line, np.array(LOWEST_POSE), np.array(HIGHEST_POSE))
    rrt_star = RrtStarSettings(settings.steering_range_m, settings.goal_bias, settings.near_factor, informed=False)
    return grow_tree(
        problem, np.array(START), np.array(GOAL), settings.n_iterations, settings.first_seed + run, rrt_star
    )
