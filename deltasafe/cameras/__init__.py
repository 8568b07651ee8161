"""Real cameras: calibration files, lens distortion, and the pose from a printed board."""

from deltasafe.cameras.board import Board, draw_board
from deltasafe.cameras.calibration_files import read_camera, write_camera
from deltasafe.cameras.locate import LocatedCamera, locate_camera
from deltasafe.cameras.model import CameraModel

__all__ = ["Board", "CameraModel", "LocatedCamera", "draw_board", "locate_camera", "read_camera", "write_camera"]
