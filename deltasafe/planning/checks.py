"""Is a segment of poses delta-safe? Three tests behind one interface (decision 16)."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.errors import SettingsError
from deltasafe.planning.body import ToolBody
from deltasafe.planning.constraint import answers_segments, ask_segment
from deltasafe.planning.field import FieldArrays, SafetyField, clearance_at

__all__ = ["METHODS", "CheckSettings", "SegmentTest", "body_clearance_m", "is_segment_safe", "segment_test"]

METHODS = ("sampled", "exact", "continuous")
POOL_SIZE = 16384

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class CheckSettings:
    """How a segment is tested.

    Attributes:
        method: ``sampled``, the paper's: N_x points of the enlarged body at poses at most ``delta_p_m`` apart;
            ``exact``: the distance transform at the same poses; ``continuous``: it along the whole segment.
        n_samples: N_x of ``sampled``.
        redraw_samples: draw anew for each pose (the paper), or keep one fixed set.
        delta_p_m: largest motion of any point of the body between two tested poses, for the first two methods;
            half of it is part of their margin (decision 18).
        resolution_m: ``continuous`` refuses when it cannot decide pieces with less motion than twice this.
        use_certificate: settle poses far from obstacles by a coarse grid; changes nothing but the time.
    """

    method: str = "continuous"
    n_samples: int = 100
    redraw_samples: bool = True
    delta_p_m: float = 0.01
    resolution_m: float = 0.00025
    use_certificate: bool = True

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise SettingsError(f"method must be one of {METHODS}, got {self.method!r}")
        if not 1 <= self.n_samples <= POOL_SIZE:
            raise SettingsError(f"n_samples must be between 1 and {POOL_SIZE}, got {self.n_samples}")
        for name in ("delta_p_m", "resolution_m"):
            if not (math.isfinite(getattr(self, name)) and 1e-5 <= getattr(self, name) <= 0.1):
                raise SettingsError(f"{name} must be between 1e-5 and 0.1 m, got {getattr(self, name)}")


class SegmentTest(NamedTuple):
    """All that a test needs, as compiled code reads it. Made by ``segment_test``."""

    method: int
    field: FieldArrays
    cover: Array
    cover_radius_m: float
    disc_radius_m: float
    half_thickness_m: float
    shaft_radius_m: float
    rho_max_m: float
    margin_m: float
    delta_p_m: float
    resolution_m: float
    samples: Array
    n_samples: int
    redraw_samples: bool
    use_certificate: bool
    seed: int


def segment_test(
    field: SafetyField,
    body: ToolBody,
    margin_m: float,
    settings: CheckSettings | None = None,
    seed: int = 0,
) -> SegmentTest:
    """Test of segments of a body that keeps ``margin_m`` (gamma at the smallest speed) from the unsafe set.

    Raises:
        SettingsError: the margin is negative or beyond the reach of the field's distances.
    """
    settings = settings or CheckSettings()
    if not (math.isfinite(margin_m) and 0 <= margin_m <= 0.02):
        raise SettingsError(f"margin_m must be between 0 and 0.02 m, got {margin_m}")
    cover, cover_radius_m = body.disc_cover
    sampled = settings.method == "sampled"
    return SegmentTest(
        method=METHODS.index(settings.method),
        field=field.arrays,
        cover=cover,
        cover_radius_m=cover_radius_m,
        disc_radius_m=body.disc_radius_m,
        half_thickness_m=body.thickness_m / 2,
        shaft_radius_m=body.shaft_radius_m,
        rho_max_m=body.rho_max_m,
        margin_m=float(margin_m),
        delta_p_m=settings.delta_p_m,
        resolution_m=settings.resolution_m,
        samples=body.samples(margin_m + settings.delta_p_m / 2, POOL_SIZE if sampled else 1, seed),
        n_samples=settings.n_samples,
        redraw_samples=settings.redraw_samples,
        use_certificate=settings.use_certificate,
        seed=seed,
    )


def is_segment_safe(test: SegmentTest, start: Array, end: Array) -> bool:
    """Whether the segment between two poses (4,), yaw turning linearly, passes; symmetric in its ends."""
    return bool(
        ask_segment(test, np.asarray(start, dtype=np.float64).copy(), np.asarray(end, dtype=np.float64).copy())
    )


def body_clearance_m(test: SegmentTest, poses: Array) -> Array:
    """d_o (N,) of poses (N, 4): lower bound of the distance of the body to the unsafe set, table included."""
    return np.asarray(_clearances(test, np.ascontiguousarray(poses, dtype=np.float64)))


@answers_segments(SegmentTest)
@compiled
def _segment(test, first, second):  # type: ignore[no-untyped-def]
    start, end = first, second
    for axis in range(4):  # one order for both directions: the test is symmetric
        if first[axis] != second[axis]:
            if first[axis] > second[axis]:
                start, end = second, first
            break
    dx, dy, dz, dyaw = end[0] - start[0], end[1] - start[1], end[2] - start[2], end[3] - start[3]
    motion_m = math.sqrt(dx * dx + dy * dy + dz * dz) + test.rho_max_m * abs(dyaw)
    if test.method == 2:
        return _whole_motion_is_safe(test, start, dx, dy, dz, dyaw, motion_m)
    steps = max(1, int(math.ceil(motion_m / test.delta_p_m)))
    key = _mix(np.uint64(test.seed), start, end)
    for step in range(steps + 1):
        t = step / steps
        x, y, z, yaw = start[0] + t * dx, start[1] + t * dy, start[2] + t * dz, start[3] + t * dyaw
        need_m = test.margin_m + test.delta_p_m / 2
        if test.use_certificate and _certified(test, x, y, z, need_m):
            continue
        if test.method == 1:
            if _clearance(test, x, y, z, yaw, need_m) < need_m:
                return False
        elif not _samples_are_free(test, x, y, z, yaw, key, step):
            return False
    return True


@compiled
def _whole_motion_is_safe(test, start, dx, dy, dz, dyaw, motion_m):  # type: ignore[no-untyped-def]
    """Bisection: a piece is safe if its middle pose is clear by the margin and half of the piece's motion."""
    depth = np.empty(64, np.int64)
    index = np.empty(64, np.int64)
    depth[0] = index[0] = 0
    waiting = 1
    while waiting > 0:
        waiting -= 1
        level, place = depth[waiting], index[waiting]
        pieces = float(1 << level)
        t = (place + 0.5) / pieces
        half_m = 0.5 * motion_m / pieces
        need_m = test.margin_m + half_m
        x, y, z, yaw = start[0] + t * dx, start[1] + t * dy, start[2] + t * dz, start[3] + t * dyaw
        if test.use_certificate and _certified(test, x, y, z, need_m):
            continue
        clearance_m = _clearance(test, x, y, z, yaw, need_m)
        if clearance_m >= need_m:
            continue
        if clearance_m < test.margin_m or half_m <= test.resolution_m:
            return False
        depth[waiting] = depth[waiting + 1] = level + 1
        index[waiting], index[waiting + 1] = 2 * place, 2 * place + 1
        waiting += 2
    return True


