"""Safe velocity scheduling (section IV-C): as fast as clearance, tracking bound and acceleration limits allow."""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy import ndimage

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import PlanningError, SettingsError
from deltasafe.geometry import MAX_DURATION_S, PosePath, Trajectory
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.collision.segment_tests import (
    CheckSettings,
    SegmentTest,
    body_clearance_m,
    is_segment_safe,
    segment_test,
    verification_test,
)
from deltasafe.planning.timing.corner_blending import SmoothPath, blend_corners, without_repeats
from deltasafe.planning.tracking_bound import TrackingBound, tracking_of
from deltasafe.setting_ranges import check_range

Array = NDArray[np.float64]
CHORD_TOLERANCE_M = 0.00005
MIN_SPACING_M = 1e-5
MAX_RATE_HZ = 1e5
RESERVE_M = 0.001
"""Default of ``PlannerSettings.reserve_m``, by which the planner's margin exceeds that of the schedule."""

SAMPLE_TOLERANCE_M = 1e-5
"""Straight lines between samples leave the path by at most this; controllers interpolate between samples."""

MAX_ROUNDS = 6
"""Local corrections of the acceleration; what little remains is removed by slowing the whole motion down."""

LEAST_FINENESS = 0.1
NORMAL_FRACTION = 0.8
"""Largest fraction of the acceleration that may be normal to the path; at least 0.6 of it is left for the tangent."""

ROUNDING = 1e-3
"""Relative reserve for the variation of slopes and curvatures inside a cell."""


@dataclasses.dataclass(frozen=True)
class VelocitySettings:
    """Limits of the motion along a path. Speeds are those of the fastest point of the tool, |dx| + rho_max |dphi|.

    Attributes:
        v_min_mps: smallest speed; a path that does not allow it everywhere is refused.
        v_max_mps: largest speed.
        acceleration_mps2: largest acceleration, tangential and normal parts together, of any point within rho_max of
            the yaw axis; also of the arc length, so that the yaw acceleration is at most this over sqrt(r).
        yaw_rate_radps: largest yaw rate.
        blend_reach_m: corners are blended over at most this distance before and after them.
        spacing_m: resolution of the schedule; the limits hold in between as well.
        rate_hz: sampling rate of the trajectory and of the controller; at least sqrt(acceleration_mps2 / 8e-5 m), so
            that straight lines between samples leave the path by at most 0.01 mm.
    """

    v_min_mps: float = 0.01
    v_max_mps: float = 0.2
    acceleration_mps2: float = 0.5
    yaw_rate_radps: float = 1.0
    blend_reach_m: float = 0.02
    spacing_m: float = 0.0005
    rate_hz: float = 1000.0

    def __post_init__(self) -> None:
        check_range(self, "(0, inf)", *(field.name for field in dataclasses.fields(VelocitySettings)))
        if self.spacing_m < MIN_SPACING_M or self.rate_hz > MAX_RATE_HZ:  # the samples must fit into memory
            raise SettingsError(
                f"spacing_m must be at least {MIN_SPACING_M:g} m and rate_hz at most {MAX_RATE_HZ:g}, "
                f"got {self.spacing_m} and {self.rate_hz}"
            )
        least_hz = math.sqrt(self.acceleration_mps2 / (8 * SAMPLE_TOLERANCE_M))
        if self.rate_hz < least_hz:
            raise SettingsError(
                f"rate_hz must be at least {least_hz:.1f} at {self.acceleration_mps2} m/s^2, so that straight lines "
                f"between samples leave the path by at most {1e3 * SAMPLE_TOLERANCE_M} mm, got {self.rate_hz}"
            )
        if self.v_max_mps < self.v_min_mps:
            raise SettingsError(f"v_max_mps must be at least v_min_mps {self.v_min_mps}, got {self.v_max_mps}")


