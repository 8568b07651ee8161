"""Hand poses: joint angles of thirteen common poses, and random poses that blend and jitter them."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from deltasafe.errors import SettingsError

Triple = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Pose:
    """Joint angles in radians; 0 is straight, and positive flexion bends towards the palm.

    Attributes:
        fingers: (MCP, PIP, DIP) flexion of index, middle, ring and little finger.
        spread: abduction at the knuckle of the same four, positive towards the little finger.
        thumb: (MCP, IP) flexion of the thumb.
        thumb_base: (flexion, abduction, twist) of the thumb's CMC joint.
        cupping: flexion of the little finger's metacarpal; the ring finger's follows with about a third.
        wrist_extension: positive raises the forearm above a hand that lies palm down.
        wrist_deviation: sideways rotation of the hand.
        forearm_twist: rotation of the forearm about its own axis.
    """

    fingers: tuple[Triple, Triple, Triple, Triple]
    spread: tuple[float, float, float, float] = (0.0, 0.0, 0.0, 0.0)
    thumb: tuple[float, float] = (0.0, 0.0)
    thumb_base: Triple = (0.0, 0.0, 0.0)
    cupping: float = 0.0
    wrist_extension: float = 0.0
    wrist_deviation: float = 0.0
    forearm_twist: float = 0.0

    def flexion_fraction(self, bone: str, full_deg: float) -> float:
        """Return the flexion of a bone ``fingerD-K`` divided by ``full_deg``, clipped to [0, 1]."""
        digit, k = map(int, bone.removeprefix("finger").split("-"))
        angle = self.fingers[digit - 2][k - 1] if digit > 1 else self.thumb[k - 2]
        return float(np.clip(np.degrees(angle) / full_deg, 0, 1))


# degrees: MCP, PIP, DIP of index, middle, ring, little finger | spread | thumb MCP, IP | thumb base | cupping
_POSE_TABLE = """
flat       2  4  2    2  4  2    2  4  2    2  4  2  |    0   0   0   0 |  10  10 | -18  24   0 |  0
together   2  3  2    2  3  2    2  3  2    2  3  2  |    5   1  -4  -8 |   6   4 |  -8  29   0 |  0
relaxed   10 22 12   12 26 14   14 29 15   16 30 15  |    0   0   0   0 |  15  15 |  -8  14   0 |  0
cupped    18 25 14   22 30 16   26 34 18   30 36 18  |    0   0   0   0 |  15  15 |   8   0   0 |  0
spread     0  3  2    0  3  2    0  3  2    0  4  2  |  -12  -2   8  20 |   0  -5 | -31  13   0 |  0
fist      72 98 55   76 100 58  80 100 58  84 98 55  |    0   0   0   0 |  35  45 |  28  22  20 |  8
point      4  6  3   74 98 58   80 100 58  84 98 55  |    0   0   0   0 |  35  50 |  26  20  20 |  8
vsign      2  4  2    2  4  2   80 100 58  84 98 55  |  -10   6   0   0 |  40  50 |  32  26  25 |  6
pinch     44 42 24   28 32 18   24 28 15   22 24 14  |    0   0   4  10 |  22  28 |  30  20  25 |  0
ok        52 56 30   20 18  8   12 12  6    8 10  6  |    0   2   8  16 |  28  35 |  30  20  25 |  0
claw       8 50 30    8 52 30   10 52 30   12 50 28  |   -8   0   6  14 |  15  35 |   5  10   5 |  0
grip      45 40 25   48 42 25   50 44 25   54 42 25  |    0   0   0   0 |  20  25 |  14  30  15 |  6
thumbsup  76 98 55   80 100 58  82 100 58  84 98 55  |    0   0   0   0 |  -5 -10 | -22   4   0 |  0
"""


def _parse_pose(row: str) -> tuple[str, Pose]:
    name, numbers = row.split(maxsplit=1)
    fingers, spread, thumb, thumb_base, cupping = (
        tuple(np.radians([float(x) for x in part.split()]).tolist()) for part in numbers.split("|")
    )
    return name, Pose(_finger_tuples(np.reshape(fingers, (4, 3))), spread, thumb, thumb_base, *cupping)


def _finger_tuples(angles: np.ndarray) -> tuple[Triple, Triple, Triple, Triple]:
    index, middle, ring, little = (tuple(row) for row in angles.tolist())
    return index, middle, ring, little


POSES: dict[str, Pose] = dict(map(_parse_pose, _POSE_TABLE.strip().splitlines()))


def sample_pose(rng: np.random.Generator, names: Sequence[str], jitter_rad: float = 0.087, blend: float = 0.3) -> Pose:
    """Sample a pose out of ``names``, blend it with another pose, and add noise to the joint angles.

    Args:
        jitter_rad: standard deviation of the noise on finger flexion.
        blend: upper bound of the other pose's weight.

    Raises:
        SettingsError: ``names`` is empty, or a name is not in ``POSES``.
    """
    unknown = sorted(set(names) - POSES.keys())
    if unknown or not names:
        raise SettingsError(f"poses must be names out of {sorted(POSES)}, got {unknown or 'none'}")
    one, other = POSES[str(rng.choice(list(names)))], POSES[str(rng.choice(list(POSES)))]
    weight = blend * rng.random() ** 2

    def blended(name: str) -> np.ndarray:
        return np.asarray((1 - weight) * np.array(getattr(one, name)) + weight * np.array(getattr(other, name)))

    fingers = blended("fingers") + rng.normal(0, jitter_rad) + rng.normal(0, 0.7 * jitter_rad, (4, 3))
    fingers = np.clip(fingers, np.radians([-8, 0, 0]), np.radians(105))
    thumb = np.clip(blended("thumb") + rng.normal(0, 0.7 * jitter_rad, 2), np.radians(-8), np.radians(105))
    return Pose(
        fingers=_finger_tuples(fingers),
        spread=tuple((blended("spread") + np.radians(rng.normal(0, 2, 4))).tolist()),
        thumb=tuple(thumb.tolist()),
        thumb_base=tuple((blended("thumb_base") + np.radians(rng.normal(0, 3, 3))).tolist()),
        cupping=float(blended("cupping")),
        wrist_extension=float(np.radians(rng.normal(0, 8))),
        wrist_deviation=float(np.radians(rng.normal(0, 4.8))),
        forearm_twist=float(np.radians(rng.normal(0, 8))),
    )
