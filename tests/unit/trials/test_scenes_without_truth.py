"""The steps of the chain on a scene without true mask and mesh, and reports that mix it with judged scenes."""

import dataclasses
import json
import shutil

import numpy as np
import pytest

from deltasafe.execution import ExecutionSettings
from deltasafe.io.storage import read_json
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.dataset_info import HANDS
from deltasafe.planning import MotionSettings
from deltasafe.scene import FieldSettings
from deltasafe.trials.executions import execute_scenes, load_execution
from deltasafe.trials.motions import PlannedScenes, plan_scenes
from deltasafe.trials.occupancy_fields import miss_rates_at_delta, write_fields
from deltasafe.trials.safety_report import SafetyReport, SceneReport, read_figures
from deltasafe.trials.safety_report_text import safety_markdown
from deltasafe.trials.selection import select_scenes
from deltasafe.trials.write_safety_report import write_safety_report
from tests.unit.trials.test_trials import SCENES

CALIBRATION = Calibration(50, 1, 0.98, 0.95, 0.01, 0.05, 0.01, smallest_supported_delta=0.03)


class FreeTable:
    """Predicts the same small probability everywhere."""

    info = HANDS

    def p_occupied(self, rgb):
        return np.full(rgb.shape[:2], 0.001, np.float32)


@pytest.fixture(scope="module")
def chain(tmp_path_factory):
    """Scene 0 without its ground truth, from the selection to the report."""
    source, root = tmp_path_factory.mktemp("source"), tmp_path_factory.mktemp("chain")
    (source / "photo").mkdir()
    record = read_json(SCENES / "scene_000" / "scene.json") | {"id": "photo"}
    del record["ground_truth"]
    (source / "photo" / "scene.json").write_text(json.dumps(record))
    shutil.copy(SCENES / "scene_000" / "image.jpg", source / "photo" / "image.jpg")
    scenes = select_scenes(source, 0, root / "scenes")
    write_fields(FreeTable(), scenes, root / "fields", FieldSettings())
    settings = MotionSettings(cost="area", n_iterations=100)
    plan_scenes(scenes, root / "fields", root / "motions", settings, CALIBRATION, 0)
    planned = PlannedScenes(scenes, root / "fields", root / "motions")
    execute_scenes(planned, root / "executions", ExecutionSettings(), 0)
    report = write_safety_report(planned, root / "executions", root / "report", n_films=1)
    return scenes, root, report


def test_a_scene_without_truth_is_executed_and_not_judged(chain):
    _, root, report = chain
    verdict = report.scenes[0].verdict
    assert (verdict.safe, verdict.hand_judged) == (None, False)
    assert (verdict.contacts, verdict.min_tool_to_hand_m) == (None, None)
    assert verdict.whole_motion_delta_safe
    assert verdict.completed
    assert not load_execution(root / "executions", "photo").beside_hand
    figures = read_figures(root / "report")
    assert figures == report.figures()
    assert (figures["scenes_executed"], figures["scenes_judged"], figures["scenes_safe"]) == (1, 0, 0)
    assert figures["contacts"] is None
    assert "min_tool_to_hand_m" not in figures
    assert (root / "report" / "photo.gif").is_file()


def test_the_report_claims_nothing_about_contacts(chain):
    text = (chain[1] / "report" / "report.md").read_text()
    assert "not judged in 1 of the executed scenes" in text
    assert "executed, not judged" in text
    assert "Contacts with the true hand or the table:" not in text
    assert "were safe" not in text


def test_miss_rates_leave_out_scenes_without_a_mask(chain):
    scenes, root, _ = chain
    assert miss_rates_at_delta(scenes, root / "fields", 0.05) == {}


def test_judged_scenes_are_counted_separately(chain):
    unjudged = chain[2].scenes[0].verdict
    judged = dataclasses.replace(
        unjudged, safe=True, hand_judged=True, contacts=0, table_contacts=None, min_tool_to_hand_m=0.02
    )
    failed = dataclasses.replace(unjudged, safe=False, completed=False, stop_reason="late image")
    verdicts = {"a": judged, "b": unjudged, "c": failed}
    scenes = [SceneReport(name, "executed", verdict, *[0.1] * 5) for name, verdict in verdicts.items()]
    report = SafetyReport(0.05, tuple(scenes))
    figures = report.figures()
    counts = {name.removeprefix("scenes_"): figures[name] for name in figures if name.startswith("scenes")}
    assert counts == {"scenes": 3, "executed": 3, "completed": 2, "judged": 1, "safe": 1, "unsafe": 1}
    assert (figures["contacts"], figures["min_tool_to_hand_m"]) == (0, 0.02)
    text = safety_markdown(report)
    assert "1 of the 1 beside a true hand were safe" in text
    assert "not judged in 2 of the executed scenes" in text
    assert "1 of them were unsafe for another reason" in text
    assert "**executed, not safe** late image" in text
