"""The steps of the chain on two scenes, with predictions made from the true masks."""

import dataclasses
import json
import pathlib
import re
import shutil

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.execution import ExecutionSettings, Workcell, execute
from deltasafe.geometry import Trajectory
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.planning import MotionSettings, ToolBody
from deltasafe.planning.audit import audit_trajectory
from deltasafe.scene import FieldSettings, OccupancyGrid, load_scenes
from deltasafe.trials.execution_figure import execution_figure
from deltasafe.trials.executions import execute_scenes, load_execution, load_outcomes
from deltasafe.trials.motions import PlannedScenes, load_motion, plan_scenes
from deltasafe.trials.occupancy_fields import (
    load_image_stamp,
    load_occupancy_grid,
    load_p_occupied,
    miss_rates_at_delta,
    write_fields,
)
from deltasafe.trials.safety_report_text import safety_markdown
from deltasafe.trials.selection import load_selection, select_scenes
from deltasafe.trials.write_safety_report import write_safety_report

SCENES = pathlib.Path(__file__).parents[3] / "datasets" / "scenes"
CALIBRATION = Calibration(50, 1, 0.98, 0.95, 0.01, 0.05, 0.01, smallest_supported_delta=0.03)


class Oracle:
    """Predicts the blurred true mask."""

    info = HANDS

    def __init__(self, scenes):
        import cv2

        self.by_image = {}
        for scene in scenes:
            image = cv2.imread(str(scene.image_path), cv2.IMREAD_COLOR_RGB)
            mask = cv2.imread(str(scene.mask_path), cv2.IMREAD_GRAYSCALE)
            self.by_image[image.tobytes()] = cv2.GaussianBlur(mask.astype(np.float32) / 255, (0, 0), 2.0)

    def p_occupied(self, rgb):
        return self.by_image[rgb.tobytes()]


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Scene 0 as it is, and once more with a goal on top of the hand."""
    source = tmp_path_factory.mktemp("scenes")
    for name in ("scene_000", "scene_900"):
        shutil.copytree(SCENES / "scene_000", source / name)
    record = json.loads((source / "scene_900" / "scene.json").read_text())
    record["id"] = "scene_900"
    record["goal"]["position_m"] = [0.03, -0.05, 0.03]
    (source / "scene_900" / "scene.json").write_text(json.dumps(record))
    # another image, because the oracle finds the mask by the image
    shutil.copy(SCENES / "scene_003" / "image.jpg", source / "scene_900" / "image.jpg")

    root = tmp_path_factory.mktemp("chain")
    scenes = select_scenes(source, 0, root / "scenes")
    write_fields(Oracle(scenes), scenes, root / "fields", FieldSettings())
    motions = plan_scenes(scenes, root / "fields", root / "motions", MotionSettings(cost="area"), CALIBRATION, 0)
    planned = PlannedScenes(scenes, root / "fields", root / "motions")
    outcomes = execute_scenes(planned, root / "executions", ExecutionSettings(), 0, workers=2)
    report = write_safety_report(planned, root / "executions", root / "report", n_films=1)
    return scenes, root, motions, outcomes, report


def test_an_executed_motion_is_delta_safe_without_contact(chain):
    report = chain[-1]
    verdict = report.scenes[0].verdict
    assert report.scenes[0].outcome == "executed"
    assert verdict.safe
    assert verdict.delta_safe_share == 1.0
    assert verdict.contacts == 0
    assert verdict.min_tool_to_hand_m > 0
    assert verdict.max_error_m < 0.005


def test_a_scene_without_a_safe_path_has_a_reason(chain):
    _, root, motions, outcomes, report = chain
    assert not motions["scene_900"].is_safe
    assert "goal unsafe" in outcomes[1].reason
    assert load_outcomes(root / "executions") == outcomes
    assert report.scenes[1].verdict is None
    assert "goal unsafe" in report.scenes[1].outcome
    assert report.figures()["scenes_executed"] == 1


def test_the_report_is_complete_on_disk(chain):
    _, root, _, _, report = chain
    text = (root / "report" / "report.md").read_text()
    linked = re.findall(r"\]\((.+?)\)", text)
    assert {"scene_000.gif", *(f"scene_000-{kind}.png" for kind in ("plan", "execution", "executed"))} < set(linked)
    assert "scene_900-plan.png" in linked
    assert all((root / "report" / name).is_file() for name in linked)
    assert (root / "report" / "executed.jpg").is_file()
    assert "1 of 2 scenes were executed" in text
    assert f"| scene_900 | {report.scenes[1].outcome} | - |" in text
    assert "\n\n\n" not in text
    summary = (root / "report" / "summary.md").read_text()
    assert text.startswith(summary)
    assert "](" not in summary
    stored = json.loads((root / "report" / "report.json").read_text())
    assert stored["figures"] == pytest.approx(report.figures())


def test_miss_rate_is_counted_over_the_pixels_of_the_hand(chain):
    import cv2

    scenes, root = chain[0], chain[1]
    mask = cv2.imread(str(scenes[0].mask_path), cv2.IMREAD_GRAYSCALE) > 0
    p_occupied = load_p_occupied(root / "fields", scenes[0].id)
    assert miss_rates_at_delta(scenes[:1], root / "fields", 0.05) == {"scene_000": 0.0}
    rate = miss_rates_at_delta(scenes[:1], root / "fields", 0.9)["scene_000"]
    rows, columns = np.nonzero(mask)
    assert rate == sum(p_occupied[r, c] <= 0.9 for r, c in zip(rows, columns, strict=True)) / len(rows)
    assert 0 < rate < 1


def test_the_audit_accepts_the_plan_and_refuses_a_path_through_the_hand(chain):
    scenes, root, motions, _, _ = chain
    motion, grid = motions["scene_000"], load_occupancy_grid(root / "fields", "scene_000")
    assert audit_trajectory(motion.trajectory, grid, motion.body, 0.05).unsafe_poses == 0
    through_the_hand = np.linspace(scenes[0].start.as_array(), [0.03, -0.05, 0.03, 0.0], 200)
    time_s = np.arange(200) / 100
    straight = Trajectory(time_s, through_the_hand, np.zeros((200, 4)))
    audited = audit_trajectory(straight, grid, motion.body, 0.05)
    assert audited.unsafe_poses > 0
    assert audited.worst_p_occupied > 0.9


def test_the_audit_tests_the_turned_tool():
    """A wall 20 mm beside the path: beyond the short semi-axis, within the long one."""
    p_occupied = np.zeros((40, 40, 10), np.float32)
    p_occupied[:, 30:, :] = 1.0
    grid = OccupancyGrid(p_occupied, np.array([-0.1, -0.13, 0.0]), 0.005)
    poses = np.zeros((50, 4))
    poses[:, 0], poses[:, 2] = np.linspace(-0.03, 0.03, 50), 0.02
    time_s = np.arange(50) / 100
    turned = poses.copy()
    turned[25, 3] = np.pi / 2
    along = audit_trajectory(Trajectory(time_s, poses, 0 * poses), grid, ToolBody(), 0.05)
    across = audit_trajectory(Trajectory(time_s, turned, 0 * poses), grid, ToolBody(), 0.05)
    assert along.unsafe_poses == 0
    assert across.unsafe_poses > 0


def test_planning_below_the_supported_delta_writes_nothing(chain, tmp_path):
    scenes, root = chain[0], chain[1]
    settings = MotionSettings(delta=0.02)
    with pytest.raises(SettingsError, match=r"0\.03"):
        plan_scenes(scenes, root / "fields", tmp_path / "motions", settings, CALIBRATION, 0)
    assert not (tmp_path / "motions").exists()


def test_executions_do_not_depend_on_workers_and_executor(chain, tmp_path):
    class InThisProcess:
        def run(self, tasks, workers, needs):
            assert (workers, needs.own_process) == (7, True)
            yield from reversed([(index, task.work(*task.arguments)) for index, task in enumerate(tasks)])

    scenes, root, _, outcomes, _ = chain
    planned, reports = PlannedScenes(scenes, root / "fields", root / "motions"), []
    again = execute_scenes(
        planned, tmp_path / "again", ExecutionSettings(), 0, 7, InThisProcess(), lambda *report: reports.append(report)
    )
    assert again == outcomes == load_outcomes(tmp_path / "again")
    digests = [load_execution(folder, "scene_000").digest() for folder in (tmp_path / "again", root / "executions")]
    assert digests[0] == digests[1]
    assert [(done, total) for done, total, _ in reports] == [(1, 2), (2, 2)]
    with pytest.raises(SettingsError, match="workers"):
        execute_scenes(planned, tmp_path / "none", ExecutionSettings(), 0, 0)
    assert not (tmp_path / "none").exists()


def test_a_saved_motion_equals_the_planned_one(chain):
    _, root, motions, _, _ = chain
    stored = load_motion(root / "motions", "scene_000")
    assert np.array_equal(stored.trajectory.poses, motions["scene_000"].trajectory.poses)
    assert stored.settings == motions["scene_000"].settings
    assert load_p_occupied(root / "fields", "scene_000").shape == (480, 640)


def test_a_replaced_image_is_refused(chain, tmp_path):
    source = tmp_path / "scenes"
    shutil.copytree(SCENES / "scene_001", source / "scene_001")
    select_scenes(source, 1, tmp_path / "selection")
    assert [scene.id for scene in load_selection(tmp_path / "selection")] == ["scene_001"]
    shutil.copy(SCENES / "scene_002" / "image.jpg", source / "scene_001" / "image.jpg")
    with pytest.raises(DataError, match=r"image\.jpg: was replaced"):
        load_selection(tmp_path / "selection")


def test_another_task_is_another_selection(tmp_path):
    """The digests of scenes.json are the data version of the asset: a new goal must make its results stale."""
    source, versions = tmp_path / "scenes", []
    shutil.copytree(SCENES / "scene_001", source / "scene_001")
    path = source / "scene_001" / "scene.json"
    for x_m in (0.1, 0.12):
        record = json.loads(path.read_text())
        record["goal"]["position_m"][0] = x_m
        path.write_text(json.dumps(record))
        select_scenes(source, 1, tmp_path / "selection")
        versions.append((tmp_path / "selection" / "scenes.json").read_bytes())
    assert versions[0] != versions[1]
    path.write_text(path.read_text() + " ")  # the selection holds a hard link to it
    with pytest.raises(DataError, match=r"scene\.json: was replaced"):
        load_selection(tmp_path / "selection")


def test_the_number_of_scenes_is_a_limit(tmp_path):
    shutil.copytree(SCENES / "scene_000", tmp_path / "source" / "scene_000")
    assert len(select_scenes(tmp_path / "source", 9, tmp_path / "selection")) == 1
    with pytest.raises(SettingsError, match="n_scenes must be positive, or 0"):
        select_scenes(SCENES, -1, tmp_path / "selection")


def test_reports_and_figures_name_another_obstacle(chain):
    _, root, motions, _, report = chain
    text = safety_markdown(report, DatasetInfo("coffee_cup"))
    assert "smallest distance of the tool to the true coffee cup" in text
    assert not re.search(r"\bhands?\b", text, re.IGNORECASE)
    execution = load_execution(root / "executions", "scene_000")
    figure = execution_figure(execution, motions["scene_000"].settings, thing="coffee cup")
    assert figure.axes[0].get_ylabel() == "distance to\nthe coffee cup [mm]"


def test_an_image_of_another_size_than_its_camera_is_refused(tmp_path):
    scene = load_scenes(SCENES)[0]
    wrong = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=320))
    with pytest.raises(DataError, match="its camera has 320 x 480"):
        write_fields(Oracle([scene]), [wrong], tmp_path / "fields", FieldSettings())
    assert not (tmp_path / "fields").exists()


def test_a_scene_id_with_slashes_is_refused(tmp_path):
    shutil.copytree(SCENES / "scene_000", tmp_path / "scene_000")
    path = tmp_path / "scene_000" / "scene.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {"id": "../elsewhere"}))
    with pytest.raises(DataError, match="without slashes"):
        load_scenes(tmp_path)


def test_tracking_errors_do_not_depend_on_the_height_of_the_table():
    s = np.linspace(0, 1, 601)
    poses = np.zeros((601, 4))
    poses[:, 0], poses[:, 2] = -0.1 + 0.1 * (10 * s**3 - 15 * s**4 + 6 * s**5), 0.1
    time_s = s * 2.0
    mesh = (np.array([[0.3, 0.3, 0.0], [0.31, 0.3, 0.0], [0.3, 0.31, 0.0]]), np.array([[0, 1, 2]]))
    errors = []
    for table_z_m in (0.0, 1.0):
        lift = np.array([0, 0, table_z_m, 0])
        trajectory = Trajectory(time_s, poses + lift, np.gradient(poses, time_s, axis=0))
        cell = Workcell(ToolBody(), (mesh[0] + lift[:3], mesh[1]), table_z_m)
        run = execute(trajectory, cell, ExecutionSettings(), 3)
        assert run.completed
        assert run.contacts.sum() == 0
        errors.append(run.workspace_error_m.max())
    assert errors[0] == pytest.approx(errors[1], rel=1e-3)


def test_a_motion_of_another_image_is_not_executed(chain, tmp_path):
    scenes, root, *_ = chain
    scene = scenes[0]
    motion = load_motion(root / "motions", scene.id)
    assert motion.image_stamp == load_image_stamp(root / "fields", scene.id)
    fields = tmp_path / "fields"
    shutil.copytree(root / "fields", fields)
    shutil.copy(fields / scenes[1].id / "seen.json", fields / scene.id / "seen.json")
    with pytest.raises(DataError, match="another image than its field"):
        execute_scenes(
            PlannedScenes([scene], fields, root / "motions"), tmp_path / "executions", ExecutionSettings(), 0
        )
    assert not (tmp_path / "executions").exists()
    (fields / scene.id / "seen.json").write_text('{"image_sha256": "short"}')
    with pytest.raises(DataError, match="make the occupancy fields again"):
        load_image_stamp(fields, scene.id)
