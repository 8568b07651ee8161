"""Pose of a camera from one image of a board that lies on the table."""

import dataclasses
import math
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from deltasafe.cameras.board import Board
from deltasafe.cameras.model import HALF_PIXEL, CameraModel
from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose

Array = NDArray[np.float64]

MIN_CORNERS = 8
MAX_ERROR = 1e-3
"""Largest root mean square of the reprojection error, as a fraction of the image's longer side: 0.64 px of 640."""
MAX_TABLE_STD_M, TABLE_RADIUS_M = 0.003, 0.3
"""Largest standard deviation of where the ray of a pixel meets the table, up to this far from the board's middle."""
CORNER_STD_PX = 0.05
"""Of a detected corner at least, where few corners happen to fit better."""
OTHER_POSE_RAD, OTHER_POSE_ERROR = math.radians(1.0), 1.5
"""A second pose is another one beyond this angle, and possible if its error is at most this multiple."""


@dataclasses.dataclass(frozen=True)
class LocatedCamera:
    """A camera with its pose, and how well the board determines it.

    Attributes:
        model: the camera with its pose in the world frame, for images of the size of the given one.
        corners_m: (N, 3) detected corners in the world frame.
        corners_uv: (N, 2) their pixel coordinates in the image.
        error_px: root mean square of the reprojection error.
        position_std_m: standard deviation of the position, from the residuals.
        rotation_std_rad: standard deviation of the rotation angle.
        table_std_m: largest standard deviation of where the ray of a pixel meets the plane of the board, up to
            ``TABLE_RADIUS_M`` from the board's middle. Errors of position and rotation partly cancel there.
    """

    model: CameraModel
    corners_m: Array
    corners_uv: Array
    error_px: float
    position_std_m: float
    rotation_std_rad: float
    table_std_m: float


def locate_camera(
    image: NDArray[np.uint8], model: CameraModel, board: Board, origin: Pose | None = None
) -> LocatedCamera:
    """Determine the pose of a camera from an image of a board.

    Args:
        image: (H, W, 3) in RGB, as the camera takes it: with its distortion.
        model: intrinsics; an earlier pose is ignored.
        board: the board.
        origin: where the board's origin (its lower left corner) lies in the world frame, and how its x axis is turned;
            the world's origin by default.

    Raises:
        SettingsError: the image has another aspect ratio than the calibration, too few corners are visible, the
            reprojection error is above ``MAX_ERROR``, or the pose is ambiguous or uncertain.
    """
    height, width = image.shape[:2]
    model = model.resized(width, height)
    corners_m, corners_uv, n_markers = _detect(image, board)
    if len(corners_uv) < MIN_CORNERS:
        raise SettingsError(
            f"shows {len(corners_uv)} corners of the board, {MIN_CORNERS} are needed, and {n_markers} markers of its "
            "dictionary; check the board's description, and show all of it, flat, sharp, evenly lit and larger"
        )
    fits = sorted(
        (_refined(model, corners_m, corners_uv, *start) for start in _starts(model, corners_m, corners_uv)),
        key=lambda fit: fit.error_px,
    )
    best = fits[0]
    _require_certain(best, fits[1:], MAX_ERROR * max(width, height))
    return _in_world(best, origin or Pose(0.0, 0.0, 0.0, 0.0))


def _detect(image: NDArray[np.uint8], board: Board) -> tuple[Array, Array, int]:
    """Detected corners in the board's frame (N, 3) and in the image (N, 2), and the number of markers of any board."""
    gray = cv2.cvtColor(image, cv2.COLOR_RGB2GRAY)
    parameters: Any = cv2.aruco.DetectorParameters()
    found: Any
    ids: Any
    if board.kind == "charuco":
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
        patterns = [board.opencv, board.legacy] if board.rows % 2 == 0 else [board.opencv]
        for pattern in patterns:  # with an odd number of rows they are equal
            found, ids, _, markers = cv2.aruco.CharucoDetector(pattern, detectorParams=parameters).detectBoard(gray)
            if ids is not None and len(ids) >= MIN_CORNERS:
                break
        places = np.asarray(board.opencv.getChessboardCorners())
        shift = HALF_PIXEL
    else:  # 0.1 px instead of the 0.5 px of the other methods; it puts the center of the first pixel at (0.5, 0.5)
        parameters.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_APRILTAG
        found, ids, _ = cv2.aruco.ArucoDetector(board.opencv.getDictionary(), parameters).detectMarkers(gray)
        places, markers, shift = np.asarray(board.opencv.getObjPoints()), ids, 0.0
    n_markers = 0 if markers is None else len(markers)
    numbers = np.empty(0, int) if ids is None else np.asarray(ids).ravel()
    known = numbers < len(places)  # another board may lie beside this one
    if not known.any():
        return np.empty((0, 3)), np.empty((0, 2)), n_markers
    corners_uv = np.asarray(found, np.float64)[known].reshape(-1, 2) + shift
    return board.from_opencv(places[numbers[known]]), corners_uv, n_markers