@dataclasses.dataclass(frozen=True)
class SpeedProfile:
    """Clearance, speed limit and speed at N poses along the blended path.

    Attributes:
        arc_length_m: (N,) of the tool's center.
        clearance_m: (N,) d_o, a lower bound of the distance to the unsafe set (table included).
        limit_mps: (N,) v*, the largest speed whose tracking error fits the clearance, at most v_max.
        speed_mps: (N,) scheduled speed of the tool's fastest point, at most the limit.
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
    """Time a path from rest to rest; return the trajectory and its speed profile.

    The limit v*(s) is the largest v in [v_min, v_max] with gamma(v) <= d_o(s) (section IV-C). Corners are blended, and
    the whole blended path is verified.

    Args:
        tracking: gamma; if None, that of the settings (``MotionSettings``), else the line of the paper.
        rotation_weight_m2: r of the arc length; if None, that of the settings, else 0.01.

    Raises:
        PlanningError: the clearance is below gamma(v_min) somewhere; names the place, pose and clearance.
        SettingsError: gamma(v_min) is beyond the reach of the field, or the weight is not positive and finite.
    """
    body, tracking = body or ToolBody(), tracking_of(settings, tracking)
    if rotation_weight_m2 is None:
        rotation_weight_m2 = float(getattr(settings, "rotation_weight_m2", 0.01))
    _require_weight(rotation_weight_m2)
    margin_m = float(tracking.error_m(settings.v_min_mps))
    reserve_m = float(getattr(settings, "reserve_m", RESERVE_M))
    test = verification_test(field, body, margin_m)
    _verify(test, path.poses, margin_m, body.rho_max_m, lambda: verification_test(field, body, margin_m + reserve_m))
    if _stands_still(path, rotation_weight_m2):
        return _standstill(path, test, margin_m, settings, tracking)
    # lengths along the path are those of the arc length, in which yaw may count less than in the motion of the tool
    fineness = min(1.0, math.sqrt(rotation_weight_m2) / body.rho_max_m)
    # the trajectory follows the arcs, but the test their chords: the margin includes the difference
    arc_test = segment_test(field, body, margin_m + CHORD_TOLERANCE_M, CheckSettings())
    curve = blend_corners(
        path.poses,
        rotation_weight_m2,
        settings.blend_reach_m,
        settings.spacing_m * max(fineness, LEAST_FINENESS),
        lambda arc: all(is_segment_safe(arc_test, a, b) for a, b in itertools.pairwise(arc)),
        CHORD_TOLERANCE_M * fineness,
    )
    motion_m = _motion(curve.poses, body.rho_max_m)
    # the balls that bound a part are too loose for its speed
    exact_below_m = float(tracking.error_m(settings.v_max_mps)) if body.parts else 0.0
    known_m = body_clearance_m(test, curve.poses, exact_below_m)
    clearance_m = np.maximum(_lipschitz(known_m, motion_m), margin_m)
    allowed_mps = np.clip(tracking.speed_mps(clearance_m), settings.v_min_mps, settings.v_max_mps)
    # between two poses, the clearance falls by at most the motion to the nearer one, and is verified to keep the margin
    lowest_m = np.maximum((clearance_m[:-1] + clearance_m[1:] - motion_m) / 2, margin_m)
    cell_mps = _smoothed(np.clip(tracking.speed_mps(lowest_m), settings.v_min_mps, settings.v_max_mps))
    rate = _rates(curve, cell_mps, settings, body.rho_max_m)
    trajectory = _sample(curve, rate, settings)
    before, after = (_point_speed(slope, body.rho_max_m) for slope in (curve.slope_before, curve.slope_after))
    steps_m = np.linalg.norm(np.diff(curve.poses[:, :3], axis=0), axis=1)
    arc_length_m = np.append(0.0, np.cumsum(steps_m))
    speed_mps = rate * np.maximum(before, after)
    return trajectory, SpeedProfile(arc_length_m, clearance_m, allowed_mps, speed_mps, curve.poses)


def schedule_at_top_speed(
    path: PosePath,
    is_safe: Callable[[Array], bool],
    settings: VelocitySettings,
    body: ToolBody | None = None,
    rotation_weight_m2: float = 0.01,
) -> Trajectory:
    """Time a path from rest to rest at ``v_max_mps``, limited by acceleration and yaw rate, but not by clearance.

    The baseline of velocity scheduling. Corners are blended as in ``schedule``.

    Args:
        is_safe: test of the arc of a blended corner, given by poses (M, 4) along it.

    Raises:
        SettingsError: a path without motion, or a weight that is not positive and finite.
    """
    _require_weight(rotation_weight_m2)
    if _stands_still(path, rotation_weight_m2):
        raise SettingsError("a path without motion has no top speed")
    curve = blend_corners(
        path.poses, rotation_weight_m2, settings.blend_reach_m, settings.spacing_m, is_safe, CHORD_TOLERANCE_M
    )
    cell_mps = np.full(len(curve.arc_length) - 1, settings.v_max_mps)
    return _sample(curve, _rates(curve, cell_mps, settings, (body or ToolBody()).rho_max_m), settings)


def _require_weight(rotation_weight_m2: float) -> None:
    if not 0 < rotation_weight_m2 < math.inf:
        raise SettingsError(f"rotation_weight_m2 must be positive and finite, got {rotation_weight_m2}")


def _rates(curve: SmoothPath, cell_mps: Array, settings: VelocitySettings, rho_max_m: float) -> Array:
    """dl/dt (N,) along the curve: forward and backward pass on its square, which is linear in each cell."""
    slopes = np.stack([curve.slope_after[:-1], curve.slope_before[1:]])
    reserve = 1 + ROUNDING * (curve.curvature > 0)
    fastest = _point_speed(slopes, rho_max_m).max(axis=0) * reserve
    turning = np.abs(slopes[..., 3]).max(axis=0) * reserve
    limit = np.minimum(cell_mps / fastest, settings.yaw_rate_radps / np.maximum(turning, 1e-9)) ** 2
    curvature = curve.curvature * (1 + ROUNDING)
    limit = np.minimum(limit, NORMAL_FRACTION * settings.acceleration_mps2 / np.maximum(curvature, 1e-9))
    tangential = np.sqrt(settings.acceleration_mps2**2 - (curvature * limit) ** 2)
    gain = 2 * tangential * np.diff(curve.arc_length) * (1 - ROUNDING)
    for _ in range(MAX_ROUNDS):
        squared = _reachable(limit, gain, np.array(curve.stops))
        excess = _acceleration(curve, squared, rho_max_m) / settings.acceleration_mps2
        over = (excess > 1 + ROUNDING) & (turning > 0)  # without rotation, the limits above are exact
        if not over.any():
            return np.sqrt(squared)
        limit[over] *= (1 - ROUNDING) / excess[over]
        gain[over] *= (1 - ROUNDING) / excess[over]
    return np.sqrt(squared / excess[over].max())


@compiled
def _reachable(limit, gain, stops):  # type: ignore[no-untyped-def]
    """Largest squared rates (N,) within the limits (N - 1,) that change by at most ``gain`` in each cell."""
    squared = np.empty(len(limit) + 1)
    squared[0], squared[-1] = limit[0], limit[-1]
    squared[1:-1] = np.minimum(limit[:-1], limit[1:])
    squared[stops] = 0.0
    for n in range(len(gain)):
        squared[n + 1] = min(squared[n + 1], squared[n] + gain[n])
    for n in range(len(gain) - 1, -1, -1):
        squared[n] = min(squared[n], squared[n + 1] + gain[n])
    return squared


def _acceleration(curve: SmoothPath, squared: Array, rho_max_m: float) -> Array:
    """Largest acceleration (N - 1,) in each cell of any point at most ``rho_max_m`` from the yaw axis, in m/s^2.

    With the squared rate s and its half derivative a, the pose accelerates by bend s + slope a. A point off the axis
    adds the tangential part rho phi'' and the centripetal part rho phi'^2, in the plane.
    """
    tangential = (np.diff(squared) / (2 * np.diff(curve.arc_length)))[:, None, None]
    slope = np.stack([curve.slope_after[:-1], curve.slope_before[1:]], axis=1)
    rate = np.stack([squared[:-1], squared[1:]], axis=1)[:, :, None]
    pose = curve.bend * rate + slope * tangential
    turn = rho_max_m * np.hypot(pose[..., 3], slope[..., 3] ** 2 * rate[..., 0])
    return np.asarray(np.hypot(np.hypot(pose[..., 0], pose[..., 1]) + turn, pose[..., 2]).max(axis=1))


def _sample(curve: SmoothPath, rate: Array, settings: VelocitySettings) -> Trajectory:
    """Sample the timed path at the controller's rate; the duration is stretched to a whole number of periods."""
    cells = np.diff(curve.arc_length)
    times = np.append(0.0, np.cumsum(2 * cells / (rate[:-1] + rate[1:])))
    if not times[-1] <= MAX_DURATION_S:
        raise PlanningError(
            f"the motion would take {times[-1]:.3g} s, but at most {MAX_DURATION_S:g} s are allowed; raise v_min_mps"
        )
    periods = max(1, math.ceil(times[-1] * settings.rate_hz - 1e-9))
    stretch = periods / settings.rate_hz / times[-1]
    time_s = np.arange(periods + 1) / settings.rate_hz
    clock = np.minimum(time_s / stretch, times[-1])
    cell = np.clip(np.searchsorted(times, clock, "right") - 1, 0, len(cells) - 1)
    since = clock - times[cell]
    gain = (rate[1:] ** 2 - rate[:-1] ** 2) / (2 * cells)
    arc_length = curve.arc_length[cell] + since * (rate[cell] + gain[cell] * since / 2)
    sample_rate = np.maximum(rate[cell] + gain[cell] * since, 0.0) / stretch
    sample_rate[0] = sample_rate[-1] = 0.0
    poses, slopes = curve.at(np.clip(arc_length, 0, curve.arc_length[-1]))
    poses[0], poses[-1] = curve.poses[0], curve.poses[-1]
    return Trajectory(time_s, poses, slopes * sample_rate[:, None])


