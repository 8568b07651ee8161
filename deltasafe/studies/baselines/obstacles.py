"""Obstacles of known shape and orientation at a Gaussian position: the input of the compared methods."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.scene import Shape, Sphere

Array = NDArray[np.float64]
Triple = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class GaussianObstacle:
    """An ellipsoid whose center is distributed as N(mean, covariance).

    Attributes:
        mean_m: mean of the center.
        semi_axes_m: along the axes of the ellipsoid; three equal values make a ball.
        covariance_m2: (3, 3) of the center in the world frame, positive definite.
        yaw_rad: rotation of the ellipsoid about the vertical axis.

    Raises:
        SettingsError: a value is not finite, a semi-axis not positive, or the covariance not positive definite.
    """

    mean_m: Triple
    semi_axes_m: Triple
    covariance_m2: tuple[Triple, Triple, Triple]
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if not np.isfinite([*self.mean_m, self.yaw_rad]).all():
            raise SettingsError(f"mean_m and yaw_rad must be finite, got {self.mean_m} and {self.yaw_rad}")
        if not all(math.isfinite(value) and value > 0 for value in self.semi_axes_m):
            raise SettingsError(f"semi_axes_m must be positive, got {self.semi_axes_m}")
        covariance = np.asarray(self.covariance_m2, dtype=np.float64)
        if covariance.shape != (3, 3) or not np.isfinite(covariance).all():
            raise SettingsError(f"covariance_m2 must be a finite 3 x 3 matrix, got {self.covariance_m2}")
        largest = np.abs(covariance).max()
        if np.abs(covariance - covariance.T).max() > 1e-9 * largest or np.linalg.eigvalsh(covariance)[0] <= 0:
            raise SettingsError(f"covariance_m2 must be symmetric and positive definite, got {self.covariance_m2}")

    @classmethod
    def ball(cls, mean_m: Triple, radius_m: float, sigma_m: float) -> "GaussianObstacle":
        """Create a ball with isotropic noise N(mean, sigma^2 I), as in section V-B."""
        return cls(mean_m, (radius_m,) * 3, isotropic_covariance(sigma_m))


def isotropic_covariance(sigma_m: float) -> tuple[Triple, Triple, Triple]:
    """Return sigma^2 I."""
    variance = float(sigma_m) ** 2
    return (variance, 0.0, 0.0), (0.0, variance, 0.0), (0.0, 0.0, variance)


def enclosing_obstacle(shape: Shape, sigma_m: float) -> GaussianObstacle:
    """Convert a sphere to a ball, and a cuboid to its smallest enclosing ellipsoid (half edges times sqrt(3))."""
    if isinstance(shape, Sphere):
        return GaussianObstacle.ball(shape.center_m, shape.radius_m, sigma_m)
    x, y, z = (math.sqrt(3) * half_m for half_m in shape.half_extents_m)
    return GaussianObstacle(shape.center_m, (x, y, z), isotropic_covariance(sigma_m), shape.yaw_rad)


@dataclasses.dataclass(frozen=True)
class ObstacleArrays:
    """Obstacles as whitening maps w = map (p - mean), with a collision iff |w| <= 1.

    In this frame the obstacle, grown by the robot's ball, is the unit ball, and w has the covariance diag(spread).

    Attributes:
        mean_m: (n, 3).
        map: (n, 3, 3), 1 / m.
        spread: (n, 3).
        axis_m: (n, 2) smallest and largest semi-axis of the grown obstacle.
    """

    mean_m: Array
    map: Array
    spread: Array
    axis_m: Array


def obstacle_arrays(obstacles: Sequence[GaussianObstacle], robot_radius_m: float, hull_level: float) -> ObstacleArrays:
    """Grow obstacles by the robot's ball (a + r, Zhu and Alonso-Mora 2019, eq. 3) and diagonalize their covariance.

    For a ball, a + r is the Minkowski sum. For an ellipsoid it is slightly smaller, as published.

    Args:
        obstacles: n obstacles.
        robot_radius_m: radius of the ball that encloses the robot.
        hull_level: enlarges semi-axes by this multiple of the largest standard deviation (Kamel 2017).
    """
    if not (math.isfinite(robot_radius_m) and robot_radius_m >= 0):
        raise SettingsError(f"robot_radius_m must not be negative, got {robot_radius_m}")
    n = len(obstacles)
    mean, maps, spread, axis = np.zeros((n, 3)), np.zeros((n, 3, 3)), np.zeros((n, 3)), np.zeros((n, 2))
    for index, obstacle in enumerate(obstacles):
        covariance = np.asarray(obstacle.covariance_m2, dtype=np.float64)
        largest_sigma_m = math.sqrt(np.linalg.eigvalsh(covariance)[-1])
        axes = np.asarray(obstacle.semi_axes_m) + robot_radius_m + hull_level * largest_sigma_m
        cos, sin = math.cos(obstacle.yaw_rad), math.sin(obstacle.yaw_rad)
        to_axes = np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])
        to_unit_ball = to_axes / axes[:, None]
        values, vectors = np.linalg.eigh(to_unit_ball @ covariance @ to_unit_ball.T)
        if values[-1] - values[0] <= 1e-9 * values[-1]:
            values = np.full(3, values.mean())  # exactly isotropic values select the closed forms
        mean[index], maps[index], spread[index] = obstacle.mean_m, vectors.T @ to_unit_ball, values
        axis[index] = axes.min(), axes.max()
    return ObstacleArrays(mean, maps, spread, axis)
