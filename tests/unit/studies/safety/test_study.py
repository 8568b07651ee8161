"""The study from end to end, with eyes that see the truth and an arm that follows exactly; and what it concludes."""

import dataclasses
import gc
import json
import pathlib
import weakref

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.execution import Execution, MeshDistance
from deltasafe.execution.recording import PHASES
from deltasafe.planning import MotionSettings
from deltasafe.scene import FieldSettings, LoggedScene
from deltasafe.studies.resumable_jobs import Effort
from deltasafe.studies.safety import (
    CONTENDERS,
    SafetyStudy,
    SafetyStudySettings,
    SceneRef,
    Sight,
    StudyInputs,
    by_speed,
    cell,
    failures,
    figures_of,
    pairing,
    replay,
    run_study,
    runs,
    upper_bound,
    write_safety_study,
)
from deltasafe.studies.safety.motions import OUTCOMES
from deltasafe.studies.safety.runs import BY_SPEED, COLUMNS, SPEED_EDGES_MPS, STAGES
from deltasafe.studies.safety.scenarios import true_mask

SCENES = pathlib.Path(__file__).parents[4] / "datasets" / "scenes"
SETTINGS = SafetyStudySettings(
    deltas=(0.05,),
    n_executions=4,
    beside=("single_member", "top_speed", "bounding_volume"),
    beside_every=2,
    n_bootstrap=100,
    n_films=1,
    field=FieldSettings(voxel_m=0.005),
    motion=MotionSettings(cost="area", n_iterations=400, n_refinements=50),
)
N_BINS = len(SPEED_EDGES_MPS) - 1


@dataclasses.dataclass(frozen=True)
class TrueEyes:
    """See the true mask, blurred. The second member is blind."""

    folder: str

    def look(self, rgb):
        mask = true_mask(LoggedScene.load(self.folder)).astype(np.float32)
        seen = np.clip(cv2.GaussianBlur(mask, (0, 0), 3.0), 0, 1)
        return Sight(seen, np.stack([seen, np.zeros_like(seen)]))


def follow(trajectory, cell, settings, seed, *, limits, unsafe_below_m):
    """An arm that is where it should be, recorded ten times a second."""
    if seed % 7 == 0:
        raise PlanningError("this arm is broken")
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
    inputs = StudyInputs((SceneRef(scene, "a"),), ("scene_003",), TrueEyes(scene), 2, 0.02)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "execute", follow)
        yield folder, inputs, run_study(SETTINGS, inputs, folder / "batches")


def test_situations_are_added_until_enough_was_executed(made):
    _, _, study = made
    assert study.executed.sum() >= SETTINGS.n_executions
    situations = study.trials["situation"]
    assert (np.diff(situations) >= 0).all()
    for trial in range(len(situations)):
        situation, place = SETTINGS.situation_and_place(trial)
        name, delta = SETTINGS.trials_of(situation)[place]
        assert situations[trial] == situation
        assert study.trials["contender"][trial] == CONTENDERS.index(name)
        assert study.trials["delta"][trial] == delta
    assert set(study.stage_s) == set(STAGES)
    assert study.stage_s["plan"] > 0


def test_who_sees_the_hand_keeps_clear_of_it(made):
    _, _, study = made
    ours = cell(study, "ours", 0.05)
    assert ours.executed >= 1
    assert ours.model.violated == ours.reality.violated == ours.contacts == 0
    assert ours.min_tool_m > 0.0005
    assert ours.max_missed_share < 0.01
    assert ours.reality.upper95 == pytest.approx(upper_bound(0, ours.executed))
    seen = study.of("single_member", 0.05)
    blind = seen & (study.trials["member"] == 1)
    assert (study.trials["missed_share"][blind] == 1).all()
    assert set(study.trials["member"][seen]) <= {0, 1}
    assert (study.trials["member"][~seen] == -1).all()


def test_without_a_schedule_the_same_path_is_driven_faster(made):
    _, _, study = made
    table = study.trials
    ours = {int(table["situation"][n]): n for n in np.flatnonzero(study.of("ours", 0.05) & study.executed)}
    compared = 0
    for n in np.flatnonzero(study.of("top_speed", 0.05) & study.executed):
        m = ours[int(table["situation"][n])]
        assert table["length_m"][n] == pytest.approx(table["length_m"][m], rel=1e-3)
        assert table["duration_s"][n] <= table["duration_s"][m] + 1e-9
        compared += 1
    assert compared
    assert pairing(study, "ours", "top_speed", 0.05).n == compared


def test_an_interrupted_study_ends_in_the_same_bytes(made, tmp_path):
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
    # what is asked of the trials changes no trial; what decides them does
    more = dataclasses.replace(SETTINGS, n_bootstrap=50, n_films=0)
    before = sorted((folder / "batches").iterdir())
    run_study(more, inputs, folder / "batches")
    assert sorted((folder / "batches").iterdir()) == before


def test_a_study_is_read_as_it_was_written(made, tmp_path):
    _, _, study = made
    study.save(tmp_path / "study")
    again = SafetyStudy.load(tmp_path / "study")
    assert again.settings == study.settings
    assert again.inputs == dataclasses.replace(study.inputs, eyes=None)
    assert again.effort == study.effort
    for name, column in study.trials.items():
        np.testing.assert_array_equal(again.trials[name], column)
        assert again.trials[name].dtype == column.dtype
    (tmp_path / "study" / "trials.npz").write_bytes(b"nothing")
    with pytest.raises(DataError, match="no safety study"):
        SafetyStudy.load(tmp_path / "study")