def _stands_still(path: PosePath, rotation_weight_m2: float) -> bool:
    return len(without_repeats(path.poses * [1.0, 1.0, 1.0, math.sqrt(rotation_weight_m2)])) == 1


def _standstill(
    path: PosePath, test: SegmentTest, margin_m: float, settings: VelocitySettings, tracking: TrackingBound
) -> tuple[Trajectory, SpeedProfile]:
    poses = path.poses[:1]
    clearance_m = np.maximum(body_clearance_m(test, poses), margin_m)
    allowed_mps = np.clip(tracking.speed_mps(clearance_m), settings.v_min_mps, settings.v_max_mps)
    still = np.zeros(1)
    return (
        Trajectory(still, poses, np.zeros((1, 4))),
        SpeedProfile(still, clearance_m, allowed_mps, still, poses),
    )


def _verify(
    test: SegmentTest, poses: Array, margin_m: float, rho_max_m: float, planners_test: Callable[[], SegmentTest]
) -> None:
    """Test whole edges, as the planner does: a conservative test may refuse pieces of an edge that it accepts.

    For the same reason, an edge that is refused is tested with the planner's margin as well.
    """
    arc_length_m = 0.0
    for a, b in itertools.pairwise(poses if len(poses) > 1 else poses[[0, 0]]):
        leg_m = float(np.linalg.norm((b - a)[:3]))
        if not is_segment_safe(test, a, b):
            if is_segment_safe(planners_test(), a, b):
                arc_length_m += leg_m
                continue
            fractions = np.linspace(0.0, 1.0, 2 + int(_motion(np.array([a, b]), rho_max_m)[0] / 0.0005))
            on_edge = a + fractions[:, None] * (b - a)
            clearance_m = body_clearance_m(test, on_edge)
            worst = int(clearance_m.argmin())
            at_m = arc_length_m + fractions[worst] * leg_m
            raise PlanningError(_too_close(at_m, on_edge[worst], float(clearance_m[worst]), margin_m))
        arc_length_m += leg_m


