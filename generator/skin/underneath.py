"""What shows through the skin of the back of the hand: veins and tendons."""

import numpy as np
from numpy.typing import NDArray

from generator.noise import catmull_rom, distance_to_polyline, smoothstep
from generator.pose import Pose
from generator.skeleton import FINGERS
from generator.skin.folds import bend
from generator.skin.marks import Marks
from generator.skin.regions import Regions

__all__ = ["draw_tendons", "draw_veins"]

Array = NDArray[np.float64]
N_VEINS = 5


def _back(regions: Regions) -> tuple[Array, NDArray[np.int64]]:
    share = smoothstep(0.25, 0.7, regions.normals[:, 2]) * np.clip(1 - 1.6 * regions.fingers_share, 0, 1)
    return share, np.flatnonzero((share > 0) & (regions.points_mm[:, 0] > -220))


def draw_veins(marks: Marks, regions: Regions, strength: float, dark: float, rng: np.random.Generator) -> None:
    """Bluish ridges that wander from the knuckles to the forearm."""
    back, where = _back(regions)
    for _ in range(N_VEINS if strength > 0 else 0):
        across, knots = rng.uniform(-15, 30), []
        for x in np.linspace(90, -200, 9):
            knots.append([x, across])
            across = float(np.clip(across + rng.normal(0, 9), -34, 30))
        distance, place = distance_to_polyline(regions.points_mm[where, :2], catmull_rom(np.array(knots)))
        vein = np.zeros(len(back))
        vein[where] = np.exp(-((distance / 1.8) ** 2)) * smoothstep(0, 0.12, place)
        vein *= back * strength
        marks.add(vein, relief_mm=0.45)
        marks.absorb(vein * (1 - 0.6 * dark), (0.17, 0.09, 0.05))


def draw_tendons(marks: Marks, regions: Regions, pose: Pose, wrinkles: float) -> None:
    """Ridges of the extensors, from each knuckle towards the wrist; a bent finger hides its own."""
    back, where = _back(regions)
    for finger in FINGERS:
        knuckle = regions.joints_mm[f"finger-{finger}-1"][:2]
        line = np.stack([knuckle - (4, 0), knuckle * (0.3, 0.45) + (2, 0)])
        distance, place = distance_to_polyline(regions.points_mm[where, :2], line)
        tendon = np.zeros(len(back))
        tendon[where] = np.exp(-((distance / 2.6) ** 2)) * smoothstep(0, 0.25, 1 - place)
        shown = (0.3 + wrinkles) * (1 - 0.7 * bend(pose, f"finger{finger}-1", 50))
        marks.add(tendon * back, relief_mm=0.8 * shown)
