import dataclasses
import pathlib

import numpy as np
import pytest

pytest.importorskip("matplotlib")

from matplotlib.image import imread

from deltasafe.errors import SettingsError
from deltasafe.execution import Execution
from deltasafe.execution.recording import PHASES
from deltasafe.geometry import Pose
from deltasafe.planning import MotionSettings, plan_motion
from deltasafe.scene import Camera, grid_from_image
from deltasafe.trials.executed_path_figure import Caption, arc_length_of_samples_m, executed_over_image

CAMERA = Camera(160, 120, 192.0, 192.0, 80.0, 60.0, np.array([0.0, 0.0, 0.5]), np.diag([1.0, -1.0, -1.0]))
P_OCCUPIED = np.clip(1.5 - np.hypot(*(np.mgrid[:120, :160] + 0.5 - np.array([70, 80])[:, None, None])) / 20, 0, 1)
P_OCCUPIED = P_OCCUPIED.astype(np.float32)


def planned(start):
    grid = grid_from_image(P_OCCUPIED, CAMERA, 0.0, 0.05)
    return plan_motion(grid, start, Pose(0.13, 0.0, 0.03), MotionSettings(n_iterations=300), 0)


def executed(motion):
    """Every 20 ms the reference, after an approach that is not evaluated."""
    poses, velocities = (getattr(motion.trajectory, name)[::20] for name in ("poses", "velocities"))
    down = np.repeat(poses[:1], 5, axis=0)
    down[:, 2] += np.linspace(0.04, 0.01, 5)
    poses, velocities = np.concatenate([down, poses]), np.concatenate([np.zeros((5, 4)), velocities])
    count, half = len(poses), poses[:, 3] / 2
    return Execution(
        time_s=0.02 * np.arange(count),
        phase=np.append(np.full(5, PHASES.index("approach")), np.full(count - 5, PHASES.index("motion"))),
        reference_poses=poses,
        reference_velocities=velocities,
        tool_positions_m=poses[:, :3] + 0.0002,
        tool_quaternions=np.column_stack([np.zeros((count, 2)), np.sin(half), np.cos(half)]),
        joint_positions_rad=np.zeros((count, 7)),
        torques_nm=np.zeros((count, 7)),
        tool_to_hand_m=np.linspace(0.03, 0.01, count),
        arm_to_hand_m=np.full(count, np.inf),
        contacts=np.zeros(count),
        body=motion.body,
        seed=0,
    )


def test_arc_length_of_the_samples_agrees_with_the_plan() -> None:
    motion = planned(Pose(-0.13, 0.0, 0.03))
    arc_m = arc_length_of_samples_m(executed(motion))
    assert (arc_m[:6] == 0).all()
    assert (np.diff(arc_m) >= 0).all()
    assert arc_m[-1] == pytest.approx(motion.profile.arc_length_m[-1], rel=0.01)


def test_complete_and_stopped_executions_are_drawn(tmp_path: pathlib.Path) -> None:
    motion = planned(Pose(-0.13, 0.0, 0.03))
    image = np.full((120, 160, 3), 90, np.uint8)
    for name, execution in (
        ("whole", executed(motion)),
        ("stopped", dataclasses.replace(executed(motion), stop_reason="error")),
    ):
        executed_over_image(image, P_OCCUPIED, CAMERA, motion, execution, tmp_path / f"{name}.png", Caption("scene"))
        drawn = imread(tmp_path / f"{name}.png")
        assert min(drawn.shape[:2]) > 400
        assert drawn[..., :3].std() > 0.1
    assert len(list(tmp_path.iterdir())) == 2


def test_without_a_motion_nothing_is_drawn(tmp_path: pathlib.Path) -> None:
    execution = executed(planned(Pose(-0.13, 0.0, 0.03)))
    image = np.full((120, 160, 3), 90, np.uint8)
    with pytest.raises(SettingsError, match="no motion"):
        executed_over_image(image, P_OCCUPIED, CAMERA, planned(Pose(0, -0.02, 0.03)), execution, tmp_path / "a.png")
    with pytest.raises(SettingsError, match="camera's size"):
        executed_over_image(image[1:], P_OCCUPIED, CAMERA, planned(Pose(0, -0.02, 0.03)), execution, tmp_path / "a.png")
    assert list(tmp_path.iterdir()) == []
