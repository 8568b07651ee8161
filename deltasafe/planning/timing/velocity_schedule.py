"""Safe velocity scheduling (section IV-C): as fast as clearance, tracking bound and accelerations allow."""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.geometry import LONGEST_S, PosePath, Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.collision.segment_tests import (
    CheckSettings,
    SegmentTest,
    body_clearance_m,
    is_segment_safe,
    segment_test,
)
from deltasafe.planning.timing.corner_blending import SmoothPath, blend_corners
from deltasafe.planning.tracking_bound import TrackingBound, tracking_of

__all__ = ["SpeedProfile", "VelocitySettings", "schedule", "schedule_at_top_speed"]

Array = NDArray[np.float64]
CHORD_TOLERANCE_M = 0.00005
LEAST_SPACING_M = 1e-5
MOST_RATE_HZ = 1e5


@dataclasses.dataclass(frozen=True)
class VelocitySettings:
    """Limits of the motion along a path. Speeds are those of the fastest point of the tool: |dx| + rho_max |dphi|.

    Attributes:
        v_min_mps: a path that does not admit this speed everywhere is refused.
        v_max_mps: largest speed of the robot.
        acceleration_mps2: bound of the acceleration, tangential and normal together.
        yaw_rate_radps: bound of the yaw rate.
        blend_reach_m: corners are blended from at most this far before to this far after them.
        spacing_m: resolution of the schedule; the limits hold in between as well.
        rate_hz: sampling rate of the trajectory, the controller's.
    """

    v_min_mps: float = 0.01
    v_max_mps: float = 0.2
    acceleration_mps2: float = 0.5
    yaw_rate_radps: float = 1.0
    blend_reach_m: float = 0.02
    spacing_m: float = 0.0005
    rate_hz: float = 1000.0

    def __post_init__(self) -> None:
        for field in dataclasses.fields(VelocitySettings):
            value = getattr(self, field.name)
            if not (math.isfinite(value) and value > 0):
                raise SettingsError(f"{field.name} must be positive, got {value}")
        if self.spacing_m < LEAST_SPACING_M or self.rate_hz > MOST_RATE_HZ:  # arrays of them must fit into memory
            raise SettingsError(
                f"spacing_m must be at least {LEAST_SPACING_M:g} m and rate_hz at most {MOST_RATE_HZ:g}, "
                f"got {self.spacing_m} and {self.rate_hz}"
            )
        if self.v_max_mps < self.v_min_mps:
            raise SettingsError(f"v_max_mps must be at least v_min_mps {self.v_min_mps}, got {self.v_max_mps}")


@dataclasses.dataclass(frozen=True)
class SpeedProfile:
    """Why the motion is as fast as it is, at N places along the blended path.

    Attributes:
        arc_length_m: (N,) way of the tool's center.
        clearance_m: (N,) d_o, a lower bound of the distance to the unsafe set (table included).
        limit_mps: (N,) v*, the largest speed whose tracking error fits the clearance, at most v_max.
        speed_mps: (N,) scheduled speed of the tool's fastest point, never above the limit.
        poses: (N, 4) of the path.
    """

    arc_length_m: Array
    clearance_m: Array
    limit_mps: Array
    speed_mps: Array
    poses: Array

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            value = np.array(getattr(self, field.name), dtype=np.float64)
            value.setflags(write=False)
            object.__setattr__(self, field.name, value)
        if {len(getattr(self, field.name)) for field in dataclasses.fields(self)} != {len(self.poses)}:
            raise SettingsError("the columns of a speed profile must be equally long")


