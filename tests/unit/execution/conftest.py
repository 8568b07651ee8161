"""A sphere as the hand, and rest-to-rest trajectories."""

import numpy as np
import pytest

from deltasafe.geometry import Trajectory
from deltasafe.planning.body import ToolBody

BODY = ToolBody()


def quintic(start, goal, duration_s, period_s=1e-3):
    """Rest-to-rest straight motion (minimum jerk)."""
    start, goal = np.asarray(start, dtype=float), np.asarray(goal, dtype=float)
    time_s = np.arange(round(duration_s / period_s) + 1) * period_s
    s = time_s / time_s[-1]
    poses = start + (goal - start) * (s**3 * (10 - 15 * s + 6 * s**2))[:, None]
    velocities = (goal - start) * (30 * s**2 * (1 - s) ** 2 / time_s[-1])[:, None]
    return Trajectory(time_s, poses, velocities)


def ball(center_m, radius_m, rings=24):
    """A closed triangle mesh on a sphere."""
    theta = np.pi * np.arange(1, rings) / rings
    phi = np.pi * np.arange(2 * rings) / rings
    grid = np.stack(
        [
            np.sin(theta)[:, None] * np.cos(phi),
            np.sin(theta)[:, None] * np.sin(phi),
            np.repeat(np.cos(theta)[:, None], len(phi), axis=1),
        ],
        axis=-1,
    ).reshape(-1, 3)
    vertices = np.concatenate([grid, [[0, 0, 1.0], [0, 0, -1.0]]]) * radius_m + np.asarray(center_m)
    count, top, bottom = len(phi), len(grid), len(grid) + 1
    triangles = []
    for k in range(count):
        after = (k + 1) % count
        triangles.append((top, k, after))
        last = (rings - 2) * count
        triangles.append((bottom, last + after, last + k))
        for row in range(rings - 2):
            a, b = row * count + k, row * count + after
            triangles += [(a, a + count, b), (b, a + count, b + count)]
    return vertices.astype(np.float32), np.array(triangles, dtype=np.int32)


@pytest.fixture(scope="session")
def hand():
    """A sphere below the straight line from start to goal at z = 0.12 m."""
    return ball((0.0, -0.02, 0.03), 0.04)
