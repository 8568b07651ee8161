"""Things that lie about on a table: boxes, cups, balls, paper, pens, telephones; none where the hand is."""

import math

import numpy as np
from numpy.typing import NDArray

from generator.recipe import Ground
from generator.skin.palette import linear
from generator.stage import Ball, Box, Cylinder, Disk, Material, Shape
from generator.surroundings import CollisionArrays

__all__ = ["scatter_clutter"]

Array = NDArray[np.float64]
KINDS = ("box", "cup", "ball", "paper", "pen", "telephone")
AWAY_FROM_HAND_M = 0.055
TRIALS = 30


def scatter_clutter(ground: Ground, surroundings: CollisionArrays, hand_m: Array) -> list[Shape]:
    """Up to ``ground.clutter`` things, apart from the hand (N, 3) as seen from above; fewer if there is no room."""
    rng = np.random.default_rng(ground.clutter_seed)
    shapes: list[Shape] = []
    for _ in range(ground.clutter):
        for _ in range(TRIALS):
            x, y = rng.uniform(-0.3, 0.3, 2).tolist()
            if np.hypot(hand_m[:, 0] - x, hand_m[:, 1] - y).min() > AWAY_FROM_HAND_M:
                shapes.extend(_thing(str(rng.choice(KINDS)), x, y, surroundings, rng))
                break
    return shapes


def _material(surroundings: CollisionArrays, rng: np.random.Generator) -> Material:
    colour = tuple(np.clip(linear(rng.integers(10, 250, 3)), 0.01, 0.9).tolist())
    if rng.random() < 0.45:
        texture = surroundings.surface(str(rng.choice(surroundings.surface_names)), colour, int(rng.integers(1 << 20)))
        return Material(texture=texture, tiles=float(rng.uniform(0.3, 1)), roughness=float(rng.uniform(0.2, 0.8)))
    return Material(colour=colour, roughness=float(rng.uniform(0.15, 0.8)), specular=0.5)


def _thing(kind: str, x: float, y: float, surroundings: CollisionArrays, rng: np.random.Generator) -> list[Shape]:
    turn, material = float(rng.uniform(0, 360)), _material(surroundings, rng)
    match kind:
        case "box":
            a, b, c = rng.uniform(0.015, 0.045, 3).tolist()
            return [Box((x, y, c), (a, b, c), turn, material)]
        case "cup":
            radius, height = float(rng.uniform(0.015, 0.04)), float(rng.uniform(0.03, 0.11))
            drink = Material(colour=tuple((rng.uniform(0.02, 0.5) * np.array([1, 0.8, 0.6])).tolist()), roughness=0.3)
            return [
                Cylinder((x, y, 0.0), (x, y, height), radius, material),
                Disk((x, y, 0.9 * height), radius, drink),
            ]
        case "ball":
            radius = float(rng.uniform(0.015, 0.04))
            return [Ball((x, y, radius), radius, material)]
        case "paper":
            paper = material if rng.random() < 0.5 else Material(colour=(0.8, 0.8, 0.78))
            return [
                Box(
                    (x, y, 0.0008), (float(rng.uniform(0.05, 0.1)), float(rng.uniform(0.06, 0.15)), 0.0008), turn, paper
                )
            ]
        case "pen":
            dx, dy = 0.07 * math.cos(math.radians(turn)), 0.07 * math.sin(math.radians(turn))
            return [Cylinder((x - dx, y - dy, 0.005), (x + dx, y + dy, 0.005), 0.0045, material)]
        case _:
            glass = Material(colour=(0.01, 0.01, 0.012), roughness=0.08, specular=0.6)
            return [Box((x, y, 0.004), (0.036, 0.075, 0.004), turn, glass)]