def test_a_trial_can_be_made_again(made):
    _, inputs, study = made
    trial = int(np.flatnonzero(study.executed)[-1])
    _, execution = replay(SETTINGS, inputs.scenes, inputs.eyes, trial)
    assert execution.tool_to_hand_m.min() == study.trials["min_tool_m"][trial]
    refused = np.flatnonzero(~study.executed)
    if len(refused):
        with pytest.raises(SettingsError, match="was not executed"):
            replay(SETTINGS, inputs.scenes, inputs.eyes, int(refused[0]))


def test_an_arm_that_cannot_follow_is_an_outcome(made, tmp_path):
    _, inputs, _ = made

    def broken(*arguments, **options):
        raise PlanningError("out of reach")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "execute", broken)
        found = runs.meet(dataclasses.replace(SETTINGS, beside=()), inputs.scenes, inputs.eyes, 1)
        assert OUTCOMES[found["outcome"][0]] in {"the arm cannot follow", "start unsafe", "goal unsafe"}
        assert np.isnan(found["min_tool_m"][0])
    far = dataclasses.replace(SETTINGS, task=dataclasses.replace(SETTINGS.task, clearance_m=0.5))
    with pytest.raises(SettingsError, match="not one motion"):
        run_study(far, inputs, tmp_path)
    with pytest.raises(SettingsError, match="scene"):
        StudyInputs((), (), None, 1, None)


def test_a_situation_that_is_over_is_forgotten(made):
    """Thousands of them pass through one process; each holds images, fields and paths."""
    _, inputs, _ = made
    seen = []

    class Watched(runs._Table):
        def __init__(self, *arguments):
            super().__init__(*arguments)
            seen.append(weakref.ref(self))

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(runs, "_Table", Watched)
        runs.meet(SETTINGS, inputs.scenes, inputs.eyes, 0)
    gc.collect()
    assert [each() for each in seen] == [None]


def synthetic(rows):
    """A study of rows (situation, scene, contender, unsafe, touching, contacts, stopped, tool_m), all executed."""
    table = {name: np.zeros(len(rows), kind) for name, kind in COLUMNS.items()}
    columns = ("situation", "scene", "contender", "unsafe_poses", "touching_poses", "contacts", "stopped", "min_tool_m")
    for name, values in zip(columns, zip(*rows, strict=True), strict=True):
        table[name] = np.array([CONTENDERS.index(v) if name == "contender" else v for v in values], COLUMNS[name])
    table["delta"][:], table["poses"][:], table["min_arm_m"][:], table["duration_s"][:] = 0.05, 100, 0.2, 5.0
    table["simulated_s"][:] = 7.0
    for name in BY_SPEED:
        table[name] = np.zeros((len(rows), N_BINS))
    table["poses_by_speed"][:, 1] = 100
    table["min_tool_by_speed_m"][:, 1] = table["min_tool_m"]
    settings = dataclasses.replace(SETTINGS, beside=CONTENDERS[1:], n_bootstrap=200)
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
    ours = cell(study, "ours", 0.05)
    assert (ours.trials, ours.executed, ours.contacts, ours.stopped) == (4, 4, 1, 0)
    assert (ours.model.n, ours.model.violated, ours.reality.violated) == (4, 1, 0)
    assert ours.model.pose_rate == pytest.approx(0.025)
    assert (ours.model.scenes, ours.model.scenes_violated) == (2, 1)
    assert ours.model.upper95 == pytest.approx(upper_bound(1, 4))
    assert ours.min_tool_m == 0.0005
    single = cell(study, "single_member", 0.05)
    assert (single.reality.violated, single.contacts, single.stopped) == (1, 1, 1)
    assert single.reality.pose_rate == pytest.approx(0.1)
    assert cell(study, "top_speed", 0.05).executed == 0


def test_pairs_count_the_situations_in_which_both_moved():
    pair = pairing(synthetic(ROWS), "ours", "single_member", 0.05)
    assert (pair.n, pair.only_first, pair.only_second, pair.both) == (2, 0, 1, 0)
    assert pair.p_value == 1.0  # one discordant pair says nothing
    assert pair.shorter_m == pytest.approx((-0.010 + 0.002) / 2)
    many = [(n, 0, name, 0, 0, int(name != "ours"), False, 0.01) for n in range(6) for name in ("ours", "top_speed")]
    assert pairing(synthetic(many), "ours", "top_speed", 0.05).p_value == pytest.approx(2 / 2**6)


def test_failures_are_those_that_a_contender_answers_for():
    # the compared method's poses beyond a field that it does not know are none, its contact is one
    assert list(failures(synthetic(ROWS))) == [1, 3, 5, 7]


def test_figures_have_the_names_that_records_use():
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


def test_the_report_is_whole_and_says_what_happened(made, tmp_path):
    _, _, study = made
    figures = write_safety_study(study, tmp_path / "report")
    assert {"report.md", "figures.json", "trials.npz", "study.json", "rates.png", "clearances.png", "speed.png"} <= {
        file.name for file in (tmp_path / "report").iterdir()
    }
    assert json.loads((tmp_path / "report" / "figures.json").read_text()) == figures
    text = (tmp_path / "report" / "report.md").read_text()
    assert f"{int(study.executed.sum())} executed motions" in text
    assert "supports no delta" not in text
    assert "nan" not in text
    failed = synthetic(ROWS)
    write_safety_study(failed, tmp_path / "failed")
    text = (tmp_path / "failed" / "report.md").read_text()
    assert "supports no delta below 0.1" in text
    assert "4 in all" in text
    assert "| 1 | a | Single member (M = 1) | 0.05 | 50 of 100 | 20 | 3 | yes |" in text
