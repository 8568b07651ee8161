"""Images without a hand: every figure that is about hands is the same with and without them."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.io.storage import write_json
from deltasafe.perception.calibration.conformal_margin import hausdorff_at_delta
from deltasafe.perception.calibration.delta_support import (
    cumulative_safety_counts,
    delta_support,
    held_out_support,
    smallest_supported_delta,
)
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.metrics import score_image
from deltasafe.perception.calibration.reliability import safety_counts, stack_counts
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, GateThresholds, gate
from deltasafe.perception.calibration.report_text import report_markdown
from deltasafe.perception.calibration.write_report import write_calibration_report
from tests.unit.perception.calibration.calibration_cases import synthetic_ensemble

FAST = CalibrationSettings(n_bootstrap=100, recalibrate=False, n_folds=2)
IMAGES = synthetic_ensemble()
SHAPE = IMAGES.labels[0].shape


def with_tables(p_occupied: list[float]) -> LabeledPredictions:
    """The images, and one of an empty table for each probability."""
    names = [f"table_{i}" for i in range(len(p_occupied))]
    tables = [np.full((len(IMAGES.predictions[0]), *SHAPE), p) for p in p_occupied]
    return LabeledPredictions(
        [*IMAGES.image_ids, *names],
        [*IMAGES.labels, *(np.zeros(SHAPE, np.uint8) for _ in names)],
        [*IMAGES.predictions, *tables],
    )


def only_tables(n: int) -> LabeledPredictions:
    everything = with_tables([0.01] * n)
    return LabeledPredictions(everything.image_ids[-n:], everything.labels[-n:], everything.predictions[-n:])


def counts_of(images: LabeledPredictions):
    return stack_counts([safety_counts(*images.pooled(i)[:2]) for i in range(len(images))])


@settings(max_examples=20, deadline=None)
@given(tables=st.lists(st.floats(0, 1), min_size=1, max_size=9))
def test_support_of_delta_does_not_depend_on_tables(tables: list[float]) -> None:
    alone, mixed = counts_of(IMAGES), counts_of(with_tables(tables))
    assert delta_support(mixed, n_bootstrap=200) == delta_support(alone, n_bootstrap=200)
    every = np.arange(len(mixed.count))
    held_out = held_out_support(mixed, [mixed], [every], n_bootstrap=200)
    assert held_out == held_out_support(alone, [alone], [np.arange(len(alone.count))], n_bootstrap=200)


def test_tables_alone_support_no_delta() -> None:
    """Without a hand nothing can be missed, which is no evidence that hands are seen."""
    rows = delta_support(counts_of(only_tables(50)))
    assert smallest_supported_delta(rows) is None
    assert {row.upper_bound for row in rows} == {1.0}
    free, missed = cumulative_safety_counts(counts_of(only_tables(50)))
    assert not missed.any()
    assert free.all(axis=0)[-1]


def test_report_of_tables_alone_certifies_nothing_and_is_written(tmp_path) -> None:
    images = only_tables(6)
    report = evaluate(images, FAST)
    assert report.smallest_supported_delta is None
    assert report.final.margins is None
    assert report.farthest_missed is None
    assert report.risk_control.threshold is None
    assert any("support no delta" in reason for reason in gate(report, GateThresholds()))
    text = write_calibration_report(tmp_path / "r", report, images).read_text("utf-8")
    assert "No image shows a hand" in text
    assert CalibrationReport.load(tmp_path / "r") == report
    assert report.calibration.conformal_margins is None


def test_figures_about_hands_are_those_of_the_images_with_a_hand(tmp_path) -> None:
    images = with_tables([0.01, 0.2, 0.9])
    alone, mixed = evaluate(IMAGES, FAST), evaluate(images, FAST)
    assert mixed.final.margins == alone.final.margins
    assert mixed.final.support == alone.final.support
    assert mixed.missed_hand_rates == alone.missed_hand_rates
    assert mixed.missed_at_planning_delta == alone.missed_at_planning_delta
    assert mixed.risk_control.n_images == len(IMAGES)
    assert mixed.risk_control.threshold == alone.risk_control.threshold
    assert mixed.farthest_missed == alone.farthest_missed
    assert mixed.final.hausdorff_at_delta[-1] is None
    assert np.isnan(mixed.final.hausdorff_at(0.05)[-3:]).all()
    text = report_markdown(mixed, [])
    assert "3 of these images show no hand" in text
    assert "33.333% of the pixels are false alarms (p >= 0.5), and 100.000% in the worst, `table_2`" in text
    write_json(tmp_path / "report.json", mixed)
    assert CalibrationReport.load(tmp_path) == mixed
    assert "show no hand" not in report_markdown(alone, [])


def test_coverage_of_a_margin_counts_test_images_with_a_hand() -> None:
    images = with_tables([0.01])
    report = evaluate(images, FAST, calibration=dataclasses.replace(IMAGES))
    text = report_markdown(report, [])
    assert f" of {len(IMAGES)} (" in text
    assert f" of {len(images)} (" not in text


@pytest.mark.parametrize(("p_table", "miou", "false_alarms"), [(0.1, 1.0, 0.0), (0.9, 0.0, 1.0)])
def test_scores_of_a_table(p_table: float, miou: float, false_alarms: float) -> None:
    scores = score_image(np.full(SHAPE, p_table), np.zeros(SHAPE, bool))
    assert (scores.miou, scores.false_alarm_rate, scores.missed_hand_rate) == (miou, false_alarms, None)
    assert (hausdorff_at_delta(np.full(SHAPE, p_table), np.zeros(SHAPE, bool)) == 0.0).all()


def test_one_false_alarm_halves_the_miou_of_a_table() -> None:
    p_occupied = np.zeros(SHAPE)
    p_occupied[0, 0] = 1.0
    assert score_image(p_occupied, np.zeros(SHAPE, bool)).miou == pytest.approx(0.5, abs=1e-3)
