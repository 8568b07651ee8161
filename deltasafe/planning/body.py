"""R_0, the space that the tool occupies at the zero pose (section IV-A); shared by planner and simulator."""

import dataclasses
import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.planning.disc_cover import bounding_balls, disc_cover
from deltasafe.planning.parts import MAX_EXTENT_M, ToolPart
from deltasafe.setting_ranges import check_range

Array = NDArray[np.float64]
NO_SHAFT_M = -1e6
"""Shaft radius of a body without a shaft: its clearance is then never the smallest."""


class BodyParams(NamedTuple):
    """Dimensions of a body, as compiled code reads them.

    Attributes:
        disc_radius_m: of the ball around the center that encloses the disc, or all parts below ``shaft_radius_m``.
        half_thickness_m: depth of the lowest point below the center.
        shaft_radius_m: of an infinite upright cylinder above the center that encloses the rest; negative without one.
        rho_max_m: largest distance of a point from the yaw axis.
    """

    disc_radius_m: float
    half_thickness_m: float
    shaft_radius_m: float
    rho_max_m: float


@dataclasses.dataclass(frozen=True)
class ToolBody:
    """An elliptic disc parallel to the table at the lower end of a slim vertical shaft (decision 12), or other parts.

    The pose of the tool is the center of the disc. Yaw turns the ellipse, with period pi. The shaft ends at the flange,
    ``shaft_length_m`` above the center of the disc. A length of 0 means the disc alone, as in section V-B of the paper.

    Attributes:
        semi_axis_x_m, semi_axis_y_m, thickness_m: of the disc.
        shaft_radius_m, shaft_length_m: of the shaft.
        parts: convex parts that replace the disc (decision 72); the shaft remains.
    """

    semi_axis_x_m: float = 0.03
    semi_axis_y_m: float = 0.015
    thickness_m: float = 0.01
    shaft_radius_m: float = 0.005
    shaft_length_m: float = 0.25
    parts: tuple[ToolPart, ...] = ()

    def __post_init__(self) -> None:
        check_range(self, f"(0, {MAX_EXTENT_M}]", "semi_axis_x_m", "semi_axis_y_m", "thickness_m", "shaft_radius_m")
        check_range(self, f"[0, {MAX_EXTENT_M}]", "shaft_length_m")
        if not self.parts and self.shaft_radius_m > min(self.semi_axis_x_m, self.semi_axis_y_m):
            raise SettingsError(f"shaft_radius_m {self.shaft_radius_m} is wider than the disc")

    @functools.cached_property
    def solids(self) -> tuple[ToolPart, ...]:
        """All convex parts: the disc or the parts that replace it, and the shaft from the center upward."""
        half = self.thickness_m / 2
        disc = ToolPart("disc", half_x_m=self.semi_axis_x_m, half_y_m=self.semi_axis_y_m, half_z_m=half)
        return (self.parts or (disc,)) + self.shaft

    @property
    def shaft(self) -> tuple[ToolPart, ...]:
        """The shaft as a part, if there is one."""
        half = self.shaft_length_m / 2
        radius = self.shaft_radius_m
        return (ToolPart("disc", z_m=half, half_x_m=radius, half_y_m=radius, half_z_m=half),) if half > 0 else ()

    @property
    def is_symmetric(self) -> bool:
        """Whether half a turn maps the body to itself; known of the disc only."""
        return not self.parts

    @functools.cached_property
    def rho_max_m(self) -> float:
        """Largest distance of a point of the body from the yaw axis: converts yaw error to workspace error."""
        return max(part.rho_max_m for part in self.solids)

    @property
    def disc_radius_m(self) -> float:
        """Radius of the ball around the center that encloses the disc or the parts."""
        if self.parts:
            return max(part.reach_m for part in self.parts)
        return math.hypot(self.rho_max_m, self.thickness_m / 2)

    @functools.cached_property
    def params(self) -> BodyParams:
        """Dimensions for compiled code."""
        if not self.parts:
            shaft_m = self.shaft_radius_m if self.shaft_length_m > 0 else NO_SHAFT_M
            return BodyParams(self.disc_radius_m, self.thickness_m / 2, shaft_m, self.rho_max_m)
        is_tall = [part.bottom_m >= 0 and part.reach_m > 2 * part.rho_max_m for part in self.solids]
        around_m = [part.reach_m for part, tall in zip(self.solids, is_tall, strict=True) if not tall]
        above_m = [part.rho_max_m for part, tall in zip(self.solids, is_tall, strict=True) if tall]
        bottom_m = min(part.bottom_m for part in self.solids)
        return BodyParams(max(around_m, default=0.0), -bottom_m, max(above_m, default=NO_SHAFT_M), self.rho_max_m)

    def distance_m(self, points_m: Array) -> Array:
        """Distance (N,) of points (N, 3) in the body's frame to the body; 0 inside."""
        return np.asarray(np.min([part.distance_m(points_m) for part in self.solids], axis=0))

    def samples(self, margin_m: float, count: int, seed: int) -> Array:
        """Draw (count, 3) points uniformly from R_0 + B(margin), the Minkowski sum with a ball.

        The sum is no ellipsoid (decision 12). Points are drawn from two boxes that touch, one around the disc and one
        around the rest of the shaft, and accepted if their distance to the body is at most the margin.

        Raises:
            SettingsError: the margin or the count is out of range, or the body has parts.
        """
        if not (math.isfinite(margin_m) and margin_m >= 0) or count < 1:
            raise SettingsError(f"samples need margin_m >= 0 and count >= 1, got {margin_m}, {count}")
        if self.parts:
            raise SettingsError("points are drawn from the disc only; use method continuous for a tool with parts")
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
