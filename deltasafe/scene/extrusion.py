"""From an image of probabilities to the workspace: extrusion along the camera's rays (section IV-A, decision 11)."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import compiled
from deltasafe.errors import SettingsError
from deltasafe.scene.camera import Camera
from deltasafe.scene.occupancy import OccupancyGrid

__all__ = ["FieldSettings", "grid_from_image"]


@dataclasses.dataclass(frozen=True)
class FieldSettings:
    """How the image becomes a field.

    Attributes:
        voxel_m: edge of a voxel; 2.5 mm is 4 to 5 pixels of a 640 x 480 camera half a metre above the table.
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
    seen = camera.pixel_to_plane(corners.astype(np.float64), table_z_m)[:, :2]
    origin_m = np.append(np.floor(seen.min(axis=0) / settings.voxel_m) * settings.voxel_m, table_z_m)
    columns = np.ceil((seen.max(axis=0) - origin_m[:2]) / settings.voxel_m).astype(int)
    lattice = [origin_m[i] + settings.voxel_m * np.arange(n + 1) for i, n in enumerate((*columns, layers))]
    points_m = np.stack(np.meshgrid(*lattice, indexing="ij"), axis=-1)
    uv, _ = camera.project(points_m.reshape(-1, 3))
    p_occupied = _largest_in_footprint(image, uv.reshape(*points_m.shape[:3], 2))
    return OccupancyGrid(p_occupied, origin_m, settings.voxel_m)


@compiled
def _largest_in_footprint(image, uv):  # type: ignore[no-untyped-def]
    """(nx, ny, nz) maxima of the image (H, W) over the boxes around the projected corners (nx+1, ny+1, nz+1, 2)."""
    nx, ny, nz = uv.shape[0] - 1, uv.shape[1] - 1, uv.shape[2] - 1
    height, width = image.shape
    largest = np.ones((nx, ny, nz), np.float32)
    for i in range(nx):
        for j in range(ny):
            for k in range(nz):
                u_low, u_high, v_low, v_high = np.inf, -np.inf, np.inf, -np.inf
                seen = True
                for corner in range(8):
                    u, v = uv[i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2)]
                    seen &= 0.0 <= u <= width and 0.0 <= v <= height
                    u_low, u_high = min(u_low, u), max(u_high, u)
                    v_low, v_high = min(v_low, v), max(v_high, v)
                if not seen:
                    continue
                value = np.float32(0.0)
                for row in range(int(v_low), min(int(v_high) + 1, height)):
                    for column in range(int(u_low), min(int(u_high) + 1, width)):
                        value = max(value, image[row, column])
                largest[i, j, k] = value
    return largest
