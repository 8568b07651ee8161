"""Measure how well `deltasafe camera locate` finds cameras: boards rendered through distorted lenses, random poses.

Each trial draws a lens, a pose of the camera 0.35 to 0.8 m from the board and tilted up to 50 degrees, and a pose of
the board in the world. Trials whose image is refused are counted apart. Errors are those of the camera's position and
rotation, and of where pixels meet the table 0.3 m from the board.
"""

import dataclasses
import math
import sys

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.cameras.board import Board
from deltasafe.cameras.locate import TABLE_RADIUS_M, LocatedCamera, locate_camera
from deltasafe.cameras.model import HALF_PIXEL, CameraModel
from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose
from evidence.board_images import Lens, View, look_at, render_board
from evidence.reporting import command_parser, finish, print_progress

Array = NDArray[np.float64]

HD, VGA = (1280, 720), (640, 480)
BOARDS = ("charuco:7x5:0.030:0.022", "apriltag:4x3:0.040:0.010")


def _matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


LENSES = {
    "pinhole": (Lens(VGA, _matrix(600, 601, 322, 236), np.zeros(5)), "plumb_bob"),
    "plumb_bob": (
        Lens(HD, _matrix(900, 897, 647.3, 352.8), np.array([-0.3, 0.1, 0.001, -0.0007, -0.02])),
        "plumb_bob",
    ),
    "rational_polynomial": (
        Lens(HD, _matrix(900, 897, 647.3, 352.8), np.array([0.9, 0.12, 4e-4, -3e-4, 0.005, 1.24, 0.31, 0.02])),
        "rational_polynomial",
    ),
    "equidistant": (
        Lens(HD, _matrix(480, 478, 647.3, 352.8), np.array([-0.02, 0.004, -0.001, 0.0002]), is_fisheye=True),
        "equidistant",
    ),
}
"""Lenses in OpenCV's convention, and the name of their model."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """Errors of a located camera against the pose with which its image was rendered."""

    position_m: float
    rotation_rad: float
    table_m: float
    error_px: float
    table_std_m: float


def model_of(lens: Lens, name: str) -> CameraModel:
    """Make the model of a lens in this library's convention."""
    (fx, _, cx), (_, fy, cy), _ = lens.matrix.tolist()
    return CameraModel(*lens.size, fx, fy, cx + HALF_PIXEL, cy + HALF_PIXEL, name, tuple(lens.distortion.tolist()))


def run_trial(board: Board, lens_name: str, rng: np.random.Generator) -> Trial:
    """Render a board from a random pose, locate the camera, and compare.

    Raises:
        SettingsError: the image was refused.
    """
    lens, name = LENSES[lens_name]
    x_m, y_m, z_m, yaw_rad = rng.uniform((-0.2, -0.2, -0.01, -math.pi), (0.2, 0.2, 0.01, math.pi))
    center = np.array([*board.extent_m, 0.0]) / 2
    middle = Rotation.from_euler("z", yaw_rad).apply(center) + np.array([x_m, y_m, z_m])
    target = middle + rng.uniform((-0.03, -0.03, 0.0), (0.03, 0.03, 0.0))
    far_m = 0.5 if lens.is_fisheye or lens.size == VGA else 0.8
    view = look_at(
        target, rng.uniform(0.35, far_m), rng.uniform(0, math.radians(50)), *rng.uniform(-math.pi, math.pi, 2)
    )
    image = render_board(board, lens, view, (x_m, y_m, z_m, yaw_rad), rng)
    located = locate_camera(image, model_of(lens, name), board, Pose(x_m, y_m, z_m, yaw_rad))
    return _errors(located, view, middle)


def _errors(located: LocatedCamera, view: View, middle: Array) -> Trial:
    camera = located.model.pinhole()
    angles = np.linspace(0, 2 * math.pi, 8, endpoint=False)
    ring = np.column_stack([np.cos(angles), np.sin(angles), 0 * angles]) * TABLE_RADIUS_M + middle
    true = located.model.placed(view.position_m, view.rotation).pinhole()
    uv, _ = true.project(ring)
    return Trial(
        position_m=float(np.linalg.norm(camera.position_m - view.position_m)),
        rotation_rad=float(Rotation.from_matrix(view.rotation.T @ camera.world_from_camera_rotation).magnitude()),
        table_m=float(np.linalg.norm(camera.pixel_to_plane(uv, middle[2]) - ring, axis=1).max()),
        error_px=located.error_px,
        table_std_m=located.table_std_m,
    )


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.cameras``."""
    parser = command_parser("cameras", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=50, help="images per board and lens (default 50)")
    options = parser.parse_args(arguments)
    found: dict[str, list[Trial]] = {}
    refused: dict[str, list[str]] = {}
    progress, done = print_progress(20), 0
    for text in BOARDS:
        for lens_name in LENSES:
            case = f"{text.partition(':')[0]}, {lens_name}"
            rng = np.random.default_rng([options.seed, len(found)])
            found[case], refused[case] = [], []
            for _ in range(options.count):
                try:
                    found[case].append(run_trial(Board.parse(text), lens_name, rng))
                except SettingsError as error:
                    refused[case].append(str(error))
                done += 1
                progress(done, options.count * len(BOARDS) * len(LENSES), case)
    trials = [trial for case in found.values() for trial in case]
    millimeters = 1000 * np.array([trial.position_m for trial in trials])
    degrees = np.degrees([trial.rotation_rad for trial in trials])
    table = 1000 * np.array([trial.table_m for trial in trials])
    figures = {
        "camera_models": len(LENSES),
        "board_pose_error_mm": float(np.median(millimeters)),
        "board_pose_error_mm_p95": float(np.quantile(millimeters, 0.95)),
        "board_pose_error_deg": float(np.median(degrees)),
        "board_pose_error_deg_p95": float(np.quantile(degrees, 0.95)),
        "board_table_error_mm_p95": float(np.quantile(table, 0.95)),
        "board_images": options.count * len(found),
        "board_images_refused": sum(map(len, refused.values())),
    }
    cases = {
        case: {name: float(np.median([getattr(one, name) for one in some])) for name in Trial.__dataclass_fields__}
        for case, some in found.items()
        if some
    }
    ratios = [trial.table_m / trial.table_std_m for trial in trials]
    return finish(
        options,
        figures,
        medians=cases,
        refused=refused,
        table_error_over_std_rms=float(np.sqrt(np.mean(np.square(ratios)))),
    )


if __name__ == "__main__":
    sys.exit(main())
