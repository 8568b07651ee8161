"""The report as a folder: what is written is what is read, and the gate before the freeze."""

import base64
import dataclasses
import re

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.reliability import DELTA_GRID
from deltasafe.perception.calibration.report import (
    CalibrationReport,
    CalibrationSettings,
    GateThresholds,
    gate,
)
from deltasafe.perception.calibration.report_text import report_markdown
from deltasafe.perception.calibration.write_report import inline_pictures, write_calibration_report
from tests.unit.perception.calibration.calibration_cases import synthetic_ensemble

NAMES, LABELS, PREDICTIONS = synthetic_ensemble()


@pytest.fixture(scope="module")
def report():
    return evaluate(NAMES, LABELS, PREDICTIONS, CalibrationSettings(n_bootstrap=300))


def photograph(name):
    shape = LABELS[NAMES.index(name)].shape
    return np.random.default_rng(1).integers(0, 255, size=(*shape, 3), dtype=np.uint8)


@pytest.fixture(scope="module")
def folder(report, tmp_path_factory):
    destination = tmp_path_factory.mktemp("calibration") / "report"
    path = write_calibration_report(
        destination, report, labels=LABELS, predictions=PREDICTIONS, load_image=photograph, n_examples=2
    )
    assert path == destination / "report.md"
    return destination


def test_what_is_written_is_what_is_loaded(report, folder):
    assert CalibrationReport.load(folder) == report


def test_every_picture_is_linked_and_every_link_is_a_picture(folder):
    text = (folder / "report.md").read_text("utf-8")
    linked = re.findall(r"!\[[^\]]*\]\(([^)]+)\)", text)
    assert sorted([*linked, "report.json", "report.md"]) == sorted(path.name for path in folder.iterdir())
    signatures = {".png": b"\x89PNG", ".jpg": b"\xff\xd8\xff"}
    for name in linked:
        assert (folder / name).read_bytes().startswith(signatures[(folder / name).suffix])


def test_the_text_states_what_a_reader_must_know(report, folder):
    text = (folder / "report.md").read_text("utf-8")
    scores = report.final.predictor.scores
    worst, best = (report.image_ids[report.worst_first[i]] for i in (0, -1))
    stated = (
        f"**{scores.miou:.4f}**",
        f"**{scores.nll:.4f}**",
        f"T = {report.recalibrated.temperature:.3f}",
        f"support is {report.smallest_supported_delta:g}",
        f"`{worst}`",
        f"`{best}`",
        "n = 3",
        "0.0234",
        "0.114",
        "1e-7",
        "nor of a whole motion",
        "under-confident" if report.as_it_is.predictor.errors.signed_high < 0 else "confident",
        f"{report.final.predictor.errors.signed:+.4f}",
        f"{report.final.held_out_delta.occupied_share:.3%}",
        f"1 / (6 + 1) = {1 / 7:.2%}",
        "Every image is judged with a T that was fitted without it",
        f"`{report.image_ids[report.most_missed_first[0]]}`",
    )
    assert [part for part in stated if part not in text] == []
    for table in re.findall(r"(?:^\|.*\n)+", text, flags=re.M):
        assert len({line.count("|") for line in table.splitlines()}) == 1


def test_without_photographs_there_are_no_overlays_and_no_dead_links(report, tmp_path):
    write_calibration_report(tmp_path / "r", report, labels=LABELS, predictions=PREDICTIONS)
    assert not list((tmp_path / "r").glob("*.jpg"))
    assert ".jpg" not in (tmp_path / "r" / "report.md").read_text("utf-8")


def test_inlined_pictures_are_the_pictures(folder):
    text = inline_pictures(folder / "report.md", limit_bytes=4_000_000)
    data = re.findall(r"\(data:image/(?:png|jpeg);base64,([^)]+)\)", text)
    assert {base64.b64decode(item) for item in data} == {
        path.read_bytes() for path in folder.iterdir() if path.suffix in (".png", ".jpg")
    }
    assert len(inline_pictures(folder / "report.md").encode()) <= 1_000_000


