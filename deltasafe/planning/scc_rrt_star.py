"""SCC-RRT* (section IV-B): RRT* whose segments are tested for delta-safety, and the verdict on what it found."""

import dataclasses
import enum
import itertools
import math

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose, PosePath, wrap_to_pi
from deltasafe.planning.body import ToolBody
from deltasafe.planning.checks import (
    CheckSettings,
    body_clearance_m,
    is_segment_safe,
    segment_test,
)
from deltasafe.planning.cost import COSTS, area_m2, line_cost, path_cost
from deltasafe.planning.field import SafetyField
from deltasafe.planning.refine import refine_path
from deltasafe.planning.rrt_star import grow_tree
from deltasafe.planning.tracking import TrackingBound

__all__ = ["PlanResult", "PlanStatus", "PlannerSettings", "plan"]

Array = NDArray[np.float64]


class PlanStatus(enum.StrEnum):
    """How a search ended."""

    SOLVED = "solved"
    UNVERIFIED = "path fails the continuous check"
    BUDGET_SPENT = "budget spent"
    START_UNSAFE = "start unsafe"
    GOAL_UNSAFE = "goal unsafe"
    NO_CONNECTION = "no connection"


@dataclasses.dataclass(frozen=True)
class PlannerSettings(CheckSettings):
    """Settings of SCC-RRT*; those of the segment test included.

    Attributes:
        delta: a point may be occupied with at most this probability.
        n_iterations: N_iter, samples drawn by the search.
        v_min_mps: smallest speed; its tracking error is part of the margin (section IV-A).
        reserve_m: kept beyond that margin, room for blending the corners.
        cost: ``root``, ``squared`` or ``area``.
        rotation_weight_m2: r of the line cost, in m^2/rad^2.
        length_weight_m: share of the root cost in the ``area`` cost.
        steering_range_m, goal_bias, near_factor, informed: see ``grow_tree``.
        n_refinements: random local changes tried on the result; 0 leaves the tree's own path.
        z_min_above_table_m: lowest centre of the disc.
        z_max_above_field_m: highest centre of the disc, above the upper face of the field.
        yaw_range_rad: yaw stays within this of the start's (or of the goal's, if that is farther).
    """

    delta: float = 0.05
    n_iterations: int = 2000
    v_min_mps: float = 0.01
    reserve_m: float = 0.001
    cost: str = "root"
    rotation_weight_m2: float = 0.01
    length_weight_m: float = 0.02
    steering_range_m: float = 0.1
    goal_bias: float = 0.05
    near_factor: float = 1.1
    informed: bool = True
    n_refinements: int = 400
    z_min_above_table_m: float = 0.02
    z_max_above_field_m: float = 0.07
    yaw_range_rad: float = math.pi / 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0 < self.delta < 1:
            raise SettingsError(f"delta must be in (0, 1), got {self.delta}")
        if not (1 <= self.n_iterations <= 1_000_000 and self.n_refinements >= 0):
            raise SettingsError(
                f"n_iterations must be in [1, 1e6] and n_refinements not negative, "
                f"got {self.n_iterations} and {self.n_refinements}"
            )
        if self.cost not in COSTS:
            raise SettingsError(f"cost must be one of {COSTS}, got {self.cost!r}")
        for name in (
            "v_min_mps",
            "rotation_weight_m2",
            "length_weight_m",
            "steering_range_m",
            "near_factor",
            "z_max_above_field_m",
        ):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingsError(f"{name} must be positive, got {getattr(self, name)}")
        for name in ("reserve_m", "z_min_above_table_m"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0):
                raise SettingsError(f"{name} must not be negative, got {getattr(self, name)}")
        if not 0 <= self.goal_bias < 1:
            raise SettingsError(f"goal_bias must be in [0, 1), got {self.goal_bias}")
        if not 0 <= self.yaw_range_rad <= math.pi:
            raise SettingsError(f"yaw_range_rad must be in [0, pi], got {self.yaw_range_rad}")


