"""The commands `deltasafe camera board` and `deltasafe camera locate`."""

import argparse
import dataclasses
import math
import pathlib
from typing import Any

from deltasafe.errors import DataError, SettingsError

BOARD_HELP = (
    "charuco:COLUMNSxROWS:SQUARE:MARKER[:DICTIONARY] or apriltag:COLUMNSxROWS:TAG:GAP[:DICTIONARY], lengths in meters; "
    "for example charuco:7x5:0.030:0.022"
)


def add_camera_commands(commands: Any) -> None:
    """Add the parsers of ``camera`` to those of ``deltasafe``."""
    camera = commands.add_parser("camera", help="make a board to print, and locate a camera with it")
    actions = camera.add_subparsers(required=True, metavar="ACTION")
    path = pathlib.Path

    board = actions.add_parser("board", help="write a board of markers to print at 100 %%")
    board.set_defaults(run=_board)
    board.add_argument("--board", default="charuco:7x5:0.030:0.022", help=f"{BOARD_HELP} (the default)")
    board.add_argument("-o", "--output", type=path, required=True, metavar="FILE", help="page to write (.pdf or .png)")

    locate = actions.add_parser("locate", help="find the pose of a camera from an image of a board on the table")
    locate.set_defaults(run=_locate)
    locate.add_argument("image", type=path, help="image as the camera takes it, with its distortion")
    locate.add_argument("--camera", type=path, required=True, metavar="CALIBRATION", help="file of OpenCV or ROS")
    locate.add_argument("--board", required=True, help=BOARD_HELP)
    locate.add_argument(
        "--board-origin",
        type=float,
        nargs=4,
        default=(0.0, 0.0, 0.0, 0.0),
        metavar=("X", "Y", "Z", "YAW"),
        help="where the board's lower left corner lies in the world, in meters, and the direction of its x axis, in "
        "degrees (default: it is the world's origin)",
    )
    add_image_kind(locate)
    locate.add_argument(
        "-o",
        "--output",
        type=path,
        required=True,
        metavar="FILE",
        help="camera file to write (.json), beside a picture",
    )


def add_image_kind(parser: argparse.ArgumentParser) -> None:
    """Add the option that says which of the two images of a ROS camera is given."""
    parser.add_argument(
        "--image-kind",
        choices=("raw", "rectified"),
        help="raw: as the camera takes it; rectified: undistorted by ROS; needed where both differ in the calibration",
    )


def _board(options: argparse.Namespace) -> None:
    from deltasafe.cameras.board import Board, draw_board

    paper = draw_board(Board.parse(options.board), options.output)
    print(f"{options.output}: print on {paper} at 100 % and measure the ruler; the board is {options.board}")


def _locate(options: argparse.Namespace) -> None:
    import cv2

    from deltasafe.cameras.board import Board
    from deltasafe.cameras.calibration_files import read_camera, write_camera
    from deltasafe.cameras.locate import MAX_ERROR, TABLE_RADIUS_M, locate_camera
    from deltasafe.cameras.located_picture import draw_located
    from deltasafe.geometry import Pose
    from deltasafe.io.images import read_rgb
    from deltasafe.io.storage import atomic_file

    output, picture = options.output, options.output.with_suffix(".jpg")
    if output.suffix.lower() != ".json":
        raise DataError(output, "must end in .json; give another name")
    for given in (options.image, options.camera):
        if given.exists() and any(one.exists() and one.samefile(given) for one in (output, picture)):
            raise DataError(given, "would be overwritten; give another output")
    board, (x_m, y_m, z_m, yaw_degrees) = Board.parse(options.board), options.board_origin
    origin = Pose(x_m, y_m, z_m, math.radians(yaw_degrees))
    model, rgb = read_camera(options.camera, options.image_kind), read_rgb(options.image)
    try:
        located = locate_camera(rgb, model, board, origin)
    except SettingsError as error:
        raise DataError(options.image, str(error)) from error
    with atomic_file(picture) as temporary:
        temporary.write_bytes(cv2.imencode(".jpg", draw_located(rgb, located, board, origin)[..., ::-1])[1].tobytes())
    facts = {"board": options.board, "board_origin": dataclasses.asdict(origin), "n_corners": len(located.corners_uv)}
    for name in ("error_px", "position_std_m", "rotation_std_rad", "table_std_m"):
        facts[name] = getattr(located, name)
    write_camera(output, located.model, **facts)
    position = ", ".join(f"{value:.4f}" for value in located.model.pinhole().position_m)
    print(f"{output}: camera at ({position}) m, from {len(located.corners_uv)} corners")
    limit_px = MAX_ERROR * max(rgb.shape[:2])
    print(f"reprojection error {located.error_px:.2f} px (limit {limit_px:.2f} px)")
    print(f"standard deviation of the table, {TABLE_RADIUS_M:g} m from the board: {1000 * located.table_std_m:.1f} mm")
    print(f"{picture}: the board's axes over the image; check that they lie on the board")
