"""How the hand is held: joint angles of thirteen common shapes, jittered and blended."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from deltasafe.errors import SettingsError

__all__ = ["POSES", "Pose", "draw_pose"]

Triple = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Pose:
    """Joint angles in radians, 0 = straight; flexion bends towards the palm.

    Attributes:
        fingers: (MCP, PIP, DIP) flexion of index, middle, ring and little finger.
        spread: abduction at the knuckle of the same four, positive towards the little finger.
        thumb: flexion of the thumb's (MCP, IP).
        thumb_base: (flexion, abduction, twist) of the thumb's saddle joint.
        cupping: flexion of the little finger's metacarpal (the ring finger's follows by a third).
        wrist_extension: raises the forearm above a hand that lies palm down.
        wrist_deviation: turns the hand sideways.
        forearm_twist: turns the forearm about its axis.
    """

    fingers: tuple[Triple, Triple, Triple, Triple]
    spread: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    thumb: tuple[float, float] = (0.0, 0.0)
    thumb_base: Triple = (0.0, 0.0, 0.0)
    cupping: float = 0.0
    wrist_extension: float = 0.0
    wrist_deviation: float = 0.0
    forearm_twist: float = 0.0


def _degrees(
    fingers: Sequence[Sequence[float]],
    spread: Sequence[float] = (0, 0, 0, 0),
    thumb: Sequence[float] = (10, 10),
    thumb_base: Sequence[float] = (0, 0, 0),
    cupping: float = 0.0,
) -> Pose:
    return Pose(
        _four_rows(np.radians(fingers)),
        tuple(np.radians(spread).tolist()),
        tuple(np.radians(thumb).tolist()),
        tuple(np.radians(thumb_base).tolist()),
        float(np.radians(cupping)),
    )


def _four_rows(angles: np.ndarray) -> tuple[Triple, Triple, Triple, Triple]:
    index, middle, ring, little = (tuple(row) for row in angles.tolist())
    return index, middle, ring, little


_STRAIGHT, _RING_CURLED, _LITTLE_CURLED = (2, 4, 2), (80, 100, 58), (84, 98, 55)
POSES: dict[str, Pose] = {
    "flat": _degrees([_STRAIGHT] * 4, thumb_base=(-18, 24, 0)),
    "together": _degrees([(2, 3, 2)] * 4, spread=(5, 1, -4, -8), thumb=(6, 4), thumb_base=(-8, 29, 0)),
    "relaxed": _degrees(
        [(10, 22, 12), (12, 26, 14), (14, 29, 15), (16, 30, 15)], thumb=(15, 15), thumb_base=(-8, 14, 0)
    ),
    "cupped": _degrees([(18, 25, 14), (22, 30, 16), (26, 34, 18), (30, 36, 18)], thumb=(15, 15), thumb_base=(8, 0, 0)),
    "spread": _degrees(
        [(0, 3, 2), (0, 3, 2), (0, 3, 2), (0, 4, 2)], spread=(-12, -2, 8, 20), thumb=(0, -5), thumb_base=(-31, 13, 0)
    ),
    "fist": _degrees(
        [(72, 98, 55), (76, 100, 58), _RING_CURLED, _LITTLE_CURLED], thumb=(35, 45), thumb_base=(28, 22, 20), cupping=8
    ),
    "point": _degrees(
        [(4, 6, 3), (74, 98, 58), _RING_CURLED, _LITTLE_CURLED], thumb=(35, 50), thumb_base=(26, 20, 20), cupping=8
    ),
    "vsign": _degrees(
        [_STRAIGHT, _STRAIGHT, _RING_CURLED, _LITTLE_CURLED],
        spread=(-10, 6, 0, 0),
        thumb=(40, 50),
        thumb_base=(32, 26, 25),
        cupping=6,
    ),
    "pinch": _degrees(
        [(44, 42, 24), (28, 32, 18), (24, 28, 15), (22, 24, 14)],
        spread=(0, 0, 4, 10),
        thumb=(22, 28),
        thumb_base=(30, 20, 25),
    ),
    "ok": _degrees(
        [(52, 56, 30), (20, 18, 8), (12, 12, 6), (8, 10, 6)],
        spread=(0, 2, 8, 16),
        thumb=(28, 35),
        thumb_base=(30, 20, 25),
    ),
    "claw": _degrees(
        [(8, 50, 30), (8, 52, 30), (10, 52, 30), (12, 50, 28)],
        spread=(-8, 0, 6, 14),
        thumb=(15, 35),
        thumb_base=(5, 10, 5),
    ),
    "grip": _degrees(
        [(45, 40, 25), (48, 42, 25), (50, 44, 25), (54, 42, 25)], thumb=(20, 25), thumb_base=(14, 30, 15), cupping=6
    ),
    "thumbsup": _degrees(
        [(76, 98, 55), (80, 100, 58), (82, 100, 58), (84, 98, 55)], thumb=(-5, -10), thumb_base=(-22, 4, 0)
    ),
}


def draw_pose(rng: np.random.Generator, names: Sequence[str], jitter_rad: float = 0.087, blend: float = 0.3) -> Pose:
    """One of the poses ``names``, blended by up to ``blend`` with any other one, its joints jittered.

    Raises:
        SettingsError: a name is not in ``POSES``, or there is none.
    """
    unknown = sorted(set(names) - POSES.keys())
    if unknown or not names:
        raise SettingsError(f"poses must be names out of {sorted(POSES)}, got {unknown or 'none'}")
    one, other = POSES[str(rng.choice(list(names)))], POSES[str(rng.choice(list(POSES)))]
    share = blend * rng.random() ** 2

    def mixed(name: str) -> np.ndarray:
        return np.asarray((1 - share) * np.array(getattr(one, name)) + share * np.array(getattr(other, name)))

    fingers = mixed("fingers") + rng.normal(0, jitter_rad) + rng.normal(0, 0.7 * jitter_rad, (4, 3))
    fingers = np.clip(fingers, np.radians([-8, 0, 0]), np.radians(105))
    thumb = np.clip(mixed("thumb") + rng.normal(0, 0.7 * jitter_rad, 2), np.radians(-8), np.radians(105))
    return Pose(
        fingers=_four_rows(fingers),
        spread=tuple((mixed("spread") + np.radians(rng.normal(0, 2, 4))).tolist()),
        thumb=tuple(thumb.tolist()),
        thumb_base=tuple((mixed("thumb_base") + np.radians(rng.normal(0, 3, 3))).tolist()),
        cupping=float(mixed("cupping")),
        wrist_extension=float(np.radians(rng.normal(0, 8))),
        wrist_deviation=float(np.radians(rng.normal(0, 4.8))),
        forearm_twist=float(np.radians(rng.normal(0, 8))),
    )