@dataclasses.dataclass(frozen=True)
class PlanResult:
    """What the search found, and whether it holds.

    Attributes:
        status: how it ended; only a ``SOLVED`` path has passed the continuous check.
        path: poses from start to goal, or None. An ``UNVERIFIED`` path is shown, never to be executed.
        margin_m: distance to the unsafe set that was asked for.
        clearance_m: of the offending pose if start or goal is unsafe, else the smallest along the path.
        cost: of the path, by the settings' line cost; ``cost_squared_m2`` and ``area_m2`` beside it.
        n_iterations, n_nodes, solved_at: samples drawn, nodes of the tree, first iteration with a path (-1: none).
        message: the outcome in a sentence.
    """

    status: PlanStatus
    path: PosePath | None
    margin_m: float
    clearance_m: float
    cost: float | None
    cost_squared_m2: float | None
    area_m2: float | None
    n_iterations: int
    n_nodes: int
    solved_at: int
    message: str


def plan(
    start: Pose,
    goal: Pose,
    field: SafetyField,
    settings: PlannerSettings,
    seed: int,
    body: ToolBody | None = None,
    tracking: TrackingBound | None = None,
) -> PlanResult:
    """Search a delta-safe path. Whatever the search's own test, the path it returns is verified continuously.

    delta-safety is pointwise (decision 10): it bounds neither the collision probability of the whole body nor of
    the whole motion. Failure to find a path is an outcome with its reason, not an exception.

    Raises:
        SettingsError: the field was built for another delta, or the margin is beyond the field's reach.
    """
    body, tracking = body or ToolBody(), tracking or TrackingBound()
    if field.delta != settings.delta:
        raise SettingsError(f"the field was built for delta {field.delta}, the settings ask {settings.delta}")
    margin_m = float(tracking.error_m(settings.v_min_mps)) + settings.reserve_m
    verifier = segment_test(field, body, margin_m, dataclasses.replace(_checks(settings), method="continuous"), seed)
    ends = start.as_array(), goal.as_array()
    ends[1][3] = ends[0][3] + float(wrap_to_pi(ends[1][3] - ends[0][3]))
    for name, pose, status in zip(
        ("start", "goal"), ends, (PlanStatus.START_UNSAFE, PlanStatus.GOAL_UNSAFE), strict=True
    ):
        clearance_m = float(body_clearance_m(verifier, pose[None])[0])
        if clearance_m < margin_m + settings.resolution_m:
            return _failure(
                status,
                margin_m,
                clearance_m,
                f"the {name} {np.round(pose, 4).tolist()} has a clearance of {1000 * clearance_m:.1f} mm, "
                f"{1000 * margin_m:.1f} mm are needed: move it away from what may be occupied",
            )
    lower, upper = _bounds(field, settings, *ends)
    cost = line_cost(settings.cost, settings.rotation_weight_m2, field.arrays.floor_z_m, settings.length_weight_m)
    test = segment_test(field, body, margin_m, _checks(settings), seed)
    tree = grow_tree(
        test,
        cost,
        *ends,
        lower,
        upper,
        settings.n_iterations,
        seed,
        settings.steering_range_m,
        settings.goal_bias,
        settings.near_factor,
        settings.informed,
    )
    poses = tree.path()
    counts = (settings.n_iterations, len(tree.nodes), tree.solved_at)
    if poses is None:
        if not _is_connected(field, body, margin_m, lower, upper, *ends):
            return _failure(
                PlanStatus.NO_CONNECTION,
                margin_m,
                math.nan,
                "start and goal lie in parts of the free space that nothing as thick as the tool connects",
                *counts,
            )
        return _failure(
            PlanStatus.BUDGET_SPENT,
            margin_m,
            math.nan,
            f"no path in {settings.n_iterations} iterations ({len(tree.nodes)} nodes): raise n_iterations",
            *counts,
        )
    poses = refine_path(test, cost, poses, lower, upper, settings.n_refinements, seed)
    safe = [is_segment_safe(verifier, a, b) for a, b in itertools.pairwise(poses)]
    clearance_m = float(body_clearance_m(verifier, _dense(poses, 0.001, body.rho_max_m)).min())
    squared = line_cost("squared", settings.rotation_weight_m2)
    return PlanResult(
        PlanStatus.SOLVED if all(safe) else PlanStatus.UNVERIFIED,
        PosePath(poses),
        margin_m,
        clearance_m,
        path_cost(cost, poses),
        path_cost(squared, poses),
        area_m2(poses, field.arrays.floor_z_m),
        *counts,
        f"{len(poses)} poses, first found in iteration {tree.solved_at + 1}"
        if all(safe)
        else f"{len(safe) - sum(safe)} of {len(safe)} segments fail the continuous check: use method continuous",
    )


