"""A safety study from end to end, with a predictor of the true mask and an ideal arm, and its statistics."""

import dataclasses
import gc
import json
import pathlib
import re
import weakref

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.execution import Execution, MeshDistance
from deltasafe.execution.recording import PHASES
from deltasafe.planning import MotionSettings
from deltasafe.scene import FieldSettings, LoggedScene
from deltasafe.studies.intervals import upper_bound
from deltasafe.studies.resumable_jobs import Effort
from deltasafe.studies.safety import (
    SafetyStudy,
    SafetyStudySettings,
    StudyInputs,
    replay,
    run_study,
    runs,
    write_report,
)
from deltasafe.studies.safety.evidence import by_speed, evaluate, failures, pair
from deltasafe.studies.safety.motions import OUTCOMES
from deltasafe.studies.safety.predictors import Prediction
from deltasafe.studies.safety.report import figures_of
from deltasafe.studies.safety.runs import BY_SPEED, COLUMNS, N_BINS, STAGES, SceneRef
from deltasafe.studies.safety.scenarios import true_mask
from deltasafe.studies.safety.settings import METHODS

SCENES = pathlib.Path(__file__).parents[4] / "datasets" / "scenes"
SETTINGS = SafetyStudySettings(
    deltas=(0.05,),
    n_executions=4,
    compared=("single_member", "top_speed", "bounding_volume"),
    compared_every=2,
    n_films=1,
    field=FieldSettings(voxel_m=0.005),
    motion=MotionSettings(cost="area", n_iterations=400, n_refinements=50),
)


@dataclasses.dataclass(frozen=True)
class TrueMaskPredictor:
    """Predicts the blurred true mask. The second member predicts no hand."""

    folder: str

    def predict(self, rgb):
        mask = true_mask(LoggedScene.load(self.folder)).astype(np.float32)
        seen = np.clip(cv2.GaussianBlur(mask, (0, 0), 3.0), 0, 1)
        return Prediction(seen, np.stack([seen, np.zeros_like(seen)]))


def follow(trajectory, cell, settings, seed, *, limits, unsafe_below_m):
    """Record an ideal arm, which follows the reference exactly, at 10 Hz; some seeds cannot follow."""
    if seed % 7 == 0:
        raise PlanningError("the arm cannot follow")
    shown = np.unique(np.append(np.arange(0, len(trajectory.time_s), 100), len(trajectory.time_s) - 1))
    poses, count = trajectory.poses[shown], len(shown)
    half = poses[:, 3] / 2
    quaternions = np.column_stack([np.zeros((count, 2)), np.sin(half), np.cos(half)])
    rotations = [np.array([[np.cos(a), -np.sin(a), 0], [np.sin(a), np.cos(a), 0], [0, 0, 1]]) for a in poses[:, 3]]
    distance = MeshDistance(*cell.mesh)
    tool_m = [distance.to_tool(cell.body, pose[:3], turn) for pose, turn in zip(poses, rotations, strict=True)]
    return Execution(
        time_s=trajectory.time_s[shown],
        phase=np.full(count, PHASES.index("motion")),
        reference_poses=poses,
        reference_velocities=trajectory.velocities[shown],
        tool_positions_m=poses[:, :3],
        tool_quaternions=quaternions,
        joint_positions_rad=np.zeros((count, 7)),
        torques_nm=np.zeros((count, 7)),
        tool_to_hand_m=np.array(tool_m),
        arm_to_hand_m=np.full(count, 0.2),
        contacts=np.zeros(count),
        body=cell.body,
        seed=seed,
    )


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("safety")
    scene = str(SCENES / "scene_003")
    inputs = StudyInputs((SceneRef(scene, "a"),), ("scene_003",), TrueMaskPredictor(scene), 2, 0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "execute", follow)
        yield folder, inputs, run_study(SETTINGS, inputs, folder / "batches")


def test_scenarios_are_added_until_enough_motions_were_executed(made):
    _, _, study = made
    assert study.executed.sum() >= SETTINGS.n_executions
    scenarios = study.trials["scenario"]
    assert (np.diff(scenarios) >= 0).all()
    for trial in range(len(scenarios)):
        scenario, position = SETTINGS.locate(trial)
        name, delta = SETTINGS.trials_of(scenario)[position]
        assert scenarios[trial] == scenario
        assert study.trials["method"][trial] == METHODS.index(name)
        assert study.trials["delta"][trial] == delta
    assert set(study.stage_s) == set(STAGES)
    assert study.stage_s["plan"] > 0


def test_a_perfect_predictor_keeps_the_tool_clear_of_the_hand(made):
    _, _, study = made
    ours = evaluate(study, "ours", 0.05)
    assert ours.executed >= 1
    assert ours.violation.violated == ours.touch.violated == ours.contacts == 0
    assert ours.min_tool_m > 0.0005
    assert study.trials["miss_rate"][study.of("ours", 0.05)].max() < 0.01
    assert ours.touch.upper95 == pytest.approx(upper_bound(0, ours.executed))
    single = study.of("single_member", 0.05)
    blind = single & (study.trials["member"] == 1)
    assert (study.trials["miss_rate"][blind] == 1).all()
    assert set(study.trials["member"][single]) <= {0, 1}
    assert (study.trials["member"][~single] == -1).all()


