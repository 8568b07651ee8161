"""Folds of the skin: creases at the joints, knuckle wrinkles, lines of the palm and of the wrist."""

import numpy as np
from numpy.typing import NDArray

from generator.noise import catmull_rom, distance_to_polyline, smoothstep, value_noise
from generator.pose import Pose
from generator.skeleton import DIGITS, FINGERS, PARENTS
from generator.skin.marks import Marks
from generator.skin.regions import Regions

__all__ = ["bend", "draw_joint_folds", "draw_palm_lines", "draw_wrist_lines"]

Array = NDArray[np.float64]
CREASES_MM = {1: (9.0,), 2: (-1.2, 1.2), 3: (0.0,)}


def bend(pose: Pose, bone: str, full_deg: float) -> float:
    """Flexion of a bone of a digit as a share of ``full_deg``, 0 to 1: stretched skin loses its wrinkles."""
    digit, k = int(bone[6]), int(bone[8])
    angle = pose.fingers[digit - 2][k - 1] if digit > 1 else pose.thumb[k - 2]
    return float(np.clip(np.degrees(angle) / full_deg, 0, 1))


def draw_joint_folds(marks: Marks, regions: Regions, pose: Pose, wrinkles: float, dark: float, seed: int) -> None:
    """Creases on the palm side, wrinkles on the back of the knuckles, redness of knuckles and fingertips."""
    points = regions.points_mm
    wobble, fine_wobble = 0.7 * value_noise(points / 6, seed), value_noise(points / 4, seed + 3)
    for digit in DIGITS:
        for k in (1, 2, 3):
            bone, joint = f"finger{digit}-{k}", regions.joints_mm[f"finger-{digit}-{k}"]
            if bone == "finger1-1":
                continue
            along = (points - joint) @ regions.bisector[bone] + wobble
            if k > 1:
                near = smoothstep(0.3, 0.7, regions.finger_share[digit]) * (np.abs(along) < 14)
            else:
                reach = regions.finger_share[digit] + 0.7 * regions.bone_share[str(PARENTS[bone])]
                near = smoothstep(0.15, 0.5, reach) * (np.abs(along) < 16)
            for offset in CREASES_MM[k]:
                crease = np.exp(-(((along - offset) / 0.75) ** 2)) * smoothstep(0, 0.5, regions.palm_facing) * near
                marks.add(crease, darkness=0.30, redness=0.25, relief_mm=-0.35)
            if k > 1:
                back = regions.dorsal * near
                fuse_conv_bn = (
                    np.exp(-((along / (4.2 if k == 2 else 3.0)) ** 2)) * back * (1 - 0.8 * bend(pose, bone, 60))
                )
                wave = np.cos(2 * np.pi * along / 2.1 + 2 * wobble + 2 * fine_wobble)
                marks.add(fuse_conv_bn * np.clip(wave, 0, 1), darkness=0.24 * (0.4 + wrinkles))
                marks.add(fuse_conv_bn * wave, relief_mm=-0.2 * (0.4 + wrinkles))
                bulge = np.exp(-((along / 5.3) ** 2)) * back
                marks.add(bulge, 0.10 * (0.5 + dark), 0.35 * (1 - 0.5 * bend(pose, bone, 60)), 0.5)
            else:
                away = np.linalg.norm(points - joint - [0.0, 0.0, 9.0], axis=1)
                knuckle = np.exp(-((away / 9) ** 2)) * regions.dorsal
                marks.add(knuckle, 0.06 * (0.5 + dark), 0.35, 0.4 * bend(pose, bone, 60))
        tip = np.linalg.norm(points - regions.joints_mm[f"finger-{digit}-4"], axis=1)
        marks.add(np.exp(-((tip / 11) ** 2)) * (0.4 + 0.6 * regions.palmar), redness=0.55)


def draw_palm_lines(marks: Marks, regions: Regions, rng: np.random.Generator) -> None:
    """The three large lines of the palm, where anatomy puts them give or take, and a dozen small ones."""
    palm = regions.palmar * smoothstep(0.2, 0.6, -regions.normals[:, 2])
    palm = palm * np.clip(1 - 1.5 * (regions.fingers_share - regions.finger_share[1]), 0, 1)
    where = np.flatnonzero(palm > 0)
    flat = regions.points_mm[where, :2]
    knuckle = {f: regions.joints_mm[f"finger-{f}-1"][:2] for f in FINGERS}

    def near(point: Array, offset: tuple[float, float], spread_mm: float = 3.0) -> Array:
        return np.asarray(point + offset + rng.normal(0, spread_mm, 2))

    def draw(line: Array, width_mm: float, taper: float, **strength: float) -> None:
        distance, place = distance_to_polyline(flat, line)
        mark = np.zeros(len(palm))
        mark[where] = np.exp(-((distance / width_mm) ** 2)) * np.minimum(1, np.minimum(place, 1 - place) * taper)
        marks.add(mark * palm, **strength)

    fork = knuckle[2] + [-20.0, -11.0]
    between = (knuckle[3] + knuckle[2]) / 2
    heart = [
        near(knuckle[5], (-17, 12)),
        near(knuckle[4], (-15, 2)),
        near(knuckle[3], (-10, 1), 2),
        near(between, (6, 0), 2),
    ]
    head = [fork, near(knuckle[3], (-30, -2)), near(knuckle[4], (-42, 2)), near(knuckle[5], (-52, 4))]
    life = [
        fork,
        near(knuckle[2], (-33, 3), 2),
        near(knuckle[3], (-55, -2), 2),
        near(np.zeros(2), (26, -6), 2),
        [8, -4],
    ]
    for knots in (heart, head, life):
        draw(catmull_rom(np.array(knots)), 0.9, 6, darkness=0.24, redness=0.35, relief_mm=-0.4)
    for _ in range(12):
        start, angle = np.array([rng.uniform(5, 85), rng.uniform(-28, 28)]), rng.uniform(0, np.pi)
        end = start + rng.uniform(8, 22) * np.array([np.cos(angle), np.sin(angle)])
        draw(np.array([start, end]), 0.7, 4, darkness=0.07)


def draw_wrist_lines(marks: Marks, regions: Regions, seed: int) -> None:
    """The two rings of the wrist on the palm side."""
    x, y = regions.points_mm[:, 0], regions.points_mm[:, 1]
    wobble = 1.4 * value_noise(regions.points_mm / 6, seed)
    for place_mm in (0.0, -8.0):
        ring = np.exp(-(((x - place_mm + wobble + 0.0036 * y**2) / 0.8) ** 2))
        ring = ring * smoothstep(0.1, 0.6, -regions.normals[:, 2]) * (np.abs(y) < 32)
        marks.add(ring, darkness=0.12, relief_mm=-0.2)