def _checks(settings: PlannerSettings) -> CheckSettings:
    return CheckSettings(**{f.name: getattr(settings, f.name) for f in dataclasses.fields(CheckSettings)})


def _failure(
    status: PlanStatus,
    margin_m: float,
    clearance_m: float,
    message: str,
    n_iterations: int = 0,
    n_nodes: int = 0,
    solved_at: int = -1,
) -> PlanResult:
    return PlanResult(status, None, margin_m, clearance_m, None, None, None, n_iterations, n_nodes, solved_at, message)


def _bounds(field: SafetyField, settings: PlannerSettings, start: Array, goal: Array) -> tuple[Array, Array]:
    turn = settings.yaw_range_rad
    low_z, high_z = field.arrays.floor_z_m + settings.z_min_above_table_m, field.top_z_m
    lower = np.array([*field.grid.origin_m[:2], low_z, start[3] - turn])
    upper = np.array([*field.grid.upper_m[:2], high_z + settings.z_max_above_field_m, start[3] + turn])
    return np.minimum(lower, np.minimum(start, goal)), np.maximum(upper, np.maximum(start, goal))


def _is_connected(
    field: SafetyField,
    body: ToolBody,
    margin_m: float,
    lower: Array,
    upper: Array,
    start: Array,
    goal: Array,
) -> bool:
    """A necessary condition: a chain of voxels where a ball inside the disc and the shaft could pass.

    Optimistic by half a voxel diagonal, so that False proves that no path exists within the bounds.
    """
    arrays = field.arrays
    voxel_m = arrays.lattice.voxel_m
    slack_m = voxel_m * math.sqrt(3) / 2 * (1 + 1e-6)
    inscribed_m = min(body.semi_axis_x_m, body.semi_axis_y_m, body.thickness_m / 2)
    passable = (arrays.ball + slack_m >= inscribed_m + margin_m) & (
        arrays.ray + slack_m >= body.shaft_radius_m + margin_m
    )
    shape = np.array(passable.shape)
    origin_m = np.array(arrays.lattice[:3])
    first, last = ((value[:3] - origin_m) // voxel_m for value in (lower, upper))
    if last[2] >= shape[2]:
        return True  # the bounds leave the stored box, where all is free
    passable[:, :, : max(int(first[2]), 0)] = False
    passable[:, :, int(last[2]) + 1 :] = False
    labels, _ = ndimage.label(passable, structure=np.ones((3, 3, 3)))
    cells = [tuple(np.clip((pose[:3] - origin_m) // voxel_m, 0, shape - 1).astype(int)) for pose in (start, goal)]
    return bool(labels[cells[0]] != 0 and labels[cells[0]] == labels[cells[1]])


def _dense(poses: Array, spacing_m: float, rho_max_m: float) -> Array:
    """The polyline with poses at most ``spacing_m`` apart."""
    pieces = [poses[:1]]
    for a, b in itertools.pairwise(poses):
        count = max(1, math.ceil(float(np.linalg.norm((b - a)[:3]) + rho_max_m * abs(b[3] - a[3])) / spacing_m))
        pieces.append(a + np.arange(1, count + 1)[:, None] / count * (b - a))
    return np.concatenate(pieces)
