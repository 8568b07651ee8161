"""Images of a board on a table as a real lens would take them, rendered by OpenCV alone from a known pose.

Nothing of `deltasafe.cameras.model` is used: the images test its conventions.
"""

import dataclasses

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.cameras.board import Board

Array = NDArray[np.float64]

PX_PER_M = 8000
QUIET_M = 0.02
"""White paper around the pattern."""
TABLE_GRAY = 120
SAMPLES = 2
"""Per pixel and direction."""


@dataclasses.dataclass(frozen=True)
class Lens:
    """A lens by OpenCV's convention: pixel centers at whole numbers.

    Attributes:
        size: width and height in pixels.
        matrix: (3, 3) camera matrix.
        distortion: OpenCV's coefficients.
        is_fisheye: of the model of ``cv2.fisheye``.
    """

    size: tuple[int, int]
    matrix: Array
    distortion: Array
    is_fisheye: bool = False


@dataclasses.dataclass(frozen=True)
class View:
    """Pose of a camera in the world frame: columns of the rotation are its x (right), y (down), z (forward) axes."""

    position_m: Array
    rotation: Array


def look_at(target_m: Array, distance_m: float, tilt_rad: float, azimuth_rad: float, roll_rad: float) -> View:
    """Place a camera at a distance from a point, tilted against the vertical."""
    turn = Rotation.from_euler("z", azimuth_rad) * Rotation.from_euler("y", tilt_rad)
    position_m = target_m + turn.apply((0.0, 0.0, distance_m))
    rotation = (turn * Rotation.from_euler("z", roll_rad)).as_matrix() @ np.diag([1.0, -1.0, -1.0])
    return View(position_m, rotation)


def render_board(
    board: Board, lens: Lens, view: View, board_pose: tuple[float, float, float, float], rng: np.random.Generator
) -> NDArray[np.uint8]:
    """Render (H, W, 3) uint8: the printed board on a gray table, with blur, uneven light and noise.

    Args:
        board_pose: x, y, z in meters and yaw in radians of the board's lower left corner in the world.
    """
    left, top, width, height = _window(board, lens, view, board_pose)
    samples = [(np.arange(SAMPLES * n) + 0.5) / SAMPLES - 0.5 + first for n, first in ((width, left), (height, top))]
    points = np.stack(np.meshgrid(*samples), axis=-1).reshape(-1, 1, 2)
    undo = cv2.fisheye.undistortPoints if lens.is_fisheye else _undistort
    slopes = undo(points, lens.matrix, lens.distortion).reshape(-1, 2)
    rays = np.column_stack([slopes, np.ones(len(slopes))]) @ view.rotation.T
    depth = (board_pose[2] - view.position_m[2]) / rays[:, 2]
    on_table = (view.position_m + rays * depth[:, None])[:, :2] - board_pose[:2]
    cos, sin = np.cos(board_pose[3]), np.sin(board_pose[3])
    right, down = on_table @ [cos, sin], board.extent_m[1] - on_table @ [-sin, cos]
    u, v = (
        ((axis + QUIET_M) * PX_PER_M - 0.5).astype(np.float32).reshape(-1, SAMPLES * width) for axis in (right, down)
    )
    seen = cv2.remap(_paper(board), u, v, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=TABLE_GRAY)
    image = np.full(lens.size[::-1], TABLE_GRAY, np.float32)
    image[top : top + height, left : left + width] = cv2.resize(
        seen.astype(np.float32), (width, height), interpolation=cv2.INTER_AREA
    )
    return _exposed(image, rng)


def _window(board: Board, lens: Lens, view: View, board_pose: tuple[float, float, float, float]) -> tuple[int, ...]:
    """Left, top, width and height of the part of the image that shows the paper."""
    x, y = np.meshgrid(*[np.linspace(-QUIET_M, length + QUIET_M, 50) for length in board.extent_m])
    cos, sin = np.cos(board_pose[3]), np.sin(board_pose[3])
    paper = np.stack([cos * x - sin * y, sin * x + cos * y, 0 * x], axis=-1).reshape(-1, 3) + board_pose[:3]
    to_camera = view.rotation.T
    project = cv2.fisheye.projectPoints if lens.is_fisheye else cv2.projectPoints
    turn, shift = cv2.Rodrigues(to_camera)[0], -to_camera @ view.position_m
    uv = project(paper[:, None], turn, shift, lens.matrix, lens.distortion)[0].reshape(-1, 2)
    low = np.clip(np.floor(uv.min(axis=0)).astype(int) - 2, 0, np.array(lens.size) - 1)
    high = np.clip(np.ceil(uv.max(axis=0)).astype(int) + 2, low + 1, lens.size)
    return tuple(int(value) for value in (*low, *(high - low)))


def _exposed(image: NDArray[np.float32], rng: np.random.Generator) -> NDArray[np.uint8]:
    """Add blur, uneven light and noise, and make three equal channels."""
    height, width = image.shape
    left, right, top, bottom = rng.uniform((0.6, 0.6, 0.8, 0.8), 1.0)
    light = np.linspace(left, right, width) * np.linspace(top, bottom, height)[:, None]
    blurred = cv2.GaussianBlur(image, (0, 0), rng.uniform(0.5, 0.9))
    gray = np.clip(blurred * light + rng.normal(15, 4, image.shape), 0, 255).astype(np.uint8)
    return np.repeat(gray[..., None], 3, axis=2)


def _undistort(points: Array, matrix: Array, distortion: Array) -> Array:
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-9)
    return np.asarray(cv2.undistortPoints(points, matrix, distortion, criteria=criteria))


def _paper(board: Board) -> NDArray[np.uint8]:
    pixels = [round(length * PX_PER_M) for length in board.extent_m]
    pattern = board.opencv.generateImage(pixels, marginSize=0)
    quiet = round(QUIET_M * PX_PER_M)
    return np.asarray(cv2.copyMakeBorder(pattern, quiet, quiet, quiet, quiet, cv2.BORDER_CONSTANT, value=255), np.uint8)