def _starts(model: CameraModel, corners_m: Array, corners_uv: Array) -> list[tuple[Rotation, Array]]:
    """The two poses in the board's frame that a plane allows, from corners without distortion."""
    undo = cv2.fisheye.undistortPoints if model.distortion_model == "equidistant" else cv2.undistortPoints
    rays = undo((corners_uv - HALF_PIXEL)[:, None], model.matrix, model.coefficients)
    _, turns, shifts, _ = cv2.solvePnPGeneric(corners_m, rays, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    found = []
    for turn, shift in zip(turns, shifts, strict=True):
        from_camera = Rotation.from_rotvec(turn.ravel()).inv()
        found.append((from_camera, -from_camera.apply(shift.ravel())))
    return found


def _refined(
    model: CameraModel, corners_m: Array, corners_uv: Array, start: Rotation, position_m: Array
) -> LocatedCamera:
    """Minimize the reprojection error in the image's pixels over the rotation and position of the camera."""

    def residuals(pose: Array) -> Array:
        turn = start * Rotation.from_rotvec(pose[:3])
        uv = model.pixels(turn.inv().apply(corners_m - pose[3:]))
        return np.asarray(np.nan_to_num(uv - corners_uv, nan=1e6).ravel())

    fit = least_squares(residuals, np.append(np.zeros(3), position_m), x_scale="jac", method="lm")
    squares = 2 * fit.cost
    std_px = max(math.sqrt(squares / (2 * len(corners_m) - 6)), CORNER_STD_PX)
    covariance = np.linalg.pinv(fit.jac.T @ fit.jac) * std_px**2
    return LocatedCamera(
        model=model.placed(fit.x[3:], (start * Rotation.from_rotvec(fit.x[:3])).as_matrix()),
        corners_m=corners_m,
        corners_uv=corners_uv,
        error_px=math.sqrt(squares / len(corners_m)),
        position_std_m=math.sqrt(np.trace(covariance[3:, 3:])),
        rotation_std_rad=math.sqrt(np.trace(covariance[:3, :3])),
        table_std_m=_table_std_m(start * Rotation.from_rotvec(fit.x[:3]), fit.x[3:], corners_m, covariance),
    )


def _table_std_m(turn: Rotation, position_m: Array, corners_m: Array, covariance: Array) -> float:
    """Propagate the covariance of rotation (in the camera's frame) and position to points of the board's plane."""
    angles = np.linspace(0, 2 * math.pi, 8, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]) * TABLE_RADIUS_M + corners_m.mean(axis=0)
    rays = ring - position_m
    local = turn.inv().apply(rays)
    turned = [turn.apply(np.cross(axis, local)) for axis in np.eye(3)]
    shifted = [np.tile(axis, (len(rays), 1)) for axis in np.eye(3)]
    changes = np.stack([*turned, *shifted], axis=-1)
    on_plane = changes[:, :2] - (rays[:, :2] / rays[:, 2:])[..., None] * changes[:, 2:]
    variances = np.einsum("nip,pq,niq->n", on_plane, covariance, on_plane)
    return math.sqrt(variances.max())


def _require_certain(best: LocatedCamera, others: list[LocatedCamera], limit_px: float) -> None:
    if not best.error_px <= limit_px:
        raise SettingsError(
            f"the board's corners are {best.error_px:.2f} px off (limit {limit_px:.2f} px); check its description, "
            "that the board is flat, and that the calibration is of this camera and focus"
        )
    for other in others:
        one, another = (fit.model.pinhole().world_from_camera_rotation for fit in (best, other))
        angle_rad = Rotation.from_matrix(one.T @ another).magnitude()
        if angle_rad > OTHER_POSE_RAD and other.error_px <= OTHER_POSE_ERROR * best.error_px:
            raise SettingsError(
                f"the board fits two poses that are {math.degrees(angle_rad):.1f} degrees apart; move the camera "
                "nearer, or print a larger board"
            )
    if not best.table_std_m <= MAX_TABLE_STD_M:
        raise SettingsError(
            f"{TABLE_RADIUS_M:g} m from the board, the table is known within {1000 * best.table_std_m:.1f} mm only "
            f"(limit {1000 * MAX_TABLE_STD_M:g} mm); move the camera nearer, or print a larger board"
        )


def _in_world(fit: LocatedCamera, origin: Pose) -> LocatedCamera:
    turn = Rotation.from_euler("z", origin.yaw_rad).as_matrix()
    shift, camera = np.array([origin.x_m, origin.y_m, origin.z_m]), fit.model.pinhole()
    model = fit.model.placed(turn @ camera.position_m + shift, turn @ camera.world_from_camera_rotation)
    return dataclasses.replace(fit, model=model, corners_m=fit.corners_m @ turn.T + shift)
