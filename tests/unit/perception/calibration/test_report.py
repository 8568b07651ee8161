"""The report as a folder, its text, and the gate before the freeze."""

import dataclasses
import json
import re

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.reliability import DELTA_GRID
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, gate
from deltasafe.perception.calibration.report_text import report_markdown
from deltasafe.perception.calibration.write_report import write_calibration_report
from deltasafe.perception.settings import GateThresholds
from tests.unit.perception.calibration.calibration_cases import synthetic_ensemble

IMAGES = synthetic_ensemble()
LABELS, PREDICTIONS = IMAGES.labels, IMAGES.predictions


@pytest.fixture(scope="module")
def report():
    return evaluate(IMAGES, CalibrationSettings(n_bootstrap=300))


def photograph(name):
    shape = LABELS[IMAGES.image_ids.index(name)].shape
    return np.random.default_rng(1).integers(0, 255, size=(*shape, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def folder(report, tmp_path_factory):
    destination = tmp_path_factory.mktemp("calibration") / "report"
    path = write_calibration_report(destination, report, IMAGES, photograph, n_examples=2)
    assert path == destination / "report.md"
    return destination


def test_loaded_report_equals_the_written_one(report, folder):
    assert CalibrationReport.load(folder) == report


def test_every_picture_is_linked_and_every_link_has_a_picture(folder):
    text = (folder / "report.md").read_text("utf-8")
    linked = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert sorted([*linked, "report.json", "report.md"]) == sorted(path.name for path in folder.iterdir())
    signatures = {".png": b"\x89PNG", ".jpg": b"\xff\xd8\xff"}
    for name in linked:
        assert (folder / name).read_bytes().startswith(signatures[(folder / name).suffix])


def test_text_states_the_figures_of_the_report(report, folder):
    text = (folder / "report.md").read_text("utf-8")
    scores = report.final.predictor.scores
    worst, best = (report.image_ids[report.worst_first[i]] for i in (0, -1))
    stated = (
        f"**{scores.miou:.4f}**",
        f"**{scores.nll:.4f}**",
        f"T = {report.calibrated.temperature:.3f}",
        f"support is {report.smallest_supported_delta:g}",
        f"`{worst}`",
        f"`{best}`",
        "n = 3",
        "0.0234",
        "0.114",
        "1e-7",
        "nor of a whole motion",
        "**under-confident**",
        f"{report.final.predictor.errors.signed:+.4f}",
        f"{report.final.held_out_delta.occupied_fraction:.3%}",
        f"1 / (6 + 1) = {1 / 7:.2%}",
        "Each image is evaluated with a T fitted without it",
        f"`{report.image_ids[next(iter(report.missed_hand_rates))]}`",
    )
    assert [part for part in stated if part not in text] == []
    for table in re.findall(r"(?:^\|.*\n)+", text, flags=re.M):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_report_without_images_has_no_overlays_and_no_dead_links(report, tmp_path):
    write_calibration_report(tmp_path / "r", report, IMAGES)
    assert not list((tmp_path / "r").glob("*.jpg"))
    assert ".jpg" not in (tmp_path / "r" / "report.md").read_text("utf-8")


def test_failed_write_keeps_the_old_report(report, folder):
    def broken(name):
        raise OSError("no such photograph")

    before = sorted(folder.iterdir())
    with pytest.raises(OSError, match="no such photograph"):
        write_calibration_report(folder, report, IMAGES, broken)
    assert sorted(folder.iterdir()) == before
    assert CalibrationReport.load(folder) == report
    fewer = LabeledPredictions(IMAGES.image_ids[:5], LABELS[:5], PREDICTIONS[:5])
    with pytest.raises(SettingsError, match=r"6 images, got .* of 5 others"):
        write_calibration_report(folder, report, fewer)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"format_version": 3', '"format_version": 99', "format version 99"),
        ('"n_bootstrap": 300', '"n_bootstrap": "300"', "expected int"),
        ('"n_bootstrap": 300', '"surplus": 300', "surplus"),
        ('"image_ids"', '"names"', "names"),
        ("{", "[", "JSON"),
    ],
)
def test_damaged_and_older_reports_are_refused(folder, tmp_path, old, new, match):
    with pytest.raises(DataError, match="missing"):
        CalibrationReport.load(tmp_path)
    text = (folder / "report.json").read_text()
    assert old in text
    (tmp_path / "report.json").write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=match):
        CalibrationReport.load(tmp_path)


def test_gate_passes_at_the_thresholds_and_fails_beyond_each(report):
    scores = report.final.predictor.scores
    delta = report.smallest_supported_delta
    worst = max(image.missed_hand_rate for image in report.images)
    exact = GateThresholds(scores.pixel_accuracy, scores.miou, worst)
    planned = dataclasses.replace(report, settings=dataclasses.replace(report.settings, planning_delta=delta))
    assert gate(planned, exact) == []
    smaller = dataclasses.replace(report, settings=dataclasses.replace(report.settings, planning_delta=0.99 * delta))
    assert [failure.startswith("the smallest supported delta") for failure in gate(smaller, exact)] == [True]
    for name, value, word in (
        ("pixel_accuracy", scores.pixel_accuracy + 1e-6, "pixel accuracy"),
        ("miou", scores.miou + 1e-6, "mIoU"),
        ("missed_hand_rate", worst - 1e-9, "is missed"),
    ):
        failures = gate(planned, dataclasses.replace(exact, **{name: value}))
        assert len(failures) == 1
        assert word in failures[0]


