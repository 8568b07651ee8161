"""Extrusion of a probability image along the camera's rays to an occupancy grid (section IV-A, decision 11)."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled, kernel
from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose, as_rows
from deltasafe.scene.camera import Camera
from deltasafe.scene.occupancy import OccupancyGrid, require_size
from deltasafe.setting_ranges import check_range

Array = NDArray[np.float64]

MAX_PIXELS = 16_000_000
"""Larger images are reduced by block maxima before the pyramid, which needs 20 bytes a pixel."""

LEVELS = 5
"""Maximum pyramid: squares with edges of 1, 2, 4, 8 and 16 pixels."""


@dataclasses.dataclass(frozen=True)
class FieldSettings:
    """Settings of the occupancy grid of an image.

    Attributes:
        voxel_m: edge of a voxel; 2.5 mm are 4 to 5 pixels of a 640 x 480 camera half a meter above the table.
        depth_margin_m: the grid reaches this far above the hand, to allow for errors of the hand's height.
        reach_m: the grid reaches at most this far beyond start and goal, horizontally. The default is the reach of an
            arm that stands beside them; what lies farther away counts as not seen.
    """

    voxel_m: float = 0.0025
    depth_margin_m: float = 0.01
    reach_m: float = 0.5

    def __post_init__(self) -> None:
        check_range(self, "[0.0005, 0.05]", "voxel_m")
        check_range(self, "[0, inf)", "depth_margin_m")
        check_range(self, "[0.05, 10]", "reach_m")


def useful_area(start: Pose, goal: Pose, reach_m: float = FieldSettings.reach_m) -> tuple[Array, Array]:
    """Return the corners (2,) of the horizontal rectangle within ``reach_m`` of start and goal."""
    ends = np.array([(pose.x_m, pose.y_m) for pose in (start, goal)])
    return ends.min(axis=0) - reach_m, ends.max(axis=0) + reach_m


def grid_from_image(
    p_occupied_image: NDArray[np.float32],
    camera: Camera,
    table_z_m: float,
    hand_height_m: float,
    settings: FieldSettings | None = None,
    task: tuple[Pose, Pose] | None = None,
) -> OccupancyGrid:
    """Extrude an image of P(occupied) from the table to the height of the hand plus the depth margin.

    A voxel gets the largest value of the pixels in the bounding box of its projected corners, or 1 if the box exceeds
    the image. The grid covers the part of the table that the camera sees, near the task. An oblique camera, which may
    see the horizon, needs a task.

    Args:
        p_occupied_image: (H, W) of the camera's size, in [0, 1].
        camera: the camera that took the image.
        table_z_m: height of the table in the world frame.
        hand_height_m: height of the hand above the table.
        settings: resolution, margin and reach.
        task: start and goal; None: the grid covers all that the image shows of the table.

    Raises:
        SettingsError: image and camera differ in size, a value is outside [0, 1], the camera is not above the grid, the
            camera does not see the table near the task, a part of the image does not show the table (without a task),
            or the grid would have too many voxels.
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
    seen = _seen_of_table(camera, table_z_m, settings, task)
    origin_m = np.append(np.floor(seen.min(axis=0) / settings.voxel_m) * settings.voxel_m, table_z_m)
    columns = np.ceil((seen.max(axis=0) - origin_m[:2]) / settings.voxel_m).astype(int)
    shape = int(columns[0]), int(columns[1]), layers
    require_size(shape, settings.voxel_m)
    image, block = _block_maxima(image)
    projection = _projection_matrix(camera) / np.array([[block], [block], [1.0]])
    p_occupied = _voxel_maxima(_maximum_pyramid(image), projection, origin_m, settings.voxel_m, shape)
    unseen = p_occupied > 1.0
    p_occupied[unseen] = 1.0
    return OccupancyGrid(p_occupied, origin_m, settings.voxel_m, unseen)


def _seen_of_table(camera: Camera, table_z_m: float, settings: FieldSettings, task: tuple[Pose, Pose] | None) -> Array:
    """Corners (N, 2) of the part of the table that the grid covers."""
    if task is None:
        corners = np.array([[0, 0], [camera.width, 0], [0, camera.height], [camera.width, camera.height]])
        seen_m = camera.pixel_to_plane(corners.astype(np.float64), table_z_m)
        return as_rows(seen_m, 3, "what the camera sees; give the task, which bounds it,")[:, :2]
    seen = camera.view_on_plane(table_z_m, *useful_area(*task, settings.reach_m))
    if not len(seen):
        raise SettingsError(
            f"the camera sees no part of the table within {settings.reach_m:g} m of start and goal; check its position "
            "(meters) and rotation, and the height of the table"
        )
    return seen


