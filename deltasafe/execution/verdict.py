"""The verdict on an execution: was every executed pose delta-safe, was tracking within its bound, was anything touched?

Delta-safety is pointwise, for each point of the tool and each instant (decision 10). It bounds neither the probability
that the body as a whole collides nor that the motion does, so the joint statement about the whole motion stands
beside the share of poses.
"""

import dataclasses
import itertools
import math
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.recording import Execution
from deltasafe.planning.audit import body_points
from deltasafe.planning.body import ToolBody
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.scene import OccupancyGrid

__all__ = ["OccupancyField", "SafetyVerdict", "SpeedBin", "judge", "largest_p_occupied"]

Array = NDArray[np.float64]

_SPEED_EDGES_MPS = (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, 0.2, math.inf)


class OccupancyField(Protocol):
    """What the verdict asks of a field: P(occupied) at points."""

    def at(self, points_m: Array) -> NDArray[Any]:
        """(N,) p_occupied at (N, 3) points in meters."""


@dataclasses.dataclass(frozen=True)
class SpeedBin:
    """Tracking at reference speeds from ``from_mps`` up to (not including) ``to_mps``; None: unlimited."""

    from_mps: float
    to_mps: float | None
    samples: int
    max_error_m: float
    max_excess_m: float
    share_within: float


@dataclasses.dataclass(frozen=True)
class SafetyVerdict:
    """JSON-friendly; lengths in meters, times in seconds.

    Attributes:
        delta: the level that was judged.
        poses: number of recorded poses between rest at the start and rest at the goal.
        delta_safe_share: share of them at which every point of the tool has p_occupied <= delta (pointwise).
        whole_motion_delta_safe: whether that held at all of them (joint).
        worst_p_occupied, worst_at_s: the largest p_occupied that a point of the tool met, and when.
        approach_delta_safe_share: the same share for the way down and up, which is not planned; None without one.
        completed, stop_reason: whether the monitor let the motion finish, and why not.
        max_error_m: largest workspace error e_pos + rho_max e_rotation.
        share_within_bound, max_excess_m: against gamma(max(v, min_speed_mps)); the excess is negative when inside.
        share_within_bound_at_true_speed: against gamma(v) itself, which the paper's line puts at 0 at rest.
        by_speed: the same by reference speed.
        min_tool_to_hand_m, min_arm_to_hand_m: smallest distances to the true hand, approach and retreat included;
            None: no hand or no links.
        contacts: contact points with hand or table counted by the physics, approach and retreat included.
        duration_s: of the judged part.
        safe: the whole motion was delta-safe, completed, and touched nothing.
    """

    delta: float
    poses: int
    delta_safe_share: float
    whole_motion_delta_safe: bool
    worst_p_occupied: float
    worst_at_s: float
    approach_delta_safe_share: float | None
    completed: bool
    stop_reason: str
    max_error_m: float
    share_within_bound: float
    share_within_bound_at_true_speed: float
    max_excess_m: float
    min_speed_mps: float
    by_speed: tuple[SpeedBin, ...]
    min_tool_to_hand_m: float | None
    min_arm_to_hand_m: float | None
    contacts: int
    duration_s: float
    safe: bool


def judge(
    execution: Execution,
    grid: OccupancyField,
    body: ToolBody,
    delta: float,
    bound: TrackingBound,
    *,
    min_speed_mps: float = 0.01,
    spacing_m: float = 0.0025,
) -> SafetyVerdict:
    """Judge what was executed, at the measured poses, against the field it was planned in and the true hand.

    Args:
        execution: the recording.
        grid: the field; asked at every measured pose for points of the tool ``spacing_m`` apart.
        body: the tool as planned.
        delta: level in (0, 1).
        bound: gamma.
        min_speed_mps: smallest speed at which the bound is read.

    Raises:
        SettingsError: delta outside (0, 1), or another tool than the executed one.
    """
    if not 0 < delta < 1:
        raise SettingsError(f"delta must lie in (0, 1), got {delta}")
    if body != execution.body:
        raise SettingsError(f"the motion was executed with {execution.body}, not with {body}")
    judged = execution.judged
    p_occupied = largest_p_occupied(execution, grid, body, spacing_m)
    safe = p_occupied <= delta
    worst = int(np.argmax(np.where(judged, p_occupied, -np.inf)))
    aside = ~judged
    error = execution.workspace_error_m[judged]
    speed = execution.reference_speed_mps[judged]
    excess = error - bound.error_m(np.maximum(speed, min_speed_mps))
    contacts = int(execution.contacts.sum())
    whole = bool(safe[judged].all())
    time_s = execution.time_s[judged]
    tool, arm = execution.tool_to_hand_m.min(), execution.arm_to_hand_m.min()
    return SafetyVerdict(
        delta=float(delta),
        poses=int(judged.sum()),
        delta_safe_share=float(safe[judged].mean()),
        whole_motion_delta_safe=whole,
        worst_p_occupied=float(p_occupied[worst]),
        worst_at_s=float(execution.time_s[worst]),
        approach_delta_safe_share=float(safe[aside].mean()) if aside.any() else None,
        completed=execution.completed,
        stop_reason=execution.stop_reason,
        max_error_m=float(error.max()),
        share_within_bound=float((excess <= 0).mean()),
        share_within_bound_at_true_speed=float((error <= bound.error_m(speed)).mean()),
        max_excess_m=float(excess.max()),
        min_speed_mps=min_speed_mps,
        by_speed=tuple(_by_speed(speed, error, excess)),
        min_tool_to_hand_m=float(tool) if math.isfinite(tool) else None,
        min_arm_to_hand_m=float(arm) if math.isfinite(arm) else None,
        contacts=contacts,
        duration_s=float(time_s[-1] - time_s[0]),
        safe=whole and execution.completed and contacts == 0 and bool(tool > 0),
    )


def largest_p_occupied(execution: Execution, grid: OccupancyField, body: ToolBody, spacing_m: float = 0.0025) -> Array:
    """(N,) largest p_occupied of the tool's points, ``spacing_m`` apart, at each measured pose."""
    points = body_points(body, spacing_m)
    if isinstance(grid, OccupancyGrid):
        return np.asarray(
            grid.max_p_occupied_on(points, execution.tool_rotations, execution.tool_positions_m), dtype=np.float64
        )
    poses = zip(execution.tool_rotations, execution.tool_positions_m, strict=True)
    return np.array([np.max(grid.at(points @ rotation.T + position)) for rotation, position in poses])


def _by_speed(speed: Array, error: Array, excess: Array) -> list[SpeedBin]:
    bins = []
    for low, high in itertools.pairwise(_SPEED_EDGES_MPS):
        inside = (speed >= low) & (speed < high)
        if inside.any():
            bins.append(
                SpeedBin(
                    from_mps=low,
                    to_mps=high if math.isfinite(high) else None,
                    samples=int(inside.sum()),
                    max_error_m=float(error[inside].max()),
                    max_excess_m=float(excess[inside].max()),
                    share_within=float((excess[inside] <= 0).mean()),
                )
            )
    return bins
