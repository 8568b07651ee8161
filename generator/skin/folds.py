"""Skin folds: creases and wrinkles at the joints, lines of the palm and of the wrist."""

import numpy as np

from generator.aliases import Array
from generator.noise import catmull_rom, distance_to_polyline, smoothstep, value_noise
from generator.pose import Pose
from generator.skeleton import DIGITS, FINGERS, PARENTS
from generator.skin.marks import Marks
from generator.skin.regions import Regions

# by the number k of the bone, offsets of the palmar creases along the finger from the bone's base joint
CREASE_OFFSETS_MM = {1: (9.0,), 2: (-1.2, 1.2), 3: (0.0,)}
N_SMALL_PALM_LINES = 12
WRIST_LINES_X_MM = (0.0, -8.0)


def add_joint_folds(marks: Marks, regions: Regions, pose: Pose, wrinkles: float, darkness: float, seed: int) -> None:
    """Add palmar creases, wrinkles on the back of the joints, and redness of knuckles and fingertips."""
    points = regions.points_mm
    wobble, fine_wobble = 0.7 * value_noise(points / 6, seed), value_noise(points / 4, seed + 3)
    for digit in DIGITS:
        for k in (1, 2, 3):
            bone, joint = f"finger{digit}-{k}", regions.joints_mm[f"finger-{digit}-{k}"]
            if bone == "finger1-1":
                continue
            along = (points - joint) @ regions.joint_plane_normals[bone] + wobble
            if k == 1:
                metacarpal_weight = regions.bone_weights[str(PARENTS[bone])]
                near = smoothstep(0.15, 0.5, regions.digit_weights[digit] + 0.7 * metacarpal_weight)
                near = near * (np.abs(along) < 16)
            else:
                near = smoothstep(0.3, 0.7, regions.digit_weights[digit]) * (np.abs(along) < 14)
            for offset in CREASE_OFFSETS_MM[k]:
                crease = np.exp(-(((along - offset) / 0.75) ** 2)) * smoothstep(0, 0.5, regions.palm_facing) * near
                marks.add(crease, darkness=0.30, redness=0.25, relief_mm=-0.35)
            flexion = pose.flexion_fraction(bone, full_deg=60)
            if k == 1:
                distance = np.linalg.norm(points - joint - [0.0, 0.0, 9.0], axis=1)
                knuckle = np.exp(-((distance / 9) ** 2)) * regions.dorsal
                marks.add(knuckle, 0.06 * (0.5 + darkness), 0.35, 0.4 * flexion)
            else:
                back = regions.dorsal * near
                folded = np.exp(-((along / (4.2 if k == 2 else 3.0)) ** 2)) * back * (1 - 0.8 * flexion)
                wave = np.cos(2 * np.pi * along / 2.1 + 2 * wobble + 2 * fine_wobble)
                marks.add(folded * np.clip(wave, 0, 1), darkness=0.24 * (0.4 + wrinkles))
                marks.add(folded * wave, relief_mm=-0.2 * (0.4 + wrinkles))
                bulge = np.exp(-((along / 5.3) ** 2)) * back
                marks.add(bulge, 0.10 * (0.5 + darkness), 0.35 * (1 - 0.5 * flexion), 0.5)
        tip_distance = np.linalg.norm(points - regions.joints_mm[f"finger-{digit}-4"], axis=1)
        marks.add(np.exp(-((tip_distance / 11) ** 2)) * (0.4 + 0.6 * regions.palmar), redness=0.55)


def add_palm_lines(marks: Marks, regions: Regions, rng: np.random.Generator) -> None:
    """Add the three main lines of the palm, at anatomical positions with noise, and small random lines."""
    palm = regions.palmar * smoothstep(0.2, 0.6, -regions.normals[:, 2])
    palm = palm * np.clip(1 - 1.5 * (regions.all_digits_weight - regions.digit_weights[1]), 0, 1)
    palm_vertices = np.flatnonzero(palm > 0)
    palm_xy = regions.points_mm[palm_vertices, :2]
    knuckle = {f: regions.joints_mm[f"finger-{f}-1"][:2] for f in FINGERS}

    def near(point: Array, offset: tuple[float, float], noise_mm: float = 3.0) -> Array:
        return np.asarray(point + offset + rng.normal(0, noise_mm, 2))

    def add_line(line: Array, width_mm: float, taper: float, **strength: float) -> None:
        distance, t = distance_to_polyline(palm_xy, line)
        mark = np.zeros(len(palm))
        mark[palm_vertices] = np.exp(-((distance / width_mm) ** 2)) * np.minimum(1, np.minimum(t, 1 - t) * taper)
        marks.add(mark * palm, **strength)

    fork = knuckle[2] + [-20.0, -11.0]
    between = (knuckle[3] + knuckle[2]) / 2
    heart_line = [
        near(knuckle[5], (-17, 12)),
        near(knuckle[4], (-15, 2)),
        near(knuckle[3], (-10, 1), 2),
        near(between, (6, 0), 2),
    ]
    head_line = [fork, near(knuckle[3], (-30, -2)), near(knuckle[4], (-42, 2)), near(knuckle[5], (-52, 4))]
    life_line = [
        fork,
        near(knuckle[2], (-33, 3), 2),
        near(knuckle[3], (-55, -2), 2),
        near(np.zeros(2), (26, -6), 2),
        [8, -4],
    ]
    for knots in (heart_line, head_line, life_line):
        add_line(catmull_rom(np.array(knots)), 0.9, 6, darkness=0.24, redness=0.35, relief_mm=-0.4)
    for _ in range(N_SMALL_PALM_LINES):
        start, angle = np.array([rng.uniform(5, 85), rng.uniform(-28, 28)]), rng.uniform(0, np.pi)
        end = start + rng.uniform(8, 22) * np.array([np.cos(angle), np.sin(angle)])
        add_line(np.array([start, end]), 0.7, 4, darkness=0.07)


def add_wrist_lines(marks: Marks, regions: Regions, seed: int) -> None:
    """Add the two lines across the palm side of the wrist."""
    x, y = regions.points_mm[:, 0], regions.points_mm[:, 1]
    wobble = 1.4 * value_noise(regions.points_mm / 6, seed)
    for line_x_mm in WRIST_LINES_X_MM:
        line = np.exp(-(((x - line_x_mm + wobble + 0.0036 * y**2) / 0.8) ** 2))
        line = line * smoothstep(0.1, 0.6, -regions.normals[:, 2]) * (np.abs(y) < 32)
        marks.add(line, darkness=0.12, relief_mm=-0.2)
