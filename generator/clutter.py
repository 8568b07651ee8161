"""Random objects on the table: boxes, cups, balls, paper, pens and phones, away from the hand."""

import math

import numpy as np

from generator.aliases import Array
from generator.recipe import Table
from generator.skin.palette import random_albedo
from generator.stage import Box, Cylinder, Disk, Material, Shape, Sphere
from generator.surroundings import Surroundings

KINDS = ("box", "cup", "ball", "paper", "pen", "phone")
MIN_HAND_DISTANCE_M = 0.055
MAX_TRIALS = 30


def place_clutter(table: Table, surroundings: Surroundings, hand_m: Array) -> list[Shape]:
    """Place up to ``table.clutter_count`` objects at a horizontal distance from the hand's vertices (N, 3).

    An object that finds no free position is left out.
    """
    rng = np.random.default_rng(table.clutter_seed)
    shapes: list[Shape] = []
    for _ in range(table.clutter_count):
        for _ in range(MAX_TRIALS):
            x, y = rng.uniform(-0.3, 0.3, 2).tolist()
            if np.hypot(hand_m[:, 0] - x, hand_m[:, 1] - y).min() > MIN_HAND_DISTANCE_M:
                shapes.extend(_sample_object(str(rng.choice(KINDS)), x, y, surroundings, rng))
                break
    return shapes


def _sample_material(surroundings: Surroundings, rng: np.random.Generator) -> Material:
    color = random_albedo(rng, maximum=0.9)
    if rng.random() < 0.45:
        name, seed = str(rng.choice(surroundings.surface_names)), int(rng.integers(1 << 20))
        texture = surroundings.load_surface(name, color, seed)
        return Material(texture=texture, repeats=float(rng.uniform(0.3, 1)), roughness=float(rng.uniform(0.2, 0.8)))
    return Material(color=color, roughness=float(rng.uniform(0.15, 0.8)), specular=0.5)


def _sample_object(kind: str, x: float, y: float, surroundings: Surroundings, rng: np.random.Generator) -> list[Shape]:
    rotation_deg, material = float(rng.uniform(0, 360)), _sample_material(surroundings, rng)
    match kind:
        case "box":
            a, b, c = rng.uniform(0.015, 0.045, 3).tolist()
            return [Box((x, y, c), (a, b, c), rotation_deg, material)]
        case "cup":
            radius, height = float(rng.uniform(0.015, 0.04)), float(rng.uniform(0.03, 0.11))
            drink = Material(color=tuple((rng.uniform(0.02, 0.5) * np.array([1, 0.8, 0.6])).tolist()), roughness=0.3)
            cup = Cylinder((x, y, 0.0), (x, y, height), radius, material)
            return [cup, Disk((x, y, 0.9 * height), radius, drink)]
        case "ball":
            radius = float(rng.uniform(0.015, 0.04))
            return [Sphere((x, y, radius), radius, material)]
        case "paper":
            paper = material if rng.random() < 0.5 else Material(color=(0.8, 0.8, 0.78))
            half_size = (float(rng.uniform(0.05, 0.1)), float(rng.uniform(0.06, 0.15)), 0.0008)
            return [Box((x, y, 0.0008), half_size, rotation_deg, paper)]
        case "pen":
            angle = math.radians(rotation_deg)
            dx, dy = 0.07 * math.cos(angle), 0.07 * math.sin(angle)
            return [Cylinder((x - dx, y - dy, 0.005), (x + dx, y + dy, 0.005), 0.0045, material)]
        case _:
            glass = Material(color=(0.01, 0.01, 0.012), roughness=0.08, specular=0.6)
            return [Box((x, y, 0.004), (0.036, 0.075, 0.004), rotation_deg, glass)]
