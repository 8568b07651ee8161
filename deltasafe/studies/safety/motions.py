"""Trajectories of all methods: from a field or from obstacles to a trajectory, or to the reason for a refusal."""

import itertools
from collections.abc import Sequence
from typing import Any

from deltasafe.errors import PlanningError
from deltasafe.geometry import Pose, PosePath, Trajectory, wrap_to_pi
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    MotionSettings,
    PlanResult,
    PlanStatus,
    grow_tree,
    line_cost,
    refine_path,
    schedule,
    schedule_at_top_speed,
    search_problem,
    segment_test,
)
from deltasafe.planning.collision.segment_query import segment_passes
from deltasafe.planning.scc_rrt_star import search_bounds
from deltasafe.planning.timing.velocity_schedule import CHORD_TOLERANCE_M
from deltasafe.studies.baselines import GaussianCheckSettings, GaussianObstacle, GaussianTestInView, gaussian_test

OUTCOMES = (
    "executed",
    "no task",
    "start unsafe",
    "goal unsafe",
    "no connection",
    "no path in the budget",
    "too narrow",
    "path not verified",
    "path too close for the smallest speed",
    "the arm cannot follow",
)
_OF_STATUS = {
    PlanStatus.START_UNSAFE: "start unsafe",
    PlanStatus.GOAL_UNSAFE: "goal unsafe",
    PlanStatus.NO_CONNECTION: "no connection",
    PlanStatus.BUDGET_SPENT: "no path in the budget",
    PlanStatus.TOO_NARROW: "too narrow",
    PlanStatus.UNVERIFIED: "path not verified",
}


class RefusalError(PlanningError):
    """A method refuses to move; the message is one of ``OUTCOMES``."""


def scheduled_motion(result: PlanResult, field: DistanceField, settings: MotionSettings) -> Trajectory:
    """Time our path as fast as its clearance allows (section IV-C).

    Raises:
        RefusalError: there is no path, or it is too close to the unsafe set for the smallest speed.
    """
    path, body, tracking = _path(result), settings.body, settings.tracking
    try:
        return schedule(path, field, settings, body, tracking, settings.rotation_weight_m2)[0]
    except PlanningError as error:
        raise RefusalError("path too close for the smallest speed") from error


def top_speed_motion(result: PlanResult, field: DistanceField, settings: MotionSettings) -> Trajectory:
    """Time the same path at top speed; its corners are blended under the same test.

    Raises:
        RefusalError: there is no path.
    """
    margin_m = float(settings.tracking.error_m(settings.v_min_mps)) + CHORD_TOLERANCE_M
    return _at_top_speed(_path(result), segment_test(field, settings.body, margin_m, CheckSettings()), settings)


def parametric_motion(
    method: str,
    obstacles: Sequence[GaussianObstacle],
    view: DistanceField,
    task: tuple[Pose, Pose],
    settings: MotionSettings,
    seed: int,
) -> Trajectory:
    """Plan and time a motion of a compared method, with our search, cost and refinement.

    As published, the robot is the ball around the disc. These methods have no velocity schedule: the motion is at top
    speed, and its tracking error is added to the ball.

    Args:
        method: see ``GaussianCheckSettings``; several obstacles share delta by Boole's inequality.
        view: field in which only the space outside the camera's view is occupied.
        task: start and goal.

    Raises:
        RefusalError: start or goal is unsafe, or no path was found.
    """
    margin_m = float(settings.tracking.error_m(settings.v_max_mps)) + CHORD_TOLERANCE_M
    joint_risk = "each" if method == "bounding_volume" else "boole"
    checks = GaussianCheckSettings(method, settings.delta, joint_risk, delta_p_m=0.002)
    constraint = GaussianTestInView(
        gaussian_test(obstacles, settings.body.disc_radius_m + margin_m, checks),
        segment_test(view, settings.body, margin_m, CheckSettings()),
    )
    start, goal = (pose.as_array() for pose in task)
    goal[3] = start[3] + wrap_to_pi(goal[3] - start[3])
    for name, end in (("start", start), ("goal", goal)):
        if not segment_passes(constraint, end, end):
            raise RefusalError(f"{name} unsafe")
    lower, upper = search_bounds(view, settings, start, goal[None])
    cost = line_cost(settings.cost, settings.rotation_weight_m2, view.arrays.table_z_m, settings.length_weight_m)
    problem = search_problem(constraint, cost, lower, upper)
    tree = grow_tree(problem, start, goal, settings.n_iterations, seed, settings.rrt_star)
    poses = tree.path()
    if poses is None:
        raise RefusalError("no path in the budget")
    poses = refine_path(problem, poses, settings.n_refinements, seed)
    return _at_top_speed(PosePath(poses), constraint, settings)


def _at_top_speed(path: PosePath, constraint: Any, settings: MotionSettings) -> Trajectory:
    return schedule_at_top_speed(
        path,
        lambda arc: all(segment_passes(constraint, a, b) for a, b in itertools.pairwise(arc)),
        settings,
        settings.body,
        settings.rotation_weight_m2,
    )


def _path(result: PlanResult) -> PosePath:
    if result.status is not PlanStatus.SOLVED or result.path is None:
        raise RefusalError(_OF_STATUS[result.status])
    return result.path
