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
from deltasafe.planning.field import FieldArrays, SafetyField, clearance_at, close_clearance_at, voxel_of

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


class CheckNumbers(NamedTuple):
    """The numbers of a segment test: of the body, of its cover, of the method (an index of ``METHODS``)."""

    method: int
    cover_radius_m: float
    disc_radius_m: float
    half_thickness_m: float
    shaft_radius_m: float
    rho_max_m: float
    margin_m: float
    delta_p_m: float
    resolution_m: float
    n_samples: int
    redraw_samples: bool
    use_certificate: bool
    seed: int
    floor_z_m: float


class SegmentTest(NamedTuple):
    """All that a test needs, as compiled code reads it. Made by ``segment_test``."""

    field: FieldArrays
    cover: Array
    samples: Array
    numbers: CheckNumbers


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
        field.arrays,
        cover,
        body.samples(margin_m + settings.delta_p_m / 2, POOL_SIZE if sampled else 1, seed),
        CheckNumbers(
            method=METHODS.index(settings.method),
            cover_radius_m=cover_radius_m,
            disc_radius_m=body.disc_radius_m,
            half_thickness_m=body.thickness_m / 2,
            shaft_radius_m=body.shaft_radius_m,
            rho_max_m=body.rho_max_m,
            margin_m=float(margin_m),
            delta_p_m=settings.delta_p_m,
            resolution_m=settings.resolution_m,
            n_samples=settings.n_samples,
            redraw_samples=settings.redraw_samples,
            use_certificate=settings.use_certificate,
            seed=seed,
            floor_z_m=field.arrays.floor_z_m,
        ),
    )


def is_segment_safe(test: SegmentTest, start: Array, end: Array) -> bool:
    """Whether the segment between two poses (4,), yaw turning linearly, passes; symmetric in its ends."""
    return bool(ask_segment(test, np.asarray(start, dtype=np.float64).copy(), np.asarray(end, dtype=np.float64).copy()))


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
    if test.numbers.method == 2:
        return _continuous(test.field, test.cover, test.numbers, start, end)
    return _at_poses(test.field, test.cover, test.samples, test.numbers, start, end)


@compiled
def _motion(rho_max_m, start, end):  # type: ignore[no-untyped-def]
    """Bound of the way that any point of the body makes along a segment."""
    dx, dy, dz = end[0] - start[0], end[1] - start[1], end[2] - start[2]
    return math.sqrt(dx * dx + dy * dy + dz * dz) + rho_max_m * abs(end[3] - start[3])


@compiled
def _at_poses(field, cover, samples, numbers, start, end):  # type: ignore[no-untyped-def]
    """``exact`` and ``sampled``: poses at most Delta_p apart, both ends included, with margin for the way between."""
    steps = max(1, int(np.ceil(_motion(numbers.rho_max_m, start, end) / numbers.delta_p_m)))
    need_m = numbers.margin_m + numbers.delta_p_m / 2
    key = _mix(np.uint64(numbers.seed), start, end)
    for step in range(steps + 1):
        t = step / steps
        x, y, z = (
            start[0] + t * (end[0] - start[0]),
            start[1] + t * (end[1] - start[1]),
            start[2] + t * (end[2] - start[2]),
        )
        yaw = start[3] + t * (end[3] - start[3])
        if numbers.use_certificate and _certified(field, numbers, x, y, z, need_m):
            continue
        if numbers.method == 1:
            if _clearance(field.ball, field.ray, field.lattice, cover, numbers, x, y, z, yaw, need_m, need_m) < need_m:
                return False
        else:
            bits = _scramble(key + np.uint64(step) * np.uint64(0x9E3779B97F4A7C15))
            if not _samples_are_free(field.ball, field.lattice, samples, numbers, x, y, z, yaw, bits):
                return False
    return True