@compiled
def _clearance(test, x, y, z, yaw, enough_m):  # type: ignore[no-untyped-def]
    """Lower bound of the body's clearance; no better than it needs to be once it is at least ``enough_m``.

    Table: the disc's lower face. Shaft: the ray above the centre, thickened. Disc: its enclosing ball or, if
    that is not clear by enough, the balls of its cover.
    """
    least_m = min(
        z - test.half_thickness_m - test.field.floor_z_m,
        clearance_at(test.field, test.field.ray, x, y, z) - test.shaft_radius_m,
    )
    if least_m < test.margin_m:
        return least_m
    whole_m = clearance_at(test.field, test.field.ball, x, y, z) - test.disc_radius_m
    if whole_m >= enough_m:
        return min(least_m, whole_m)
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(test.cover)):
        u, v, w = test.cover[n, 0], test.cover[n, 1], test.cover[n, 2]
        ball_m = clearance_at(test.field, test.field.ball, x + cos * u - sin * v, y + sin * u + cos * v, z + w)
        least_m = min(least_m, ball_m - test.cover_radius_m)
        if least_m < test.margin_m:
            return least_m
    return least_m


@compiled
def _certified(test, x, y, z, need_m):  # type: ignore[no-untyped-def]
    """Whether the coarse grid alone shows that disc and shaft are clear by ``need_m``."""
    field = test.field
    if z - test.half_thickness_m - field.floor_z_m < need_m:
        return False
    nx, ny, nz = field.ball.shape
    i = int(min(max((x - field.lower_m[0]) / field.voxel_m, 0.0), nx - 1.0)) // field.stride
    j = int(min(max((y - field.lower_m[1]) / field.voxel_m, 0.0), ny - 1.0)) // field.stride
    k = int(min(max((z - field.lower_m[2]) / field.voxel_m, 0.0), nz - 1.0)) // field.stride
    return (
        field.coarse_ball[i, j, k] >= test.disc_radius_m + need_m
        and field.coarse_ray[i, j, k] >= test.shaft_radius_m + need_m
    )


