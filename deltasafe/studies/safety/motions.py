"""From a field or from obstacles to a trajectory, for each contender; or to the reason why there is none."""

import dataclasses
import itertools
from collections.abc import Sequence

from deltasafe.errors import PlanningError
from deltasafe.geometry import Pose, PosePath, Trajectory, wrap_to_pi
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    MotionSettings,
    PlanResult,
    PlanStatus,
    ToolBody,
    TrackingBound,
    grow_tree,
    is_segment_safe,
    line_cost,
    refine_path,
    schedule,
    schedule_at_top_speed,
    search_problem,
    segment_test,
)
from deltasafe.planning.collision.segment_query import ask_segment
from deltasafe.planning.scc_rrt_star import search_bounds
from deltasafe.planning.timing.velocity_schedule import CHORD_TOLERANCE_M
from deltasafe.studies.baselines import GaussianCheckSettings, GaussianObstacle, GaussianTestInView, gaussian_test

__all__ = ["OUTCOMES", "RefusalError", "parametric_motion", "scheduled_motion", "top_speed_motion"]

OUTCOMES = (
    "executed",
    "no task",
    "start unsafe",
    "goal unsafe",
    "no connection",
    "no path in the budget",
    "path not verified",
    "path too close for the smallest speed",
    "the arm cannot follow",
)
_OF_STATUS = {
    PlanStatus.START_UNSAFE: "start unsafe",
    PlanStatus.GOAL_UNSAFE: "goal unsafe",
    PlanStatus.NO_CONNECTION: "no connection",
    PlanStatus.BUDGET_SPENT: "no path in the budget",
    PlanStatus.UNVERIFIED: "path not verified",
}


class RefusalError(PlanningError):
    """A contender declines to move; the message is one of ``OUTCOMES``."""


def scheduled_motion(
    result: PlanResult, field: DistanceField, settings: MotionSettings, body: ToolBody, tracking: TrackingBound
) -> Trajectory:
    """Our path as fast as its clearance allows (section IV-C)."""
    try:
        return schedule(_path(result), field, settings, body, tracking, settings.rotation_weight_m2)[0]
    except PlanningError as error:
        raise (
            error if isinstance(error, RefusalError) else RefusalError("path too close for the smallest speed")
        ) from error


def top_speed_motion(
    result: PlanResult, field: DistanceField, settings: MotionSettings, body: ToolBody, tracking: TrackingBound
) -> Trajectory:
    """The same path, its corners blended under the same test, at top speed all along."""
    margin_m = float(tracking.error_m(settings.v_min_mps)) + CHORD_TOLERANCE_M
    test = segment_test(field, body, margin_m, CheckSettings())
    return schedule_at_top_speed(
        _path(result),
        lambda arc: all(is_segment_safe(test, a, b) for a, b in itertools.pairwise(arc)),
        settings,
        body,
        settings.rotation_weight_m2,
    )


def parametric_motion(
    method: str,
    obstacles: Sequence[GaussianObstacle],
    view: DistanceField,
    start: Pose,
    goal: Pose,
    settings: MotionSettings,
    seed: int,
    body: ToolBody,
    tracking: TrackingBound,
) -> Trajectory:
    """Path and trajectory of a compared method, with our search, cost and refinement.

    The robot is the ball around the disc, as these methods have it. They know no velocity schedule: the tracking error
    at top speed is part of that ball, and the motion is at top speed all along.

    Args:
        method: see ``GaussianCheckSettings``; several obstacles share delta by Boole where there is a delta.
        view: a field in which only what the camera does not see is occupied.

    Raises:
        RefusalError: no motion.
    """
    margin_m = float(tracking.error_m(settings.v_max_mps)) + CHORD_TOLERANCE_M
    checks = GaussianCheckSettings(method, settings.delta, "boole" if _has_delta(method) else "each", delta_p_m=0.002)
    constraint = GaussianTestInView(
        gaussian_test(obstacles, body.disc_radius_m + margin_m, checks),
        segment_test(view, body, margin_m, CheckSettings()),
    )
    first, last = start.as_array(), goal.as_array()
    last[3] = first[3] + wrap_to_pi(last[3] - first[3])
    for name, end in (("start", first), ("goal", last)):
        if not ask_segment(constraint, end, end):
            raise RefusalError(f"{name} unsafe")
    lower, upper = search_bounds(view, settings, first, last[None])
    cost = line_cost(settings.cost, settings.rotation_weight_m2, view.arrays.floor_z_m, settings.length_weight_m)
    problem = search_problem(constraint, cost, lower, upper)
    tree = grow_tree(problem, first, last, settings.n_iterations, seed, settings.rrt_star)
    poses = tree.path()
    if poses is None:
        raise RefusalError("no path in the budget")
    poses = refine_path(problem, poses, settings.n_refinements, seed)
    return schedule_at_top_speed(
        PosePath(poses),
        lambda arc: all(ask_segment(constraint, a, b) for a, b in itertools.pairwise(arc)),
        settings,
        body,
        settings.rotation_weight_m2,
    )


def level_settings(settings: MotionSettings, delta: float) -> MotionSettings:
    """The settings of a motion at another level."""
    return dataclasses.replace(settings, delta=delta)


def _path(result: PlanResult) -> PosePath:
    if result.status is not PlanStatus.SOLVED or result.path is None:
        raise RefusalError(_OF_STATUS[result.status])
    return result.path


def _has_delta(method: str) -> bool:
    return method != "bounding_volume"
