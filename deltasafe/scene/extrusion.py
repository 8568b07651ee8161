"""From an image of probabilities to the workspace: extrusion along the camera's rays (section IV-A, decision 11)."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, kernel
from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.scene.camera import Camera
from deltasafe.scene.occupancy import OccupancyGrid

__all__ = ["FieldSettings", "grid_from_image"]

LEVELS = 5
"""Maxima of squares of 1, 2, 4, 8 and 16 pixels an edge."""


@dataclasses.dataclass(frozen=True)
class FieldSettings:
    """How the image becomes a field.

    Attributes:
        voxel_m: edge of a voxel; 2.5 mm is 4 to 5 pixels of a 640 x 480 camera half a meter above the table.
        depth_margin_m: the field reaches this far above the hand, for errors of its height.
    """

    voxel_m: float = 0.0025
    depth_margin_m: float = 0.01

    def __post_init__(self) -> None:
        if not (math.isfinite(self.voxel_m) and 0.0005 <= self.voxel_m <= 0.05):
            raise SettingsError(f"voxel_m must be between 0.0005 and 0.05 m, got {self.voxel_m}")
        if not (math.isfinite(self.depth_margin_m) and self.depth_margin_m >= 0):
            raise SettingsError(f"depth_margin_m must not be negative, got {self.depth_margin_m}")


def grid_from_image(
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    table_z_m: float,
    hand_height_m: float,
    settings: FieldSettings | None = None,
) -> OccupancyGrid:
    """Extrude an image of P(occupied) from the table to the height of the hand plus the depth margin.

    A voxel takes the largest probability of the pixels that its projection touches (a box around the projected
    corners), and 1 if the camera does not see all of it. The grid spans what the camera sees of the table.

    Args:
        p_occupied_image: (H, W) of the camera's size, in [0, 1].
        camera: the camera that took the image.
        table_z_m: height of the table in the world frame.
        hand_height_m: height of the hand above the table.
        settings: resolution and margin.

    Raises:
        SettingsError: image and camera differ in size, a probability lies outside [0, 1], or the camera is not
            above the field with the whole image showing the table.
    """
    settings = settings or FieldSettings()
    image = np.ascontiguousarray(p_occupied_image, dtype=np.float32)
    if image.shape != (camera.height, camera.width):
        raise SettingsError(
            f"the image of p_occupied must have the camera's size {(camera.height, camera.width)}, "
            f"got {image.shape}; resize it first"
        )
    if not (image.min() >= 0 and image.max() <= 1):
        raise SettingsError("p_occupied must lie in [0, 1]; NaN is not a probability")
    if not (math.isfinite(hand_height_m) and hand_height_m > 0):
        raise SettingsError(f"hand_height_m must be positive, got {hand_height_m}")
    layers = math.ceil((hand_height_m + settings.depth_margin_m) / settings.voxel_m - 1e-9)
    if camera.position_m[2] <= table_z_m + layers * settings.voxel_m:
        raise SettingsError(f"the camera at z = {camera.position_m[2]} m must be above the hand and its margin")
    corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]])
    seen = as_rows(camera.pixel_to_plane(corners.astype(np.float64), table_z_m), 3, "what the camera sees")[:, :2]
    origin_m = np.append(np.floor(seen.min(axis=0) / settings.voxel_m) * settings.voxel_m, table_z_m)
    columns = np.ceil((seen.max(axis=0) - origin_m[:2]) / settings.voxel_m).astype(int)
    nx, ny = (int(count) for count in columns)
    seen_as = _pinhole(camera)
    p_occupied = _largest_in_footprints(_largest_in_squares(image), seen_as, origin_m, settings.voxel_m, nx, ny, layers)
    return OccupancyGrid(p_occupied, origin_m, settings.voxel_m)


def _pinhole(camera: Camera) -> NDArray[np.float64]:
    """(3, 4): world point (x, y, z, 1) to (u w, v w, w) with the depth w."""
    intrinsic = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    world_to_camera = camera.world_from_camera_rotation.T
    return np.ascontiguousarray(
        intrinsic @ np.column_stack([world_to_camera, -world_to_camera @ camera.position_m]), dtype=np.float64
    )


@compiled
def _largest_in_squares(image):  # type: ignore[no-untyped-def]
    """(LEVELS, H, W): largest of 2^level pixels an edge, from each one right and down (fewer at the image's end)."""
    height, width = image.shape
    maxima = np.empty((LEVELS, height, width), np.float32)
    maxima[0] = image
    for level in range(1, LEVELS):
        half = 1 << (level - 1)
        for row in range(height):
            upper, lower = maxima[level - 1, row], maxima[level - 1, min(row + half, height - 1)]
            found = maxima[level, row]
            for column in range(width):
                found[column] = max(upper[column], lower[column])
            for column in range(width - half):  # nothing is read that has been written
                found[column] = max(found[column], found[column + half])
    return maxima


@compiled
def _project_plane(seen_as, x, origin_m, voxel_m, uv):  # type: ignore[no-untyped-def]
    """Pixel coordinates (ny+1, nz+1, 2) of the lattice points of one plane; behind the camera far outside."""
    for j in range(uv.shape[0]):
        y = origin_m[1] + voxel_m * j
        for k in range(uv.shape[1]):
            z = origin_m[2] + voxel_m * k
            depth = seen_as[2, 0] * x + seen_as[2, 1] * y + seen_as[2, 2] * z + seen_as[2, 3]
            if depth > 0.0:
                uv[j, k, 0] = (seen_as[0, 0] * x + seen_as[0, 1] * y + seen_as[0, 2] * z + seen_as[0, 3]) / depth
                uv[j, k, 1] = (seen_as[1, 0] * x + seen_as[1, 1] * y + seen_as[1, 2] * z + seen_as[1, 3]) / depth
            else:
                uv[j, k] = -1e9


@compiled
def _largest_in_footprints(maxima, seen_as, origin_m, voxel_m, nx, ny, nz):  # type: ignore[no-untyped-def]
    """(nx, ny, nz) maxima of the image over the boxes around the projected corners of each voxel; 1 if not all seen."""
    height, width = maxima.shape[1:]
    largest = np.ones((nx, ny, nz), np.float32)
    near, far = np.empty((ny + 1, nz + 1, 2)), np.empty((ny + 1, nz + 1, 2))
    _project_plane(seen_as, origin_m[0], origin_m, voxel_m, far)
    for i in range(nx):
        near, far = far, near
        _project_plane(seen_as, origin_m[0] + voxel_m * (i + 1), origin_m, voxel_m, far)
        for j in range(ny):
            level = 0
            above = _box(near, far, j, 0)
            for k in range(nz):
                below, above = above, _box(near, far, j, k + 1)
                u_low, u_high = min(below[0], above[0]), max(below[1], above[1])
                v_low, v_high = min(below[2], above[2]), max(below[3], above[3])
                if u_low < 0.0 or v_low < 0.0 or u_high > width or v_high > height:
                    continue
                first, last = int(u_low), min(int(u_high), width - 1)
                top, bottom = int(v_low), min(int(v_high), height - 1)
                extent = min(last - first, bottom - top) + 1
                while level > 0 and 1 << level > extent:
                    level -= 1
                while level < LEVELS - 1 and 2 << level <= extent:
                    level += 1
                largest[i, j, k] = _largest_in_box(maxima[level], 1 << level, top, bottom, first, last)
    return largest


@kernel
def _box(near, far, j, k):  # type: ignore[no-untyped-def]
    """Box around the lattice points of a voxel's lower face: least and largest u, least and largest v."""
    a, b, c, d = near[j, k, 0], near[j + 1, k, 0], far[j, k, 0], far[j + 1, k, 0]
    e, f, g, h = near[j, k, 1], near[j + 1, k, 1], far[j, k, 1], far[j + 1, k, 1]
    return min(a, b, c, d), max(a, b, c, d), min(e, f, g, h), max(e, f, g, h)


@kernel
def _largest_in_box(squares, step, top, bottom, first, last):  # type: ignore[no-untyped-def]
    """Largest of the pixels in a box that holds a square of ``step`` an edge; squares that overlap cover it."""
    last_row, last_column = bottom - step + 1, last - step + 1
    value, row = np.float32(0.0), top
    while True:
        column = first
        while column < last_column:
            value = max(value, squares[row, column])
            column += step
        value = max(value, squares[row, last_column])
        if row == last_row:
            return value
        row = min(row + step, last_row)