def test_top_speed_drives_the_same_path_faster(made):
    _, _, study = made
    table = study.trials
    ours = {int(table["scenario"][n]): n for n in np.flatnonzero(study.of("ours", 0.05) & study.executed)}
    compared = 0
    for n in np.flatnonzero(study.of("top_speed", 0.05) & study.executed):
        m = ours[int(table["scenario"][n])]
        assert table["length_m"][n] == pytest.approx(table["length_m"][m], rel=1e-3)
        assert table["duration_s"][n] <= table["duration_s"][m] + 1e-9
        compared += 1
    assert compared
    assert pair(study, "top_speed", 0.05).n == compared


def test_a_resumed_study_ends_in_the_same_bytes(made, tmp_path):
    folder, inputs, study = made
    study.save(tmp_path / "whole")
    halted = []

    def stop(done, total, message):
        halted.append(message)
        if len(halted) == 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run_study(SETTINGS, inputs, tmp_path / "batches", progress=stop)
    assert len(list((tmp_path / "batches").iterdir())) == 1
    run_study(SETTINGS, inputs, tmp_path / "batches").save(tmp_path / "resumed")
    whole, resumed = ((tmp_path / name / "trials.npz").read_bytes() for name in ("whole", "resumed"))
    assert whole == resumed
    # settings of the report do not change the trials
    more = dataclasses.replace(SETTINGS, n_films=0)
    before = sorted((folder / "batches").iterdir())
    run_study(more, inputs, folder / "batches")
    assert sorted((folder / "batches").iterdir()) == before


def test_a_saved_study_loads_equal(made, tmp_path):
    _, _, study = made
    study.save(tmp_path / "study")
    again = SafetyStudy.load(tmp_path / "study")
    assert again.settings == study.settings
    assert again.inputs == dataclasses.replace(study.inputs, predictor=None)
    assert again.effort == study.effort
    for name, column in study.trials.items():
        np.testing.assert_array_equal(again.trials[name], column)
        assert again.trials[name].dtype == column.dtype
    (tmp_path / "study" / "trials.npz").write_bytes(b"nothing")
    with pytest.raises(DataError, match="not readable"):
        SafetyStudy.load(tmp_path / "study")


def test_replay_repeats_a_trial(made):
    _, inputs, study = made
    trial = int(np.flatnonzero(study.executed)[-1])
    _, execution = replay(SETTINGS, inputs.scenes, inputs.predictor, trial)
    assert execution.tool_to_hand_m.min() == study.trials["min_tool_m"][trial]
    refused = np.flatnonzero(~study.executed)
    if len(refused):
        with pytest.raises(SettingsError, match="was not executed"):
            replay(SETTINGS, inputs.scenes, inputs.predictor, int(refused[0]))


def test_an_arm_that_cannot_follow_is_an_outcome(made, tmp_path):
    _, inputs, _ = made

    def broken(*arguments, **options):
        raise PlanningError("out of reach")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "execute", broken)
        found = runs.run_scenario(dataclasses.replace(SETTINGS, compared=()), inputs.scenes, inputs.predictor, 1)
        assert OUTCOMES[found["outcome"][0]] in {"the arm cannot follow", "start unsafe", "goal unsafe"}
        assert np.isnan(found["min_tool_m"][0])
    far = dataclasses.replace(SETTINGS, task=dataclasses.replace(SETTINGS.task, clearance_m=0.5))
    with pytest.raises(SettingsError, match="no motion"):
        run_study(far, inputs, tmp_path)
    with pytest.raises(SettingsError, match="scene"):
        StudyInputs((), (), None, 1, None)


def test_a_finished_scenario_is_garbage_collected(made):
    """One process runs thousands of scenarios; each holds images, fields and paths."""
    _, inputs, _ = made
    created = []

    class Watched(runs._ScenarioRunner):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            created.append(weakref.ref(self))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "_ScenarioRunner", Watched)
        runs.run_scenario(SETTINGS, inputs.scenes, inputs.predictor, 0)
    gc.collect()
    assert [each() for each in created] == [None]


