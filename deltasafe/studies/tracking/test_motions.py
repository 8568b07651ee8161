"""Test motions: lines, arcs, rotations in place and lines with rotation, at piecewise constant acceleration.

The acceleration jumps between the same values as in a velocity schedule. Half of the motions slow down halfway and
continue slowly, as a schedule does near a hand.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError
from deltasafe.geometry import Trajectory
from deltasafe.studies.tracking.settings import TrackingStudySettings

Array = NDArray[np.float64]

KINDS = ("line", "arc", "turn", "line and turn")
_PERIOD_S = 1e-3
_ATTEMPTS = 5000
_MAX_TILT = 0.5  # tangent of the largest angle between the plane of an arc and the table


@dataclasses.dataclass(frozen=True)
class TestMotion:
    """One test motion, at rest at both ends.

    Attributes:
        trajectory: at 1 kHz.
        kind: index into ``KINDS``.
        speed_mps: largest speed of the tool's center; 0 for a rotation in place.
        braking_mps2: last deceleration, to rest.
    """

    __test__ = False  # pytest must not collect this class

    trajectory: Trajectory
    kind: int
    speed_mps: float
    braking_mps2: float


def draw_motion(settings: TrackingStudySettings, rng: np.random.Generator) -> TestMotion:
    """Draw a motion inside the box: kind, speed, accelerations, direction, position and yaw.

    Raises:
        PlanningError: the box is too small for a motion of such speeds.
    """
    kind, speed = int(rng.integers(len(KINDS))), float(rng.uniform(settings.v_min_mps, settings.v_max_mps))
    shape, turns = _arc if KINDS[kind] == "arc" else _line, "turn" in KINDS[kind]
    speed = 0.0 if KINDS[kind] == "turn" else speed
    # the accelerations are those of the tool's fastest point, as in a schedule
    fastest = speed + (settings.body.rho_max_m * settings.yaw_rate_radps if turns else 0.0)
    for _ in range(_ATTEMPTS):
        times_s, levels, braking = _draw_speeds(settings, rng, fastest)
        duration_s = float(np.trapezoid(levels, times_s))  # of the same path at top speed
        drawn = shape(settings, rng, speed * duration_s, speed)
        yaw, swing = rng.uniform(-math.pi / 2, math.pi / 2), 0.0
        if turns:
            swing = rng.choice([-1.0, 1.0]) * rng.uniform(0.3, 1.0) * settings.yaw_rate_radps * duration_s
        if drawn is None or abs(yaw + swing) > math.pi / 2:
            continue
        curve, tangent = drawn
        time_s, fractions, rates = _sampled(times_s, levels)
        poses = np.column_stack([curve(fractions), yaw + swing * fractions])
        velocities = np.column_stack([tangent(fractions), np.full(len(fractions), swing)]) * rates[:, None]
        return TestMotion(Trajectory(time_s, poses, velocities), kind, speed, braking)
    raise PlanningError(f"no motion of {speed:.3f} m/s fits between {settings.lower_m} and {settings.upper_m}")


def _draw_speeds(
    settings: TrackingStudySettings, rng: np.random.Generator, speed_mps: float
) -> tuple[Array, Array, float]:
    """Draw the corners of the speed profile: times, fractions of the top speed; and the last deceleration."""
    up, down, last = rng.choice(settings.accelerations_mps2, size=3)
    slow = rng.uniform(0.1, 0.6) if rng.random() < 0.5 else 1.0
    durations_s, levels = [speed_mps / up, rng.uniform(0.1, 0.5)], [0.0, 1.0, 1.0]
    if slow < 1:
        durations_s += [(1 - slow) * speed_mps / down, rng.uniform(0.2, 0.5)]
        levels += [slow, slow]
    durations_s.append(slow * speed_mps / last)
    return np.concatenate([[0.0], np.cumsum(durations_s)]), np.array([*levels, 0.0]), float(last)


def _sampled(times_s: Array, levels: Array) -> tuple[Array, Array, Array]:
    """Sample at the controller's rate: time, fraction of the path, and its derivative; at rest at the end."""
    time_s = np.arange(math.floor(times_s[-1] / _PERIOD_S) + 2) * _PERIOD_S
    level = np.interp(time_s, times_s, levels)
    lengths = np.concatenate([[0.0], np.cumsum(np.diff(times_s) * (levels[1:] + levels[:-1]) / 2)])
    piece = np.clip(np.searchsorted(times_s, time_s, side="right") - 1, 0, len(times_s) - 2)
    length = lengths[piece] + (np.minimum(time_s, times_s[-1]) - times_s[piece]) * (levels[piece] + level) / 2
    return time_s, length / lengths[-1], level / lengths[-1]


def _line(settings: TrackingStudySettings, rng: np.random.Generator, length_m: float, speed_mps: float):  # type: ignore[no-untyped-def]
    """Draw a line; return position and tangent as functions of the fraction, or None if it leaves the box."""
    direction = rng.standard_normal(3)
    direction *= length_m / np.linalg.norm(direction)
    start = rng.uniform(settings.lower_m, settings.upper_m)
    if not _inside(settings, (start + direction)[None]):
        return None
    return (lambda s: start + s[:, None] * direction), (lambda s: np.tile(direction, (len(s), 1)))


def _arc(settings: TrackingStudySettings, rng: np.random.Generator, length_m: float, speed_mps: float):  # type: ignore[no-untyped-def]
    """Draw an arc in a slightly tilted plane, with a radius that the largest acceleration allows; see ``_line``."""
    radius = speed_mps**2 / max(settings.accelerations_mps2) + rng.uniform(0.02, 0.08)
    lean, first = rng.uniform(-_MAX_TILT, _MAX_TILT), rng.uniform(0, 2 * math.pi)
    sweep = rng.choice([-1.0, 1.0]) * length_m / radius
    flat, up = np.array([math.cos(first), math.sin(first), 0.0]), np.array([-math.sin(first), math.cos(first), lean])
    up /= np.linalg.norm(up)
    center = rng.uniform(settings.lower_m, settings.upper_m)

    def curve(fraction: Array) -> Array:
        angle = sweep * fraction[:, None]
        return np.asarray(center + radius * (np.cos(angle) * flat + np.sin(angle) * up))

    def tangent(fraction: Array) -> Array:
        angle = sweep * fraction[:, None]
        return np.asarray(radius * sweep * (np.cos(angle) * up - np.sin(angle) * flat))

    return (curve, tangent) if _inside(settings, curve(np.linspace(0, 1, 50))) else None


def _inside(settings: TrackingStudySettings, points_m: Array) -> bool:
    return bool((points_m >= settings.lower_m).all() and (points_m <= settings.upper_m).all())
