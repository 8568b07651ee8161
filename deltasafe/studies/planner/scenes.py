"""Scenes of the planner study (section V-B): three large obstacles, eight small ones, or any number of spheres.

One unit of the paper's figures is 0.1 m, a tenth of the workspace.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.planning import ToolBody
from deltasafe.scene import Cuboid, Shape, Sphere

Array = NDArray[np.float64]

PAPER_UNIT_M = 0.1
WORKSPACE_M = (0.0, 0.0, 0.0), (1.0, 1.0, 0.5)

# the disc stays inside the workspace in every pose between these bounds; its ellipse is symmetric under half a turn
LOWEST_POSE = (0.06, 0.06, 0.06, -math.pi / 2)
HIGHEST_POSE = (0.94, 0.94, 0.44, math.pi / 2)
START = (0.1, 0.1, 0.25, 0.0)
GOAL = (0.9, 0.9, 0.25, 0.0)


@dataclasses.dataclass(frozen=True)
class StudyScene:
    """Obstacles in the workspace of 1 x 1 x 0.5 m, between start and goal in opposite corners."""

    name: str
    shapes: tuple[Shape, ...]


def simple_scene() -> StudyScene:
    """Create the scene with three large obstacles."""
    return StudyScene(
        "simple",
        (
            Sphere((0.52, 0.50, 0.24), 0.16),
            Cuboid((0.28, 0.36, 0.22), (0.07, 0.07, 0.07), 0.4),
            Sphere((0.75, 0.68, 0.27), 0.11),
        ),
    )


def cluttered_scene() -> StudyScene:
    """Create the scene with eight small obstacles."""
    return StudyScene(
        "cluttered",
        (
            Sphere((0.26, 0.23, 0.26), 0.06),
            Sphere((0.36, 0.46, 0.20), 0.07),
            Cuboid((0.54, 0.32, 0.26), (0.04, 0.04, 0.04), 0.3),
            Sphere((0.53, 0.56, 0.28), 0.07),
            Cuboid((0.34, 0.70, 0.28), (0.04, 0.04, 0.04), 0.9),
            Sphere((0.74, 0.50, 0.22), 0.06),
            Sphere((0.58, 0.82, 0.24), 0.06),
            Sphere((0.77, 0.75, 0.26), 0.06),
        ),
    )


def crowded_scene(count: int, seed: int, radius_m: float = 0.03) -> StudyScene:
    """Create spheres at random positions that leave start and goal free (Fig. 6).

    Scenes of one seed are nested: a scene of ``count + 1`` spheres starts with the spheres of ``count``.

    Raises:
        SettingsError: ``count`` is less than one.
    """
    if count < 1:
        raise SettingsError(f"a crowded scene needs at least one obstacle, got {count}")
    rng = np.random.default_rng(seed)
    lower, upper = (np.asarray(corner) for corner in WORKSPACE_M)
    shapes: list[Shape] = []
    while len(shapes) < count:
        center = rng.uniform(lower + radius_m, upper - radius_m)
        if min(np.linalg.norm(center - pose[:3]) for pose in (START, GOAL)) > 0.15 + radius_m:
            shapes.append(Sphere((float(center[0]), float(center[1]), float(center[2])), radius_m))
    return StudyScene(f"{count} spheres", tuple(shapes))


@dataclasses.dataclass(frozen=True)
class EllipticDisc(ToolBody):
    """R(p) of section V-B: an elliptic disc parallel to the table, without a shaft."""

    semi_axis_x_m: float = 0.04
    semi_axis_y_m: float = 0.02
    thickness_m: float = 0.002
    shaft_length_m: float = 0.0

    def samples(self, margin_m: float, count: int, seed: int) -> Array:
        """Draw points (count, 3) uniformly from the disc enlarged by a ball of radius ``margin_m``."""
        if not (math.isfinite(margin_m) and margin_m >= 0) or count < 1:
            raise SettingsError(f"samples need margin_m >= 0 and count >= 1, got {margin_m} and {count}")
        rng = np.random.default_rng(seed)
        half = np.array([self.semi_axis_x_m, self.semi_axis_y_m, self.thickness_m / 2]) + margin_m
        kept: list[Array] = []
        while sum(map(len, kept)) < count:
            points_m = (2 * rng.random((2 * count, 3)) - 1) * half
            kept.append(points_m[self.distance_m(points_m) <= margin_m])
        return np.concatenate(kept)[:count]
