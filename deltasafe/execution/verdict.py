"""Evaluation of an execution: delta-safety of the executed poses, tracking error against its bound, contacts.

Delta-safety is pointwise: it holds for each point of the tool at each instant (decision 10). It bounds neither the
probability that the tool as a whole collides nor that the motion does. Therefore the verdict states both the fraction
of delta-safe poses and whether all poses of the motion were delta-safe.
"""

import dataclasses
import itertools
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.recording import Execution
from deltasafe.planning import MotionSettings, ToolBody
from deltasafe.planning.audit import body_points
from deltasafe.scene import OccupancyGrid

Array = NDArray[np.float64]

_SPEED_EDGES_MPS = (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, 0.2, math.inf)


@dataclasses.dataclass(frozen=True)
class SpeedBin:
    """Tracking at reference speeds from ``from_mps`` up to, not including, ``to_mps``; None: unlimited."""

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
        delta: the evaluated level.
        poses: number of recorded poses from rest at the start to rest at the goal.
        delta_safe_share: fraction of these poses at which every point of the tool has p_occupied <= delta (pointwise).
        whole_motion_delta_safe: whether all of these poses are delta-safe (joint).
        worst_p_occupied, worst_at_s: largest p_occupied at a point of the tool, and its time.
        approach_delta_safe_share: fraction of delta-safe poses of approach and retreat, which are not planned; None
            without approach and retreat.
        completed, stop_reason: whether the motion was completed, and why the monitor stopped it if not.
        max_error_m: largest workspace error e_pos + rho_max e_rotation.
        share_within_bound, max_excess_m: fraction of time within gamma(max(v, min_speed_mps)), and largest error minus
            this bound; negative if always inside.
        share_within_bound_at_true_speed: the same fraction for gamma(v), which is 0 at rest for the paper's line.
        min_speed_mps: v_min of the motion's settings.
        by_speed: the same by reference speed.
        min_tool_to_hand_m, min_arm_to_hand_m: smallest distances to the true hand, approach and retreat included;
            None without a hand or without links.
        margin_kept_share: fraction of the judged poses at which every point of the tool kept the motion's margin around
            the unsafe set; None for a motion without a margin.
        contacts: contact points with hand or table in the simulation, approach and retreat included; None without a
            hand.
        duration_s: of the evaluated part.
        safe: all poses of the motion are delta-safe and kept the margin, the motion was completed, and there was no
            contact. None (not judged) if only the hand is missing for that.
        hand_judged: whether the true hand was in the simulated world; else the world was without a hand.
        table_contacts: contact points with the table in a world without a hand; None with a hand.
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
    contacts: int | None
    duration_s: float
    safe: bool | None
    hand_judged: bool
    table_contacts: int | None
    margin_kept_share: float | None = None


def evaluate_execution(
    execution: Execution,
    grid: OccupancyGrid,
    settings: MotionSettings,
    margin_m: float = 0.0,
    spacing_m: float = 0.0025,
) -> SafetyVerdict:
    """Evaluate the measured poses against the grid that the motion was planned in, and against the true hand.

    Without a hand in the simulated world, everything about it is None: not judged.

    Args:
        execution: the recording.
        grid: is evaluated at points of the tool ``spacing_m`` apart.
        settings: of the motion: delta, tool, tracking bound, and the smallest speed at which the bound is evaluated.
        margin_m: of the motion, around the unsafe set.

    Raises:
        SettingsError: the motion was executed with another tool.
    """
    if settings.body != execution.body:
        raise SettingsError(f"the motion was executed with {execution.body}, not with {settings.body}")
    judged, aside = execution.judged, ~execution.judged
    p_occupied = largest_p_occupied(execution, grid, settings.body, spacing_m)
    safe = p_occupied <= settings.delta
    worst = int(np.argmax(np.where(judged, p_occupied, -np.inf)))
    error, speed = execution.workspace_error_m[judged], execution.reference_speed_mps[judged]
    bound = settings.tracking
    excess = error - bound.error_m(np.maximum(speed, settings.v_min_mps))
    contacts, whole = int(execution.contacts.sum()), bool(safe[judged].all())
    kept = _margin_kept_share(execution, grid, settings, margin_m, spacing_m) if margin_m else None
    time_s, beside_hand = execution.time_s[judged], execution.beside_hand
    tool, arm = execution.tool_to_hand_m.min(), execution.arm_to_hand_m.min()
    succeeded = whole and kept in (None, 1.0) and execution.completed and contacts == 0 and bool(tool > 0)
    return SafetyVerdict(
        delta=float(settings.delta),
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
        min_speed_mps=settings.v_min_mps,
        by_speed=tuple(_by_speed(speed, error, excess)),
        min_tool_to_hand_m=float(tool) if math.isfinite(tool) else None,
        min_arm_to_hand_m=float(arm) if math.isfinite(arm) else None,
        contacts=contacts if beside_hand else None,
        duration_s=float(time_s[-1] - time_s[0]),
        safe=None if succeeded and not beside_hand else succeeded,
        hand_judged=beside_hand,
        table_contacts=None if beside_hand else contacts,
        margin_kept_share=kept,
    )


def _margin_kept_share(
    execution: Execution, grid: OccupancyGrid, settings: MotionSettings, margin_m: float, spacing_m: float
) -> float:
    p_occupied = largest_p_occupied(execution, grid.dilated(settings.delta, margin_m), settings.body, spacing_m)
    return float((p_occupied[execution.judged] <= settings.delta).mean())


def largest_p_occupied(execution: Execution, grid: OccupancyGrid, body: ToolBody, spacing_m: float = 0.0025) -> Array:
    """Return (N,) largest p_occupied at points of the tool, ``spacing_m`` apart, at each measured pose."""
    points = body_points(body, spacing_m)
    return np.asarray(
        grid.max_p_occupied_on(points, execution.tool_rotations, execution.tool_positions_m), dtype=np.float64
    )


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