@compiled
def _continuous(field, cover, numbers, start, end):  # type: ignore[no-untyped-def]
    """Bisection: a piece is safe if its middle pose is clear by the margin and half of the piece's motion."""
    motion_m = _motion(numbers.rho_max_m, start, end)
    level, place = 0, 0
    while True:
        pieces = float(1 << level)
        t = (place + 0.5) / pieces
        half_m = 0.5 * motion_m / pieces
        need_m = numbers.margin_m + half_m
        x, y, z = (
            start[0] + t * (end[0] - start[0]),
            start[1] + t * (end[1] - start[1]),
            start[2] + t * (end[2] - start[2]),
        )
        yaw = start[3] + t * (end[3] - start[3])
        if not (numbers.use_certificate and _certified(field, numbers, x, y, z, need_m)):
            clearance_m = _clearance(
                field.ball, field.ray, field.lattice, cover, numbers, x, y, z, yaw, need_m, numbers.margin_m
            )
            if clearance_m < need_m:
                if clearance_m < numbers.margin_m or half_m <= numbers.resolution_m:
                    return False
                level, place = level + 1, 2 * place
                continue
        # on to the next piece: up while this was the second half of its parent
        while place & 1:
            level, place = level - 1, place >> 1
        if level == 0:
            return True
        place += 1


@compiled
def _clearance(  # type: ignore[no-untyped-def]
    ball, ray, lattice, cover, numbers, x, y, z, yaw, enough_m, least_of_use_m
):
    """Lower bound of the body's clearance: not sought further once below ``least_of_use_m`` or surely ``enough_m``.

    Table: the disc's lower face. Shaft: the ray above the centre, thickened. Disc: its enclosing ball or, if
    that is not clear by enough, the balls of its cover.
    """
    clearance_m = min(
        z - numbers.half_thickness_m - numbers.floor_z_m,
        close_clearance_at(ray, lattice, x, y, z) - numbers.shaft_radius_m,
    )
    if clearance_m < least_of_use_m:
        return clearance_m
    whole_m = clearance_at(ball, lattice, x, y, z) - numbers.disc_radius_m
    if whole_m >= enough_m:
        return min(clearance_m, whole_m)
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(cover)):
        u, v, w = cover[n, 0], cover[n, 1], cover[n, 2]
        u, v, w = x + cos * u - sin * v, y + sin * u + cos * v, z + w
        one_m = clearance_at(ball, lattice, u, v, w) - numbers.cover_radius_m
        if one_m < enough_m:
            one_m = close_clearance_at(ball, lattice, u, v, w) - numbers.cover_radius_m
        clearance_m = min(clearance_m, one_m)
        if clearance_m < least_of_use_m:
            return clearance_m
    return clearance_m


@compiled
def _certified(field, numbers, x, y, z, need_m):  # type: ignore[no-untyped-def]
    """Whether the coarse grid alone shows that disc and shaft are clear by ``need_m``."""
    if z - numbers.half_thickness_m - numbers.floor_z_m < need_m:
        return False
    i, j, k = voxel_of(field.lattice, x, y, z)
    i, j, k = i // field.lattice.stride, j // field.lattice.stride, k // field.lattice.stride
    return (
        field.coarse_ball[i, j, k] >= numbers.disc_radius_m + need_m
        and field.coarse_ray[i, j, k] >= numbers.shaft_radius_m + need_m
    )


@compiled
def _samples_are_free(ball, lattice, samples, numbers, x, y, z, yaw, bits):  # type: ignore[no-untyped-def]
    """The paper's scenario test of a pose. The draw is a function of segment and pose alone (counter-based).

    N_x different points of a pool of uniform ones: a random first, and a random odd stride.
    """
    size = np.int64(len(samples))
    place, stride = np.int64(0), np.int64(1)
    if numbers.redraw_samples:
        place = np.int64(bits & np.uint64(0x7FFFFFFF)) % size
        stride = np.int64((bits >> np.uint64(32)) & np.uint64(0x7FFFFFFF)) % size | 1
    cos, sin = math.cos(yaw), math.sin(yaw)
    for _ in range(numbers.n_samples):
        u, v, w = samples[place, 0], samples[place, 1], samples[place, 2]
        place = (place + stride) % size
        if z + w < numbers.floor_z_m:
            return False
        i, j, k = voxel_of(lattice, x + cos * u - sin * v, y + sin * u + cos * v, z + w)
        if ball[i, j, k] == 0.0:
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
        clearance_m[n] = _clearance(
            test.field.ball,
            test.field.ray,
            test.field.lattice,
            test.cover,
            test.numbers,
            x,
            y,
            z,
            yaw,
            np.inf,
            -np.inf,
        )
    return clearance_m