@compiled
def _samples_are_free(test, x, y, z, yaw, key, step):  # type: ignore[no-untyped-def]
    """The paper's scenario test of a pose. The draw is a function of segment and pose alone (counter-based).

    N_x different points of a pool of uniform ones: a random first, and a random odd stride.
    """
    field = test.field
    nx, ny, nz = field.ball.shape
    size = np.uint64(len(test.samples))
    place, stride = np.uint64(0), np.uint64(1)
    if test.redraw_samples:
        bits = _scramble(key + np.uint64(step) * np.uint64(0x9E3779B97F4A7C15))
        place, stride = bits % size, ((bits >> np.uint64(32)) % size) | np.uint64(1)
    cos, sin = math.cos(yaw), math.sin(yaw)
    for _ in range(test.n_samples):
        u, v, w = test.samples[place, 0], test.samples[place, 1], test.samples[place, 2]
        place = (place + stride) % size
        if z + w < field.floor_z_m:
            return False
        i = int(min(max((x + cos * u - sin * v - field.lower_m[0]) / field.voxel_m, 0.0), nx - 1.0))
        j = int(min(max((y + sin * u + cos * v - field.lower_m[1]) / field.voxel_m, 0.0), ny - 1.0))
        k = int(min(max((z + w - field.lower_m[2]) / field.voxel_m, 0.0), nz - 1.0))
        if field.ball[i, j, k] == 0.0:
            return False
    return True


@compiled
def _scramble(bits):  # type: ignore[no-untyped-def]
    """The finaliser of splitmix64."""
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@compiled
def _mix(seed, start, end):  # type: ignore[no-untyped-def]
    key = _scramble(seed + np.uint64(1))
    for axis in range(4):
        key = _scramble(key ^ np.uint64(np.int64(start[axis] * 1e9)))
        key = _scramble(key ^ np.uint64(np.int64(end[axis] * 1e9)))
    return key


@compiled
def _clearances(test, poses):  # type: ignore[no-untyped-def]
    clearance_m = np.empty(len(poses))
    for n in range(len(poses)):
        x, y, z, yaw = poses[n, 0], poses[n, 1], poses[n, 2], poses[n, 3]
        # without a margin to keep and with more than any field holds, the cover is always asked to the end
        clearance_m[n] = _full_clearance(test, x, y, z, yaw)
    return clearance_m


@compiled
def _full_clearance(test, x, y, z, yaw):  # type: ignore[no-untyped-def]
    least_m = min(
        z - test.half_thickness_m - test.field.floor_z_m,
        clearance_at(test.field, test.field.ray, x, y, z) - test.shaft_radius_m,
    )
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(test.cover)):
        u, v, w = test.cover[n, 0], test.cover[n, 1], test.cover[n, 2]
        ball_m = clearance_at(test.field, test.field.ball, x + cos * u - sin * v, y + sin * u + cos * v, z + w)
        least_m = min(least_m, ball_m - test.cover_radius_m)
    return least_m