def synthetic(rows):
    """Construct a study of executed trials (scenario, scene, method, unsafe, touching, contacts, stopped, tool_m)."""
    table = {name: np.zeros(len(rows), kind) for name, kind in COLUMNS.items()}
    columns = ("scenario", "scene", "method", "unsafe_poses", "touching_poses", "contacts", "stopped", "min_tool_m")
    for name, values in zip(columns, zip(*rows, strict=True), strict=True):
        table[name] = np.array([METHODS.index(v) if name == "method" else v for v in values], COLUMNS[name])
    table["delta"][:], table["poses"][:], table["min_arm_m"][:], table["duration_s"][:] = 0.05, 100, 0.2, 5.0
    table["simulated_s"][:] = 7.0
    for name in BY_SPEED:
        table[name] = np.zeros((len(rows), N_BINS))
    table["poses_by_speed"][:, 1] = 100
    table["min_tool_by_speed_m"][:, 1] = table["min_tool_m"]
    settings = dataclasses.replace(SETTINGS, compared=METHODS[1:])
    inputs = StudyInputs((SceneRef("a", ""), SceneRef("b", "")), ("a", "b"), None, 5, 0.1)
    return SafetyStudy(settings, inputs, table, Effort(2.0, 4.0), dict.fromkeys(STAGES, 1.0))


ROWS = [
    (0, 0, "ours", 0, 0, 0, False, 0.010),
    (0, 0, "single_member", 50, 20, 3, True, 0.0),
    (0, 0, "chance_constraint", 100, 0, 0, False, 0.002),
    (1, 1, "ours", 10, 0, 0, False, 0.004),
    (1, 1, "single_member", 0, 0, 0, False, 0.006),
    (1, 1, "chance_constraint", 0, 1, 0, False, 0.0),
    (2, 0, "ours", 0, 0, 0, False, 0.020),
    (3, 1, "ours", 0, 0, 2, False, 0.0005),
]


def test_rates_are_counted_by_motion_and_by_pose():
    study = synthetic(ROWS)
    ours = evaluate(study, "ours", 0.05)
    assert (ours.trials, ours.executed, ours.contacts, ours.stopped) == (4, 4, 1, 0)
    assert (ours.violation.n, ours.violation.violated, ours.touch.violated) == (4, 1, 0)
    assert ours.violation.pose_rate == pytest.approx(0.025)
    assert (ours.violation.scenes, ours.violation.scenes_violated) == (2, 1)
    assert ours.violation.upper95 == pytest.approx(upper_bound(1, 4))
    assert ours.min_tool_m == 0.0005
    single = evaluate(study, "single_member", 0.05)
    assert (single.touch.violated, single.contacts, single.stopped) == (1, 1, 1)
    assert single.touch.pose_rate == pytest.approx(0.1)
    assert evaluate(study, "top_speed", 0.05).executed == 0


def test_pairs_count_the_scenarios_in_which_both_moved():
    found = pair(synthetic(ROWS), "single_member", 0.05)
    assert (found.n, found.only_ours, found.only_other, found.both) == (2, 0, 1, 0)
    assert found.p_value == 1.0  # a single discordant pair is no evidence
    assert found.clearance_difference_m == pytest.approx((-0.010 + 0.002) / 2)
    many = [(n, 0, name, 0, 0, int(name != "ours"), False, 0.01) for n in range(6) for name in ("ours", "top_speed")]
    assert pair(synthetic(many), "top_speed", 0.05).p_value == pytest.approx(2 / 2**6)


def test_failures_of_published_methods_are_contacts_and_stops_only():
    assert list(failures(synthetic(ROWS))) == [1, 3, 5, 7]


def test_figures_have_the_names_of_the_records():
    figures = figures_of(synthetic(ROWS))
    assert figures["executions"] == 8
    assert figures["contacts_delta_005"] == 1
    assert figures["joint_violation_upper95_delta_005"] == pytest.approx(upper_bound(1, 4), abs=1e-6)
    assert figures["violation_upper95_delta_005"] <= figures["joint_violation_upper95_delta_005"] + 0.2
    assert figures["realtime_factor"] == pytest.approx(8 * 7.0 / 120)
    assert figures["single_member_contacts_delta_005"] == 1
    assert "top_speed_min_tool_mm_delta_005" not in figures


def test_by_speed_adds_up(made):
    _, _, study = made
    bins = by_speed(study, "ours", 0.05)
    chosen = study.of("ours", 0.05) & study.executed
    assert sum(one.poses for one in bins) == study.trials["poses"][chosen].sum()
    assert min(one.min_tool_m for one in bins) == study.trials["min_tool_m"][chosen].min()


def test_report_is_complete_and_lists_failures(made, tmp_path):
    _, _, study = made
    figures = write_report(study, tmp_path / "report")
    assert {"report.md", "figures.json", "trials.npz", "study.json", "rates.png", "clearances.png", "speed.png"} <= {
        file.name for file in (tmp_path / "report").iterdir()
    }
    assert json.loads((tmp_path / "report" / "figures.json").read_text()) == figures
    text = (tmp_path / "report" / "report.md").read_text()
    assert f"{int(study.executed.sum())} executed motions" in text
    assert "supports no delta" not in text
    assert not re.search(r"nan|inf\b|\{", text)
    failed = synthetic(ROWS)
    write_report(failed, tmp_path / "failed")
    text = (tmp_path / "failed" / "report.md").read_text()
    assert "supports no delta below 0.1" in text
    assert "4 in total" in text
    assert "| 1 | a | Single member (M = 1) | 0.05 | 50 of 100 | 20 | 3 | yes |" in text
