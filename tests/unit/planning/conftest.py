"""Random analytic scenes, and an audit that shares no code with the segment tests."""

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from deltasafe.planning import ToolBody
from deltasafe.scene import Cuboid, OccupancyGrid, Shape, Sphere, grid_from_shapes

LOWER, UPPER = (-0.2, -0.15, 0.0), (0.2, 0.15, 0.09)


def random_grid(seed: int, count: int = 4, voxel_m: float = 0.005) -> OccupancyGrid:
    rng = np.random.default_rng(seed)
    shapes: list[Shape] = []
    for _ in range(count):
        x, y = rng.uniform(-0.08, 0.08), rng.uniform(-0.14, 0.14)
        if rng.random() < 0.5:
            shapes.append(Sphere((x, y, rng.uniform(0.0, 0.08)), rng.uniform(0.01, 0.03)))
        else:
            half = tuple(rng.uniform(0.008, 0.03, 3))
            shapes.append(Cuboid((x, y, half[2]), half, rng.uniform(0, np.pi)))
    return grid_from_shapes(shapes, 0.01, LOWER, UPPER, voxel_m)


def unsafe_fraction(
    grid: OccupancyGrid, delta: float, body: ToolBody, margin_m: float, poses: np.ndarray, spacing_m: float = 0.001
) -> float:
    """Fraction of poses, ``spacing_m`` apart, with a point of the enlarged body in the unsafe set."""
    points = body.samples(margin_m, 4400, seed=12345)
    n_unsafe = n_poses = 0
    for a, b in itertools.pairwise(poses):
        motion = np.linalg.norm((b - a)[:3]) + body.rho_max_m * abs(b[3] - a[3])
        for t in np.linspace(0, 1, 1 + max(1, int(np.ceil(motion / spacing_m)))):
            x, y, z, yaw = a + t * (b - a)
            cos, sin = np.cos(yaw), np.sin(yaw)
            turned = points @ np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]]) + (x, y, z)
            n_unsafe += bool((grid.at(turned) > np.float32(delta)).any())
            n_poses += 1
    return n_unsafe / n_poses


@pytest.fixture(scope="session")
def make_grid() -> Callable[..., OccupancyGrid]:
    return random_grid


@pytest.fixture(scope="session")
def audit() -> Callable[..., float]:
    return unsafe_fraction