def schedule(
    path: PosePath,
    field: DistanceField,
    settings: VelocitySettings,
    body: ToolBody | None = None,
    tracking: TrackingBound | None = None,
    rotation_weight_m2: float | None = None,
) -> tuple[Trajectory, SpeedProfile]:
    """Trajectory along a path, from rest to rest, and the profile behind it.

    v*(s) is the largest v with gamma(v) <= d_o(s), in [v_min, v_max] (section IV-C); corners are blended, and the
    blended path is verified along its whole length before anything is timed.

    Args:
        tracking: gamma; that of the settings if None and they have one (``MotionSettings``), else the paper's line.
        rotation_weight_m2: of the path's length; that of the settings if None and they have one, else 0.01.

    Raises:
        PlanningError: somewhere the path is not clear by gamma(v_min); names the place, pose and clearance.
        SettingsError: not even a standing robot has a tracking error within the field's reach, or the weight is not
            positive and finite.
    """
    body, tracking = body or ToolBody(), tracking_of(settings, tracking)
    if rotation_weight_m2 is None:
        rotation_weight_m2 = float(getattr(settings, "rotation_weight_m2", 0.01))
    _require_weight(rotation_weight_m2)
    margin_m = float(tracking.error_m(settings.v_min_mps))
    test = segment_test(field, body, margin_m, CheckSettings())
    if len(path) == 1:
        return _standstill(path, test, margin_m, settings, tracking)
    _verify(test, path.poses, margin_m, body.rho_max_m)
    # the trajectory follows the arcs, the test their chords: the difference is part of the margin
    arc_test = segment_test(field, body, margin_m + CHORD_TOLERANCE_M, CheckSettings())
    curve = blend_corners(
        path.poses,
        rotation_weight_m2,
        settings.blend_reach_m,
        settings.spacing_m,
        lambda arc: all(is_segment_safe(arc_test, a, b) for a, b in itertools.pairwise(arc)),
        CHORD_TOLERANCE_M,
    )
    motion_m = _motion(curve.poses, body.rho_max_m)
    clearance_m = np.maximum(_lipschitz(body_clearance_m(test, curve.poses), motion_m), margin_m)
    allowed_mps = np.clip(tracking.speed_mps(clearance_m), settings.v_min_mps, settings.v_max_mps)
    # between two places the clearance falls by at most the way to the nearer one, but never below the margin
    lowest_m = np.maximum((clearance_m[:-1] + clearance_m[1:] - motion_m) / 2, margin_m)
    cell_mps = _smoothed(np.clip(tracking.speed_mps(lowest_m), settings.v_min_mps, settings.v_max_mps))
    rate = _rates(curve, cell_mps, settings, body.rho_max_m, rotation_weight_m2)
    trajectory = _sampled(curve, rate, settings)
    per_length = np.maximum(_point_speed(curve.before, body.rho_max_m), _point_speed(curve.after, body.rho_max_m))
    steps_m = np.linalg.norm(np.diff(curve.poses[:, :3], axis=0), axis=1)
    profile = SpeedProfile(np.append(0.0, np.cumsum(steps_m)), clearance_m, allowed_mps, rate * per_length, curve.poses)
    return trajectory, profile


def schedule_at_top_speed(
    path: PosePath,
    is_safe: Callable[[Array], bool],
    settings: VelocitySettings,
    body: ToolBody | None = None,
    rotation_weight_m2: float = 0.01,
) -> Trajectory:
    """Trajectory from rest to rest at ``v_max_mps`` wherever accelerations and the yaw rate admit it, whatever is near.

    What velocity scheduling is compared with. Corners are blended as by ``schedule``.

    Args:
        is_safe: whether the arc of a blended corner, given by poses (M, 4) along it, may be driven.

    Raises:
        SettingsError: a path of a single pose, which has no speed; or a weight that is not positive and finite.
    """
    _require_weight(rotation_weight_m2)
    if len(path) == 1:
        raise SettingsError("a path of a single pose has no top speed")
    curve = blend_corners(
        path.poses, rotation_weight_m2, settings.blend_reach_m, settings.spacing_m, is_safe, CHORD_TOLERANCE_M
    )
    rho_max_m = (body or ToolBody()).rho_max_m
    cell_mps = np.full(len(curve.length) - 1, settings.v_max_mps)
    return _sampled(curve, _rates(curve, cell_mps, settings, rho_max_m, rotation_weight_m2), settings)


def _require_weight(rotation_weight_m2: float) -> None:
    if not 0 < rotation_weight_m2 < math.inf:
        raise SettingsError(f"rotation_weight_m2 must be positive and finite, got {rotation_weight_m2}")


def _rates(curve: SmoothPath, cell_mps: Array, settings: VelocitySettings, rho_max_m: float, weight_m2: float) -> Array:
    """dl/dt (N,) at the places of the curve: forward and backward pass on its square, linear in each cell."""
    slopes = np.stack([curve.after[:-1], curve.before[1:]])
    spread = 1 + 1e-3 * (curve.bend > 0)  # slopes inside a bent cell differ a little from those at its ends
    fastest = _point_speed(slopes, rho_max_m).max(axis=0) * spread
    turning = np.abs(slopes[..., 3]).max(axis=0) * spread
    most = np.minimum(cell_mps / fastest, settings.yaw_rate_radps / np.maximum(turning, 1e-9)) ** 2
    # of the acceleration at most 0.8 may be normal to the path; what is left of it, at least 0.6, is tangential
    bend = curve.bend * (1 + 1e-3)
    most = np.minimum(most, 0.8 * settings.acceleration_mps2 / np.maximum(bend, 1e-9))
    tangential = np.sqrt(settings.acceleration_mps2**2 - (bend * most) ** 2)
    squared = np.minimum(np.append(most, np.inf), np.append(np.inf, most))
    squared[list(curve.stops)] = 0.0
    gain = 2 * tangential * np.diff(curve.length) * (1 - 1e-3)
    for n in range(len(gain)):
        squared[n + 1] = min(squared[n + 1], squared[n] + gain[n])
    for n in range(len(gain) - 1, -1, -1):
        squared[n] = min(squared[n], squared[n + 1] + gain[n])
    return np.sqrt(squared)


