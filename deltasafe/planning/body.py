"""R_0, the space that the tool occupies at the zero pose (section IV-A); shared by planner and simulator."""

import dataclasses
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.planning.disc_cover import bounding_balls, disc_cover, distance_to_ellipse

Array = NDArray[np.float64]
NO_SHAFT_M = -1e6
"""Shaft radius of a body without a shaft: its clearance is then never the smallest."""


class BodyParams(NamedTuple):
    """Dimensions of a body, as compiled code reads them. Without a shaft, ``shaft_radius_m`` is negative."""

    disc_radius_m: float
    half_thickness_m: float
    shaft_radius_m: float
    rho_max_m: float
    semi_axis_x_m: float
    semi_axis_y_m: float


@dataclasses.dataclass(frozen=True)
class ToolBody:
    """An elliptic disc parallel to the table at the lower end of a slim vertical shaft (decision 12).

    The pose of the tool is the center of the disc. Yaw turns the ellipse, with period pi. The shaft ends at the flange,
    ``shaft_length_m`` above the center of the disc. A length of 0 means the disc alone, as in section V-B of the paper.
    """

    semi_axis_x_m: float = 0.03
    semi_axis_y_m: float = 0.015
    thickness_m: float = 0.01
    shaft_radius_m: float = 0.005
    shaft_length_m: float = 0.25

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not (math.isfinite(value) and (value > 0 or (name == "shaft_length_m" and value == 0))):
                raise SettingsError(f"{name} must be a positive length in meters, got {value}")
        if self.shaft_radius_m > min(self.semi_axis_x_m, self.semi_axis_y_m):
            raise SettingsError(f"shaft_radius_m {self.shaft_radius_m} is wider than the disc")

    @property
    def rho_max_m(self) -> float:
        """Largest distance of a point of the body from the yaw axis: converts yaw error to workspace error."""
        return max(self.semi_axis_x_m, self.semi_axis_y_m)

    @property
    def disc_radius_m(self) -> float:
        """Radius of the ball around the center that encloses the disc."""
        return math.hypot(self.rho_max_m, self.thickness_m / 2)

    @property
    def params(self) -> BodyParams:
        """Dimensions for compiled code."""
        return BodyParams(
            self.disc_radius_m,
            self.thickness_m / 2,
            self.shaft_radius_m if self.shaft_length_m > 0 else NO_SHAFT_M,
            self.rho_max_m,
            self.semi_axis_x_m,
            self.semi_axis_y_m,
        )

    def distance_m(self, points_m: Array) -> Array:
        """Distance (N,) of points (N, 3) in the body's frame to disc and shaft; 0 inside."""
        points_m = np.asarray(points_m, dtype=np.float64)
        beside = distance_to_ellipse(points_m[:, :2], self.semi_axis_x_m, self.semi_axis_y_m)
        above = np.maximum(np.abs(points_m[:, 2]) - self.thickness_m / 2, 0.0)
        disc_m = np.hypot(beside, above)
        if self.shaft_length_m == 0:
            return np.asarray(disc_m)
        off_axis = np.maximum(np.hypot(points_m[:, 0], points_m[:, 1]) - self.shaft_radius_m, 0.0)
        beyond = np.maximum(np.maximum(-points_m[:, 2], points_m[:, 2] - self.shaft_length_m), 0.0)
        return np.asarray(np.minimum(disc_m, np.hypot(off_axis, beyond)))

    def samples(self, margin_m: float, count: int, seed: int) -> Array:
        """Draw (count, 3) points uniformly from R_0 + B(margin), the Minkowski sum with a ball.

        The sum is no ellipsoid (decision 12). Points are drawn from two boxes that touch, one around the disc and one
        around the rest of the shaft, and accepted if their distance to the body is at most the margin.
        """
        if not (math.isfinite(margin_m) and margin_m >= 0) or count < 1:
            raise SettingsError(f"samples need margin_m >= 0 and count >= 1, got {margin_m}, {count}")
        rng = np.random.default_rng(seed)
        half = self.thickness_m / 2 + margin_m
        disc_box = np.array([self.semi_axis_x_m + margin_m, self.semi_axis_y_m + margin_m])
        shaft_box = np.full(2, self.shaft_radius_m + margin_m)
        top = max(self.shaft_length_m + margin_m, half) if self.shaft_length_m > 0 else half
        disc_volume = 4 * disc_box.prod() * 2 * half
        disc_fraction = disc_volume / (disc_volume + 4 * shaft_box.prod() * (top - half))
        accepted: list[Array] = []
        while sum(map(len, accepted)) < count:
            in_disc = rng.random(2 * count) < disc_fraction
            unit = rng.random((2 * count, 3))
            xy = (2 * unit[:, :2] - 1) * np.where(in_disc[:, None], disc_box, shaft_box)
            z = np.where(in_disc, (2 * unit[:, 2] - 1) * half, half + unit[:, 2] * (top - half))
            points_m = np.column_stack([xy, z])
            accepted.append(points_m[self.distance_m(points_m) <= margin_m])
        return np.concatenate(accepted)[:count]

    @property
    def disc_cover(self) -> tuple[Array, float]:
        """Small balls of equal size that cover the disc: centers (n, 3) in the body's frame, and radius."""
        return disc_cover(self.semi_axis_x_m, self.semi_axis_y_m, self.thickness_m)

    @property
    def bounding_balls(self) -> Array:
        """(m, 4) centers in the body's frame and radii of a few balls that cover the disc."""
        return bounding_balls(self.semi_axis_x_m, self.semi_axis_y_m, self.thickness_m)
