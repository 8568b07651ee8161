"""Convex parts of a tool: elliptic discs, boxes, capsules and spheres, fixed in the tool's frame (z up)."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.planning.disc_cover import distance_to_ellipse

Array = NDArray[np.float64]
ENDS = np.array([-1.0, 1.0])
KINDS = ("disc", "box", "capsule", "sphere")
MAX_EXTENT_M = 1.0
"""Largest distance of a point of a tool from its center: distances, tables and step lengths scale with it."""


@dataclasses.dataclass(frozen=True)
class ToolPart:
    """A convex part of a tool: a core, grown by ``radius_m`` on all sides.

    Attributes:
        kind: ``disc`` (elliptic cylinder with a vertical axis), ``box``, ``capsule`` or ``sphere``.
        x_m, y_m, z_m: center in the tool's frame.
        half_x_m, half_y_m, half_z_m: semi-axes and half height of a disc, half edges of a box, or the vector from the
            center to one end of a capsule's axis; 0 for a sphere.
        radius_m: of a capsule or sphere; rounds the edges of a disc or box.
        yaw_rad: turn of a disc or box about its vertical axis.
    """

    kind: str = "sphere"
    x_m: float = 0.0
    y_m: float = 0.0
    z_m: float = 0.0
    half_x_m: float = 0.0
    half_y_m: float = 0.0
    half_z_m: float = 0.0
    radius_m: float = 0.0
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise SettingsError(f"kind of a part must be one of {KINDS}, got {self.kind!r}")
        if not all(math.isfinite(value) for name, value in dataclasses.asdict(self).items() if name != "kind"):
            raise SettingsError(f"a part must have finite dimensions, got {self}")
        solid = self.kind in ("disc", "box")
        half = self.half_x_m, self.half_y_m, self.half_z_m
        if solid and not (min(half) > 0 and self.radius_m >= 0):
            raise SettingsError(f"a {self.kind} needs positive half sizes and radius_m >= 0, got {self}")
        if not solid and not self.radius_m >= 0:
            raise SettingsError(f"radius_m of a {self.kind} must not be negative, got {self.radius_m}")
        if self.kind == "sphere" and half != (0.0, 0.0, 0.0):
            raise SettingsError(f"a sphere has no half_x_m, half_y_m or half_z_m, got {half}; use a capsule")
        if self.reach_m > MAX_EXTENT_M:
            raise SettingsError(f"a part must lie within {MAX_EXTENT_M} m of the tool's center, got {self}")

    @property
    def is_segment(self) -> bool:
        """Whether the core is a segment or a point, not a disc or box."""
        return self.kind in ("capsule", "sphere")

    @property
    def inscribed_m(self) -> float:
        """Radius of a ball around the center that lies in the part."""
        half = 0.0 if self.is_segment else min(self.half_x_m, self.half_y_m, self.half_z_m)
        return half + self.radius_m

    @property
    def bottom_m(self) -> float:
        """Height of the lowest point in the tool's frame."""
        return self.z_m - abs(self.half_z_m) - self.radius_m

    @property
    def rho_max_m(self) -> float:
        """Largest horizontal distance of a point from the yaw axis, or a bound of it for a disc."""
        x, y = self.corners()[:, :2].T
        if self.kind == "disc" and self.x_m == self.y_m == 0:
            return max(self.half_x_m, self.half_y_m) + self.radius_m
        return float(np.hypot(x, y).max()) + self.radius_m

    @property
    def reach_m(self) -> float:
        """Largest distance of a point from the tool's center, or a bound of it."""
        return math.hypot(self.rho_max_m - self.radius_m, abs(self.z_m) + abs(self.half_z_m)) + self.radius_m

    @property
    def params(self) -> tuple[float, ...]:
        """The part as a row for compiled code: code of the core, center, half sizes, cosine and sine, radius."""
        code = 2.0 if self.is_segment else float(KINDS.index(self.kind))
        half = self.half_x_m, self.half_y_m, self.half_z_m
        turn = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
        return (code, self.x_m, self.y_m, self.z_m, *half, *turn, self.radius_m)

    @property
    def center_m(self) -> tuple[float, float, float]:
        """Center in the tool's frame."""
        return self.x_m, self.y_m, self.z_m

    def surface_points(self) -> Array:
        """Points (n, 3) on the surface of the part, in the tool's frame; their convex hull is the part, inscribed."""
        core = self.corners()
        around = np.linspace(0, 2 * np.pi, 48, endpoint=False)
        if self.kind == "disc":
            rim = np.stack([self.half_x_m * np.cos(around), self.half_y_m * np.sin(around)], axis=1)
            core = self._placed(np.concatenate([np.column_stack([rim, np.full(48, z)]) for z in self.half_z_m * ENDS]))
        if self.radius_m == 0:
            return core
        up = np.linspace(-np.pi / 2, np.pi / 2, 9)[:, None]
        ball = [np.cos(up) * np.cos(around[::3]), np.cos(up) * np.sin(around[::3]), np.sin(up) + 0 * around[::3]]
        return np.asarray((core[:, None] + self.radius_m * np.stack(ball, axis=-1).reshape(-1, 3)).reshape(-1, 3))

    def corners(self) -> Array:
        """Points (n, 3) whose convex hull contains the core, in the tool's frame."""
        half = np.array([self.half_x_m, self.half_y_m, self.half_z_m])
        if self.is_segment:
            return self._placed(np.array([-half, half]))
        signs = np.stack(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]), axis=-1).reshape(-1, 3)
        return self._placed(signs * half)

    def distance_m(self, points_m: Array) -> Array:
        """Distance (N,) of points (N, 3) in the tool's frame to the part; 0 inside."""
        x, y, z = (np.asarray(points_m, dtype=np.float64) - [self.x_m, self.y_m, self.z_m]).T
        half = np.array([self.half_x_m, self.half_y_m, self.half_z_m])
        if self.is_segment:
            along = np.clip((x * half[0] + y * half[1] + z * half[2]) / max(float(half @ half), 1e-300), -1, 1)
            core_m = np.linalg.norm(np.stack([x, y, z], axis=1) - along[:, None] * half, axis=1)
        else:
            cos, sin = math.cos(self.yaw_rad), math.sin(self.yaw_rad)
            x, y = cos * x + sin * y, cos * y - sin * x
            if self.kind == "disc" and half[0] == half[1]:
                beside = np.maximum(np.hypot(x, y) - half[0], 0)
            elif self.kind == "disc":
                beside = distance_to_ellipse(np.stack([x, y], axis=1), half[0], half[1])
            else:
                beside = np.hypot(np.maximum(np.abs(x) - half[0], 0), np.maximum(np.abs(y) - half[1], 0))
            core_m = np.hypot(beside, np.maximum(np.abs(z) - half[2], 0))
        return np.asarray(np.maximum(core_m - self.radius_m, 0.0))

    def balls(self, cells: int = 8, least_m: float = 0.02) -> Array:
        """Balls (n, 4), center and radius, that cover the part: one per cell of its box.

        Cells have edges of at least ``least_m`` and at most an eighth of the longest side, so that the number of balls
        does not depend on the size of the part.
        """
        half = np.abs([self.half_x_m, self.half_y_m, self.half_z_m])
        edge = max(least_m, 2 * float(half.max()) / cells)
        if self.is_segment:
            count = max(1, math.ceil(2 * float(np.linalg.norm(half)) / edge))
            axis = np.array([self.half_x_m, self.half_y_m, self.half_z_m])
            centers = ((2 * np.arange(count) + 1) / count - 1)[:, None] * axis
            radius = float(np.linalg.norm(half)) / count + self.radius_m
        else:
            counts = np.maximum(np.ceil(2 * half / edge).astype(int), 1)
            index = np.stack(np.meshgrid(*map(np.arange, counts), indexing="ij"), axis=-1).reshape(-1, 3)
            cell = half / counts
            centers, radius = (2 * index + 1 - counts) * cell, float(np.linalg.norm(cell)) + self.radius_m
            if self.kind == "disc":  # without the cells beside the ellipse
                from_center = np.maximum(np.abs(centers[:, :2]) - cell[:2], 0) / half[:2]
                centers = centers[np.hypot(*from_center.T) <= 1]
        return np.column_stack([self._placed(centers), np.full(len(centers), radius)])

    def _placed(self, points: Array) -> Array:
        """Points (n, 3) of the part's own frame in the tool's frame; a segment has no yaw of its own."""
        cos, sin = (1.0, 0.0) if self.is_segment else (math.cos(self.yaw_rad), math.sin(self.yaw_rad))
        x, y, z = points.T
        turned = np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1)
        return turned + np.array([self.x_m, self.y_m, self.z_m])