def _sampled(curve: SmoothPath, rate: Array, settings: VelocitySettings) -> Trajectory:
    """The timed path at the controller's rate. The duration is stretched to a whole number of periods."""
    cells = np.diff(curve.length)
    times = np.append(0.0, np.cumsum(2 * cells / (rate[:-1] + rate[1:])))
    if not times[-1] <= LONGEST_S:
        raise PlanningError(f"the motion would take {times[-1]:.3g} s, {LONGEST_S:g} s are allowed; raise v_min_mps")
    periods = max(1, math.ceil(times[-1] * settings.rate_hz - 1e-9))
    stretch = periods / settings.rate_hz / times[-1]
    time_s = np.arange(periods + 1) / settings.rate_hz
    clock = np.minimum(time_s / stretch, times[-1])
    cell = np.clip(np.searchsorted(times, clock, "right") - 1, 0, len(cells) - 1)
    since = clock - times[cell]
    gain = (rate[1:] ** 2 - rate[:-1] ** 2) / (2 * cells)
    length = np.clip(curve.length[cell] + since * (rate[cell] + gain[cell] * since / 2), 0, curve.length[-1])
    pace = np.maximum(rate[cell] + gain[cell] * since, 0.0) / stretch
    pace[0] = pace[-1] = 0.0
    poses, slopes = curve.at(length)
    poses[0], poses[-1] = curve.poses[0], curve.poses[-1]
    return Trajectory(time_s, poses, slopes * pace[:, None])


def _standstill(
    path: PosePath, test: SegmentTest, margin_m: float, settings: VelocitySettings, tracking: TrackingBound
) -> tuple[Trajectory, SpeedProfile]:
    clearance_m = body_clearance_m(test, path.poses)
    if clearance_m[0] < margin_m:
        raise PlanningError(_place(0.0, path.poses[0], float(clearance_m[0]), margin_m))
    allowed_mps = np.clip(tracking.speed_mps(clearance_m), settings.v_min_mps, settings.v_max_mps)
    still = np.zeros(1)
    return (
        Trajectory(still, path.poses, np.zeros((1, 4))),
        SpeedProfile(still, clearance_m, allowed_mps, still, path.poses),
    )


def _verify(test: SegmentTest, poses: Array, margin_m: float, rho_max_m: float) -> None:
    """Test the edges whole, as the planner did: a conservative test may refuse pieces of an edge it passes."""
    way_m = 0.0
    for a, b in itertools.pairwise(poses):
        leg_m = float(np.linalg.norm((b - a)[:3]))
        if not is_segment_safe(test, a, b):
            shares = np.linspace(0.0, 1.0, 2 + int(_motion(np.array([a, b]), rho_max_m)[0] / 0.0005))
            near = a + shares[:, None] * (b - a)
            clearance_m = body_clearance_m(test, near)
            worst = int(clearance_m.argmin())
            raise PlanningError(_place(way_m + shares[worst] * leg_m, near[worst], float(clearance_m[worst]), margin_m))
        way_m += leg_m


def _place(way_m: float, pose: Array, clearance_m: float, margin_m: float) -> str:
    return (
        f"the path is not clear enough for the smallest speed: at {way_m:.4f} m along it, pose "
        f"{np.round(pose, 4).tolist()}, the clearance is {1000 * clearance_m:.2f} mm and gamma(v_min) is "
        f"{1000 * margin_m:.2f} mm; plan with this tracking bound, or lower v_min_mps"
    )


def _point_speed(slopes: Array, rho_max_m: float) -> Array:
    return np.asarray(np.linalg.norm(slopes[..., :3], axis=-1) + rho_max_m * np.abs(slopes[..., 3]))


def _motion(poses: Array, rho_max_m: float) -> Array:
    return _point_speed(np.diff(poses, axis=0), rho_max_m)


def _smoothed(limit: Array, reach: int = 5) -> Array:
    """A calmer limit that is nowhere above the given one: the mean of its running minima over the same window."""
    width = 2 * reach + 1
    least = ndimage.minimum_filter1d(limit, width, mode="nearest")
    return np.asarray(np.minimum(ndimage.uniform_filter1d(least, width, mode="nearest"), limit))


def _lipschitz(clearance_m: Array, motion_m: Array) -> Array:
    """The best lower bound at each place that the bounds at all places imply: clearance is 1-Lipschitz."""
    bound = clearance_m.copy()
    for n in range(len(motion_m)):
        bound[n + 1] = max(bound[n + 1], bound[n] - motion_m[n])
    for n in range(len(motion_m) - 1, -1, -1):
        bound[n] = max(bound[n], bound[n + 1] - motion_m[n])
    return bound
