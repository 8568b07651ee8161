"""Veins and tendons on the back of the hand."""

import numpy as np
from numpy.typing import NDArray

from generator.aliases import Array
from generator.noise import catmull_rom, distance_to_polyline, smoothstep
from generator.pose import Pose
from generator.skeleton import FINGERS
from generator.skin.marks import Marks
from generator.skin.regions import Regions

N_VEINS = 5


def add_veins(marks: Marks, regions: Regions, strength: float, darkness: float, rng: np.random.Generator) -> None:
    """Add bluish ridges that follow random curves from the knuckles to the forearm."""
    back, vertices = _back_of_hand(regions)
    for _ in range(N_VEINS if strength > 0 else 0):
        y, knots = rng.uniform(-15, 30), []
        for x in np.linspace(90, -200, 9):
            knots.append([x, y])
            y = float(np.clip(y + rng.normal(0, 9), -34, 30))
        distance, t = distance_to_polyline(regions.points_mm[vertices, :2], catmull_rom(np.array(knots)))
        vein = np.zeros(len(back))
        vein[vertices] = np.exp(-((distance / 1.8) ** 2)) * smoothstep(0, 0.12, t)
        vein *= back * strength
        marks.add(vein, relief_mm=0.45)
        marks.absorb(vein * (1 - 0.6 * darkness), (0.17, 0.09, 0.05))


def add_tendons(marks: Marks, regions: Regions, pose: Pose, wrinkles: float) -> None:
    """Add the ridges of the extensor tendons from each knuckle towards the wrist; flexion of the finger hides them."""
    back, vertices = _back_of_hand(regions)
    for finger in FINGERS:
        knuckle = regions.joints_mm[f"finger-{finger}-1"][:2]
        line = np.stack([knuckle - (4, 0), knuckle * (0.3, 0.45) + (2, 0)])
        distance, t = distance_to_polyline(regions.points_mm[vertices, :2], line)
        tendon = np.zeros(len(back))
        tendon[vertices] = np.exp(-((distance / 2.6) ** 2)) * smoothstep(0, 0.25, 1 - t)
        visibility = (0.3 + wrinkles) * (1 - 0.7 * pose.flexion_fraction(f"finger{finger}-1", full_deg=50))
        marks.add(tendon * back, relief_mm=0.8 * visibility)


def _back_of_hand(regions: Regions) -> tuple[Array, NDArray[np.int64]]:
    """Return a blend weight (V,) and the indices of the vertices where it is positive, without the upper forearm."""
    weight = smoothstep(0.25, 0.7, regions.normals[:, 2]) * np.clip(1 - 1.6 * regions.all_digits_weight, 0, 1)
    return weight, np.flatnonzero((weight > 0) & (regions.points_mm[:, 0] > -220))
