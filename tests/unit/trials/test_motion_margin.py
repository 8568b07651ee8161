"""The margin of a motion: from the calibration's fraction of the width to meters, and what it keeps the tool from."""

import dataclasses

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.geometry import Pose
from deltasafe.perception.calibration.conformal_margin import ConformalMargins, hausdorff_at_delta
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.calibration.reliability import DELTA_GRID
from deltasafe.planning import MotionSettings, PlannedMotion, plan_motion, verify_motion
from deltasafe.scene import Camera, FieldSettings, OccupancyGrid, grid_from_image
from deltasafe.trials.motion_margin import motion_margin_m, require_supported_alpha

CALIBRATION = Calibration(50, 1, 0.98, 0.95, 0.01, 0.05, 0.01, smallest_supported_delta=0.03)
DOWN = np.diag([1.0, -1.0, -1.0])
ALPHA = 0.1


def camera(tilt_rad: float = 0.0) -> Camera:
    cos, sin = np.cos(tilt_rad), np.sin(tilt_rad)
    rotation = np.array([[1, 0, 0], [0, cos, -sin], [0, sin, cos]]) @ DOWN
    return Camera(320, 240, 384.0, 384.0, 160.0, 120.0, np.array([0.0, 0.0, 0.5]), rotation)


def calibration(fraction: float, n_images: int = 20) -> Calibration:
    scores = np.full((n_images, len(DELTA_GRID)), fraction)
    return dataclasses.replace(CALIBRATION, conformal_margins=ConformalMargins.of_images(scores))


def disc(center_px: tuple[float, float], radius_px: float) -> np.ndarray:
    rows, columns = np.mgrid[:240, :320]
    return np.hypot(columns + 0.5 - center_px[0], rows + 0.5 - center_px[1]) <= radius_px


def grid_of(p_occupied: np.ndarray, view: Camera) -> OccupancyGrid:
    return grid_from_image(p_occupied.astype(np.float32), view, 0.0, 0.05, FieldSettings(voxel_m=0.004))


def test_margin_of_a_camera_facing_down_equals_closed_form() -> None:
    """5 % of 320 pixels, of which each covers 0.5 m / 384."""
    grid = grid_of(np.zeros((240, 320)), camera())
    settings = MotionSettings(motion_alpha=ALPHA)
    assert motion_margin_m(calibration(0.05), settings, camera(), grid) == pytest.approx(16 * 0.5 / 384)
    assert motion_margin_m(calibration(0.05), MotionSettings(motion_alpha=0.0), camera(), grid) == 0.0


def test_margin_of_an_oblique_camera_is_that_of_the_farthest_table_it_sees_near_the_task() -> None:
    """Along its axis, a pixel covers depth^2 / (height f) of the table."""
    oblique = dataclasses.replace(camera(1.2), position_m=np.array([0.0, -1.2, 0.5]))
    task = (Pose(-0.1, 0.0, 0.03), Pose(0.1, 0.0, 0.03))
    settings = FieldSettings(voxel_m=0.01)
    grid = grid_from_image(np.zeros((240, 320), np.float32), oblique, 0.0, 0.05, settings, task)
    margin_m = motion_margin_m(calibration(0.05), MotionSettings(motion_alpha=ALPHA), oblique, grid)
    farthest = np.array([[0.0, 0.5, 0.0]])
    _, depth_m = oblique.project(farthest)
    assert margin_m == pytest.approx(16 * float(depth_m[0]) ** 2 / (0.5 * 384), rel=0.1)


@pytest.mark.parametrize("tilt_rad", [0.0, 0.35])
def test_a_hand_that_exceeds_the_unsafe_set_by_the_margin_lies_in_the_dilated_grid(tilt_rad: float) -> None:
    """The score of an image is its margin in pixels; the extruded hand must then lie in the dilated extrusion."""
    view = camera(tilt_rad)
    seen, hand = disc((150, 120), 30), disc((156, 112), 38)
    fraction = hausdorff_at_delta(np.where(seen, 0.9, 0.0), hand)[0]
    unsafe, true = grid_of(0.9 * seen, view), grid_of(1.0 * hand, view)
    margin_m = motion_margin_m(calibration(fraction), MotionSettings(motion_alpha=ALPHA), view, unsafe)
    inside = (true.p_occupied == 1.0) & (grid_of(np.zeros((240, 320)), view).p_occupied < 1.0)
    dilated = unsafe.dilated(0.05, margin_m).p_occupied == 1.0
    assert inside.any()
    assert not (inside & (unsafe.p_occupied > 0.05)).all() or margin_m == 0
    # a voxel of the true extrusion may reach up to one voxel beyond the points of the hand in it
    assert (inside & ~unsafe.dilated(0.05, margin_m + grid_diagonal(unsafe)).p_occupied.astype(bool)).sum() == 0
    assert (inside & dilated).sum() > 0.97 * inside.sum()


def grid_diagonal(grid: OccupancyGrid) -> float:
    return grid.voxel_m * 2**0.5


def test_a_motion_keeps_the_margin_and_the_audit_finds_one_that_does_not() -> None:
    view = camera()
    grid = grid_of(0.9 * disc((160, 120), 25), view)
    start, goal = Pose(-0.12, 0.0, 0.03), Pose(0.12, 0.0, 0.03)
    settings = MotionSettings(n_iterations=400, n_refinements=50)
    free = plan_motion(grid, start, goal, settings, 1)
    kept = plan_motion(grid, start, goal, settings, 1, margin_m=0.02)
    assert verify_motion(free, grid).is_safe
    assert verify_motion(kept, grid).is_safe
    assert kept.result.cost > free.result.cost
    pretended = dataclasses.replace(free, margin_m=0.02)
    audit = verify_motion(pretended, grid)
    assert not audit.is_safe
    assert audit.worst_p_occupied <= 0.05


def test_stored_margin_is_read_again(tmp_path) -> None:
    grid = grid_of(0.9 * disc((160, 120), 25), camera())
    settings = MotionSettings(n_iterations=50, n_refinements=0, motion_alpha=ALPHA)
    motion = plan_motion(grid, Pose(-0.12, 0.0, 0.03), Pose(0.0, 0.0, 0.03), settings, 1, margin_m=0.02)
    assert not motion.is_safe
    assert "20.0 mm" in motion.reason
    motion.save(tmp_path / "motion")
    assert PlannedMotion.load(tmp_path / "motion").margin_m == 0.02


def test_alpha_that_the_calibration_does_not_support_is_refused() -> None:
    assert require_supported_alpha(0.05, 0.0, CALIBRATION) is None
    with pytest.raises(SettingsError, match="earlier version"):
        require_supported_alpha(0.05, ALPHA, CALIBRATION)
    with pytest.raises(SettingsError, match=r"1 / \(20 \+ 1\)"):
        require_supported_alpha(0.05, 0.01, calibration(0.05))
    with pytest.raises(SettingsError, match="no finite margin"):
        require_supported_alpha(0.05, ALPHA, calibration(np.inf))
    with pytest.raises(SettingsError, match="motion_alpha"):
        MotionSettings(motion_alpha=1.0)