def _too_close(arc_length_m: float, pose: Array, clearance_m: float, margin_m: float) -> str:
    return (
        f"the path is too close to occupied space for the smallest speed: at {arc_length_m:.4f} m along it, pose "
        f"{np.round(pose, 4).tolist()}, the clearance is {1000 * clearance_m:.2f} mm and gamma(v_min) is "
        f"{1000 * margin_m:.2f} mm; plan with this tracking bound, or lower v_min_mps"
    )


def _point_speed(slopes: Array, rho_max_m: float) -> Array:
    """Bound of the speed of the tool's fastest point, |dx| + rho_max |dphi|."""
    return np.asarray(np.linalg.norm(slopes[..., :3], axis=-1) + rho_max_m * np.abs(slopes[..., 3]))


def _motion(poses: Array, rho_max_m: float) -> Array:
    return _point_speed(np.diff(poses, axis=0), rho_max_m)


def _smoothed(limit: Array, reach: int = 5) -> Array:
    """Smooth a limit without exceeding it: the moving average of its running minimum over the same window."""
    width = 2 * reach + 1
    least = ndimage.minimum_filter1d(limit, width, mode="nearest")
    return np.asarray(np.minimum(ndimage.uniform_filter1d(least, width, mode="nearest"), limit))


def _lipschitz(clearance_m: Array, motion_m: Array) -> Array:
    """Tighten lower bounds of the clearance by those of the other poses: clearance is 1-Lipschitz in the motion."""
    bound = clearance_m.copy()
    for n in range(len(motion_m)):
        bound[n + 1] = max(bound[n + 1], bound[n] - motion_m[n])
    for n in range(len(motion_m) - 1, -1, -1):
        bound[n] = max(bound[n], bound[n + 1] - motion_m[n])
    return bound
