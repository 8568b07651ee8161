"""Picture of a located camera: the board's axes, its outline and its corners over the image."""

import itertools

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.cameras.board import Board
from deltasafe.cameras.locate import LocatedCamera
from deltasafe.geometry import Pose

Array = NDArray[np.float64]

AXES = {"x": (214, 39, 40), "y": (44, 160, 44), "z": (31, 119, 180)}
OUTLINE, DETECTED = (255, 127, 14), (227, 119, 194)
FRACTION_BITS = 4
"""OpenCV draws at fractions of a pixel, as integers with these bits."""


def draw_located(image: NDArray[np.uint8], located: LocatedCamera, board: Board, origin: Pose) -> NDArray[np.uint8]:
    """Draw over an image (H, W, 3) in RGB; return a copy.

    The lines are projected with the pose that was found, and the circles are the corners that were detected.
    """
    picture = image.copy()
    unit_px = max(picture.shape[:2]) / 640
    width_m, height_m = board.extent_m
    turn, shift = Rotation.from_euler("z", origin.yaw_rad), np.array([origin.x_m, origin.y_m, origin.z_m])

    def line(points_m: Array, color: tuple[int, int, int], thickness: float) -> Array:
        uv = located.model.project(turn.apply(points_m) + shift)
        uv = uv[np.isfinite(uv).all(axis=1)]
        fixed = np.round((uv - 0.5) * 2**FRACTION_BITS).astype(np.int32)
        cv2.polylines(picture, [fixed], False, color, max(round(thickness * unit_px), 1), cv2.LINE_AA, FRACTION_BITS)
        return uv

    outline = np.array([(0, 0, 0), (width_m, 0, 0), (width_m, height_m, 0), (0, height_m, 0), (0, 0, 0)])
    for first, last in itertools.pairwise(outline):
        line(np.linspace(first, last, 20), OUTLINE, 1.2)
    for u, v in located.corners_uv - 0.5:
        center = round(u * 2**FRACTION_BITS), round(v * 2**FRACTION_BITS)
        radius = round(3 * unit_px * 2**FRACTION_BITS)
        cv2.circle(picture, center, radius, DETECTED, max(round(unit_px), 1), cv2.LINE_AA, FRACTION_BITS)
    length_m = min(width_m, height_m) / 2
    for (name, color), axis in zip(AXES.items(), np.eye(3), strict=True):
        uv = line(np.linspace((0, 0, 0), axis * length_m, 20), color, 3)
        if len(uv) == 20 and np.abs(uv).max() < 1e5:
            beyond = uv[-1] + 14 * unit_px * (uv[-1] - uv[-2]) / max(float(np.linalg.norm(uv[-1] - uv[-2])), 1e-9)
            place = round(beyond[0] - 6 * unit_px), round(beyond[1] + 5 * unit_px)
            width = max(round(2 * unit_px), 1)
            cv2.putText(picture, name, place, cv2.FONT_HERSHEY_SIMPLEX, 0.6 * unit_px, color, width, cv2.LINE_AA)
    return picture
