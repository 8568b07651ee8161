"""A simulated camera above a moving hand: the true mesh of a logged scene, drawn at its true place in each image."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_erosion
from scipy.spatial import cKDTree

from deltasafe.errors import SettingsError
from deltasafe.online.frames import Frame
from deltasafe.scene import Camera, LoggedScene

Array = NDArray[np.float64]
Displacement = Callable[[float], Array]

SPACING_M = 0.004
FARTHEST_M = SPACING_M / math.sqrt(3)
"""Largest distance from a point of a triangle with edges of at most ``SPACING_M`` to the nearest of its corners."""

BORDER_PX = 3
NOISE_LEVELS = 2
"""Largest noise of a pixel; without noise two images would be equal to the last bit."""


def surface_points(vertices_m: NDArray[np.float32], triangles: NDArray[np.int32], spacing_m: float) -> Array:
    """Points (N, 3) on a mesh: each triangle between them has edges of at most ``spacing_m``."""
    corners = np.asarray(vertices_m, np.float64)[triangles]
    done = [corners.reshape(-1, 3)]
    while True:
        edges = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2)
        corners = corners[edges.max(axis=1) > spacing_m]
        if not len(corners):
            break
        middle = (corners + np.roll(corners, -1, axis=1)) / 2
        a, b, c = np.moveaxis(corners, 1, 0)
        ab, bc, ca = np.moveaxis(middle, 1, 0)
        parts = [(a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca)]
        corners = np.concatenate([np.stack(part, axis=1) for part in parts])
        done.append(middle.reshape(-1, 3))
    return np.unique(np.round(np.concatenate(done), 6), axis=0)


@dataclasses.dataclass(frozen=True)
class MovingHand:
    """A rigid hand that moves in the plane of the table, at constant height and without turning.

    Attributes:
        points_m: (N, 3) on its surface, without displacement.
        colors: (N, 3) uint8 of the points.
        displacement: (2,) in meters at a time.
    """

    points_m: Array
    colors: NDArray[np.uint8]
    displacement: Displacement

    def at(self, time_s: float) -> Array:
        """Points (N, 3) of its surface at a time."""
        return self.points_m + np.append(self.displacement(time_s), 0.0)

    @property
    def height_m(self) -> float:
        """Height of its highest point in the world frame."""
        return float(self.points_m[:, 2].max())


def hand_of(
    scene: LoggedScene, rgb: NDArray[np.uint8], displacement: Displacement, mask: NDArray[np.bool_] | None = None
) -> MovingHand:
    """Make the hand of a logged scene: its true shape, with the colors of its photograph (H, W, 3) uint8.

    What the photograph does not show has the color of the nearest point that it shows.

    Args:
        mask: (H, W) pixels of the photograph that show the hand; colors near its border, which mix with the background,
            are not taken. None: all pixels count.

    Raises:
        DataError: the scene has no true mesh.
    """
    points = surface_points(*scene.true_mesh(), SPACING_M)
    points = points[points[:, 2] > scene.table_z_m]
    rows, columns = pixels_of(points, scene.camera)
    shown = _inside(rows, columns, scene.camera)
    if mask is not None:
        shown[shown] = binary_erosion(mask, iterations=BORDER_PX)[rows[shown], columns[shown]]
    nearest = np.flatnonzero(shown)[cKDTree(points[shown]).query(points)[1]]
    return MovingHand(points, rgb[rows[nearest], columns[nearest]], displacement)


class SimulatedCamera:
    """Draws the hand over a background plate, with the perspective of the camera; a frame source.

    The shape is exact, because points of the surface are projected one by one; the shadow of the hand is not drawn.

    Args:
        hand: what moves.
        camera: pinhole.
        plate: (H, W, 3) uint8 of the empty table.
        period_s: time between two images.
        latency_s: time from the capture of an image until it, or what perception made of it, can be used.
        seed: of the noise.
    """

    def __init__(
        self,
        hand: MovingHand,
        camera: Camera,
        plate: NDArray[np.uint8],
        period_s: float = 0.1,
        latency_s: float = 0.1,
        seed: int = 0,
    ) -> None:
        if plate.shape != (camera.height, camera.width, 3):
            raise SettingsError(f"the plate must have the camera's size, got {plate.shape}")
        self.hand, self.camera, self._plate = hand, camera, plate
        self._period_s, self._latency_s, self._seed = period_s, latency_s, seed
        self._last: Frame | None = None

    def newest(self, now_s: float) -> Frame | None:
        """Return the newest image that has arrived by a time; times before 0 have none."""
        number = math.floor((now_s - self._latency_s) / self._period_s + 1e-9)
        if number < 0:
            return None
        captured_s = number * self._period_s
        if self._last is None or self._last.captured_s != captured_s:
            self._last = Frame(captured_s, self.draw(captured_s, number))
        return self._last

    @property
    def captured_s(self) -> float:
        """Capture time of the newest image; 0 before the first one."""
        return 0.0 if self._last is None else self._last.captured_s

    def draw(self, time_s: float, number: int = 0) -> NDArray[np.uint8]:
        """Draw the image (H, W, 3) at a time; ``number`` selects its noise."""
        points = self.hand.at(time_s)
        rows, columns = pixels_of(points, self.camera)
        order = np.argsort(points[:, 2], kind="stable")  # higher points hide lower ones
        rgb = self._plate.copy()
        for down, right in self._square(points):
            r, c = rows[order] + down, columns[order] + right
            inside = _inside(r, c, self.camera)
            rgb[r[inside], c[inside]] = self.hand.colors[order][inside]
        rng = np.random.default_rng((self._seed, number))
        noise = rng.integers(-NOISE_LEVELS, NOISE_LEVELS + 1, rgb.shape, dtype=np.int16)
        return np.clip(rgb + noise, 0, 255).astype(np.uint8)

    def silhouette(self, time_s: float) -> NDArray[np.bool_]:
        """Pixels (H, W) that show the hand at a time, never too few: the oracle of p_occupied."""
        points = self.hand.at(time_s)
        rows, columns = pixels_of(points, self.camera)
        mask = np.zeros((self.camera.height, self.camera.width), np.bool_)
        for down, right in self._square(points):
            inside = _inside(rows + down, columns + right, self.camera)
            mask[rows[inside] + down, columns[inside] + right] = True
        return mask

    def _square(self, points_m: Array) -> list[tuple[int, int]]:
        """Pixels around a point that cover the surface up to its neighbors, at the highest point of the hand."""
        above_m = max(float(self.camera.position_m[2] - points_m[:, 2].max()), 1e-3)
        reach = math.ceil(FARTHEST_M * max(self.camera.fx, self.camera.fy) / above_m)
        return [(down, right) for down in range(-reach, reach + 1) for right in range(-reach, reach + 1)]


def pixels_of(points_m: Array, camera: Camera) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Rows and columns (N,) of the pixels that points fall on; they may lie outside of the image."""
    uv, _ = camera.project(points_m)
    uv = np.where(np.isfinite(uv), np.clip(uv, -1e6, 1e6), -1e6)
    return np.floor(uv[:, 1]).astype(np.int64), np.floor(uv[:, 0]).astype(np.int64)


def _inside(rows: NDArray[np.int64], columns: NDArray[np.int64], camera: Camera) -> NDArray[np.bool_]:
    return (rows >= 0) & (rows < camera.height) & (columns >= 0) & (columns < camera.width)