def test_gate_fails_without_a_supported_delta(report):
    unsupported = tuple(dataclasses.replace(row, supported=False) for row in report.final.support)
    result = dataclasses.replace(report.final, support=unsupported)
    failures = gate(dataclasses.replace(report, calibrated=result), GateThresholds(0.0, 0.0))
    assert failures == ["the images support no delta, planning needs 0.05"]


@pytest.mark.parametrize(
    "settings",
    [
        {"n_bootstrap": 10},
        {"level": 1.0},
        {"level": 0.5},
        {"n_folds": 1},
        {"n_folds": -1},
        {"missed_hand_alpha": 0.0},
        {"missed_hand_alpha": 1.0},
    ],
)
def test_settings_outside_their_domain_are_refused(settings):
    with pytest.raises(SettingsError, match=next(iter(settings))):
        CalibrationSettings(**settings)


def test_thresholds_outside_their_domain_are_refused():
    with pytest.raises(SettingsError, match="miou"):
        GateThresholds(miou=80.0)


def test_report_that_was_stored_before_the_margins_is_read_without_them(folder, tmp_path):
    value = json.loads((folder / "report.json").read_text())
    for name in ("calibrated", "uncalibrated"):
        for field in ("hausdorff_at_delta", "calibration_hausdorff_at_delta"):
            del value[name][field]
    (tmp_path / "report.json").write_text(json.dumps(value))
    older = CalibrationReport.load(tmp_path)
    assert older.final.margins is None
    assert older.calibration.conformal_margins is None
    write_calibration_report(tmp_path / "again", older, IMAGES, photograph)
    assert "margin" not in (tmp_path / "again" / "report.md").read_text("utf-8")


def test_text_states_margins_and_their_coverage(report, folder):
    text = (folder / "report.md").read_text("utf-8")
    margins = report.final.margins
    margin = margins.margin(0.05, 0.2)
    low, high = margin.coverage_interval()
    assert margins.shown_alphas == (0.2,)
    assert f"| 0.05 | {margin.px:.1f} |" in text
    assert f"| 20% | 6 of 6 | {6 / 7:.1%} | {low:.1%} to {high:.1%} |" in text
    assert f"1 / (6 + 1) = {1 / 7:.2%}" in text
    assert f"the hand in `{report.image_ids[report.farthest_missed]}` extends farthest" in text
    assert "fitted on the 6 test images, so that no image is left to measure the coverage on" in text
    assert "The planner keeps it if `motion_alpha` is set" in text


def test_text_counts_the_covered_test_images_if_margins_have_images_of_their_own():
    report = evaluate(IMAGES, CalibrationSettings(n_bootstrap=100), synthetic_ensemble(n_images=9, seed=5))
    margin = report.final.margins.margin(0.05, 0.2)
    n_covered = sum(row[DELTA_GRID.index(0.05)] <= margin.fraction_of_width for row in report.final.hausdorff_at_delta)
    text = report_markdown(report, [])
    assert re.search(rf"\| 20% \| 8 of 9 \| 80.0% \| [^|]+ \| {n_covered} of 6 \([\d.]+% to [\d.]+%\) \|", text)
    assert "fitted on the 9 calibration images, and evaluated on the 6 test images" in text


def test_text_names_the_calibration_set_and_an_unused_temperature():
    settings = CalibrationSettings(n_bootstrap=100, recalibrate=False)
    further = synthetic_ensemble(n_images=4, seed=9)
    text = report_markdown(evaluate(IMAGES, settings, further), [])
    assert "fitted on **4 further images** and evaluated on these 6" in text
    assert "uncalibrated, with T = 1" in text
    assert "calibrated by a temperature" not in text
    single = LabeledPredictions(IMAGES.image_ids[:1], LABELS[:1], PREDICTIONS[:1])
    alone = report_markdown(evaluate(single, settings), [])
    assert "No temperature was fitted" in alone
    assert "no fit supports a delta" not in alone


def test_examples_contain_the_worst_image_of_every_ranking(report):
    chosen = report.worst_examples(3)
    assert len(set(chosen)) == 3
    assert chosen[0] == report.worst_first[0]
    rates = [image.missed_hand_rate for image in report.images]
    assert int(np.argmax(rates)) in chosen
    at_delta = [fractions[DELTA_GRID.index(0.05)] for fractions in report.final.missed_at_delta]
    assert int(np.argmax(at_delta)) in chosen
    assert sorted(report.worst_examples(100)) == list(range(6))


@pytest.mark.parametrize(("planning_delta", "grid_delta"), [(0.05, 0.05), (0.04, 0.05), (1e-5, 1e-4), (0.9, 0.5)])
def test_planning_delta_is_rounded_up_within_the_grid(report, planning_delta, grid_delta):
    settings = dataclasses.replace(report.settings, planning_delta=planning_delta)
    missed = dataclasses.replace(report, settings=settings).missed_at_planning_delta
    column = DELTA_GRID.index(grid_delta)
    assert missed == {i: row[column] for i, row in enumerate(report.final.missed_at_delta)}


def test_missed_hands_are_sorted_and_images_without_a_hand_left_out():
    labels = [*LABELS[:3], np.zeros_like(LABELS[3])]
    images = LabeledPredictions(IMAGES.image_ids[:4], labels, PREDICTIONS[:4])
    report = evaluate(images, CalibrationSettings(n_bootstrap=100))
    missed = report.missed_hand_rates
    assert missed == {i: report.images[i].missed_hand_rate for i in range(3)}
    assert list(missed.values()) == sorted(missed.values(), reverse=True)
    assert report.final.missed_at_delta[3] is None
    assert report.risk_control.n_images == 3
