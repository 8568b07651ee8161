"""Real cameras: calibration files, lens distortion, and the pose from a printed board."""

from deltasafe.cameras.calibration_files import read_camera, write_camera
from deltasafe.cameras.model import CameraModel

__all__ = ["CameraModel", "read_camera", "write_camera"]