def test_a_small_limit_leaves_pictures_out_and_says_so(folder):
    text = inline_pictures(folder / "report.md", limit_bytes=20_000)
    assert "base64" not in text
    assert "see `reliability.png` in the report's folder" in text
    with pytest.raises(DataError, match="missing"):
        inline_pictures(folder / "other.md")


def test_a_failure_leaves_the_old_report_in_place(report, folder):
    def broken(name):
        raise OSError("no such photograph")

    before = sorted(folder.iterdir())
    with pytest.raises(OSError, match="no such photograph"):
        write_calibration_report(folder, report, labels=LABELS, predictions=PREDICTIONS, load_image=broken)
    assert sorted(folder.iterdir()) == before
    assert CalibrationReport.load(folder) == report
    with pytest.raises(SettingsError, match="6 images, got 5 labels"):
        write_calibration_report(folder, report, labels=LABELS[:5], predictions=PREDICTIONS)


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        ('"format_version": 2', '"format_version": 99', "format version 99"),
        ('"n_bootstrap": 300', '"n_bootstrap": "300"', "expected int"),
        ('"n_bootstrap": 300', '"surplus": 300', "surplus"),
        ('"image_ids"', '"names"', "names"),
        ("{", "[", "JSON"),
    ],
)
def test_damaged_reports_are_refused(folder, tmp_path, old, new, match):
    with pytest.raises(DataError, match="missing"):
        CalibrationReport.load(tmp_path)
    text = (folder / "report.json").read_text()
    assert old in text
    (tmp_path / "report.json").write_text(text.replace(old, new, 1))
    with pytest.raises(DataError, match=match):
        CalibrationReport.load(tmp_path)


def test_the_gate_opens_at_the_thresholds_and_closes_above(report):
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


def test_the_gate_is_closed_when_no_delta_is_supported(report):
    unsupported = tuple(dataclasses.replace(row, supported=False) for row in report.final.support)
    judgment = dataclasses.replace(report.final, support=unsupported)
    failures = gate(dataclasses.replace(report, recalibrated=judgment), GateThresholds(0.0, 0.0))
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


def test_the_text_says_where_the_calibration_images_are_and_what_is_used():
    names, labels, predictions = synthetic_ensemble(n_images=4, seed=9)
    settings = CalibrationSettings(n_bootstrap=100, recalibrate=False)
    further = LabeledPredictions(names, labels, predictions)
    text = report_markdown(evaluate(NAMES, LABELS, PREDICTIONS, settings, calibration=further), [])
    assert "fitted on **4 further images** and judged on these 6" in text
    assert "as it is, with T = 1" in text
    assert "recalibrated by a temperature" not in text
    alone = report_markdown(evaluate(NAMES[:1], LABELS[:1], PREDICTIONS[:1], settings), [])
    assert "One image is too few to fit anything" in alone
    assert "no part of the images" not in alone


def test_examples_show_every_way_to_fail(report):
    chosen = report.worst_examples(3, 0.05)
    assert len(set(chosen)) == 3
    assert chosen[0] == report.worst_first[0]
    assert report.most_missed_first[0] in chosen
    taken = [shares[DELTA_GRID.index(0.05)] for shares in report.final.taken_for_free]
    assert int(np.argmax(taken)) in chosen
    assert report.worst_examples(100, 0.9)[0] == report.worst_first[0]
    assert sorted(report.worst_examples(100, 0.9)) == list(range(6))


def test_most_missed_images_come_first_and_images_without_a_hand_not_at_all():
    labels = [*LABELS[:3], np.zeros_like(LABELS[3])]
    report = evaluate(NAMES[:4], labels, PREDICTIONS[:4], CalibrationSettings(n_bootstrap=100))
    order = report.most_missed_first
    assert sorted(order) == [0, 1, 2]
    rates = [report.images[i].missed_hand_rate for i in order]
    assert rates == sorted(rates, reverse=True)
    assert report.final.taken_for_free[3] is None
    assert report.risk_control.n_images == 3