def _block_maxima(image: NDArray[np.float32]) -> tuple[NDArray[np.float32], int]:
    """Reduce an image to at most ``MAX_PIXELS``; return it and the edge of a block.

    Rows and columns that fill no block are cut off: what they show counts as not seen.
    """
    block = math.ceil(math.sqrt(image.size / MAX_PIXELS))
    if block <= 1:
        return image, 1
    height, width = image.shape[0] // block, image.shape[1] // block
    blocks = image[: height * block, : width * block].reshape(height, block, width, block)
    return np.ascontiguousarray(blocks.max(axis=(1, 3))), block


def _projection_matrix(camera: Camera) -> NDArray[np.float64]:
    """(3, 4) matrix that maps a world point (x, y, z, 1) to (u w, v w, w), where w is the depth."""
    intrinsic = np.array([[camera.fx, 0.0, camera.cx], [0.0, camera.fy, camera.cy], [0.0, 0.0, 1.0]])
    world_to_camera = camera.world_from_camera_rotation.T
    return np.ascontiguousarray(
        intrinsic @ np.column_stack([world_to_camera, -world_to_camera @ camera.position_m]), dtype=np.float64
    )


@compiled
def _maximum_pyramid(image):  # type: ignore[no-untyped-def]
    """(LEVELS, H, W) maxima of squares of 2^level pixels right of and below each pixel, cut off at the border."""
    height, width = image.shape
    maxima = np.empty((LEVELS, height, width), np.float32)
    maxima[0] = image
    for level in range(1, LEVELS):
        half = 1 << (level - 1)
        for row in range(height):
            upper, lower = maxima[level - 1, row], maxima[level - 1, min(row + half, height - 1)]
            row_maxima = maxima[level, row]
            for column in range(width):
                row_maxima[column] = max(upper[column], lower[column])
            for column in range(width - half):  # reads ahead of what it writes
                row_maxima[column] = max(row_maxima[column], row_maxima[column + half])
    return maxima


@compiled
def _project_plane(projection, x, origin_m, voxel_m, uv):  # type: ignore[no-untyped-def]
    """Write the pixel coordinates (ny + 1, nz + 1, 2) of the voxel corners in one plane; far outside if behind it."""
    for j in range(uv.shape[0]):
        y = origin_m[1] + voxel_m * j
        for k in range(uv.shape[1]):
            z = origin_m[2] + voxel_m * k
            depth = _dot(projection[2], x, y, z)
            if depth > 0.0:
                uv[j, k, 0] = _dot(projection[0], x, y, z) / depth
                uv[j, k, 1] = _dot(projection[1], x, y, z) / depth
            else:
                uv[j, k] = -1e9


@kernel
def _dot(row, x, y, z):  # type: ignore[no-untyped-def]
    return row[0] * x + row[1] * y + row[2] * z + row[3]


@compiled
def _voxel_maxima(pyramid, projection, origin_m, voxel_m, shape):  # type: ignore[no-untyped-def]
    """Maxima (nx, ny, nz) of the image over the projected voxels; 2 for voxels that are not seen completely."""
    nx, ny, nz = shape
    height, width = pyramid.shape[1:]
    maxima = np.full(shape, np.float32(2.0))
    near, far = np.empty((ny + 1, nz + 1, 2)), np.empty((ny + 1, nz + 1, 2))
    _project_plane(projection, origin_m[0], origin_m, voxel_m, far)
    for i in range(nx):
        near, far = far, near
        _project_plane(projection, origin_m[0] + voxel_m * (i + 1), origin_m, voxel_m, far)
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
                maxima[i, j, k] = _maximum_in_box(pyramid[level], 1 << level, top, bottom, first, last)
    return maxima


@kernel
def _box(near, far, j, k):  # type: ignore[no-untyped-def]
    """Bounding box of the four projected corners of a voxel's lower face: least and largest u, least and largest v."""
    a, b, c, d = near[j, k, 0], near[j + 1, k, 0], far[j, k, 0], far[j + 1, k, 0]
    e, f, g, h = near[j, k, 1], near[j + 1, k, 1], far[j, k, 1], far[j + 1, k, 1]
    return min(a, b, c, d), max(a, b, c, d), min(e, f, g, h), max(e, f, g, h)


@kernel
def _maximum_in_box(squares, step, top, bottom, first, last):  # type: ignore[no-untyped-def]
    """Maximum of the pixels in a box, from maxima of overlapping squares with an edge of ``step`` pixels."""
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
