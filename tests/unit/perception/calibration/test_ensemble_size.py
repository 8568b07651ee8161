"""Table III: scores computed from the members' predictions, intervals computed by a loop."""

import re

import numpy as np
import pytest

from deltasafe.perception.calibration.ensemble_size import ensemble_size_rows, ensemble_size_table, ensemble_size_values
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.metrics import pool_scores, score_image
from deltasafe.perception.calibration.report import CalibrationSettings
from tests.unit.perception.calibration.calibration_cases import synthetic_ensemble

IMAGES = synthetic_ensemble(n_members=11, shape=(24, 32))
SETTINGS = CalibrationSettings(n_bootstrap=150, level=0.9, seed=3)


@pytest.fixture(scope="module")
def report():
    return evaluate(IMAGES, SETTINGS)


def images_of(n_members):
    means = [stack[:n_members].astype(float).mean(axis=0) for stack in IMAGES.predictions]
    return [score_image(p, label) for p, label in zip(means, IMAGES.labels, strict=True)]


def pooled_samples(images, draws, name):
    """A score over explicitly repeated images."""
    return np.array([getattr(pool_scores(np.repeat(images, draw).tolist()), name) for draw in draws])


def test_row_has_scores_and_bootstrap_intervals_of_the_first_members(report):
    rows = ensemble_size_rows(report)
    assert [row.n_members for row in rows] == list(range(1, 12))
    draws = np.random.default_rng(3).multinomial(6, [1 / 6] * 6, size=150)
    for m in (1, 4, 11):
        images, single = images_of(m), images_of(1)
        assert rows[m - 1].scores == pool_scores(images)
        for name in ("pixel_accuracy", "miou", "brier", "nll"):
            samples = pooled_samples(images, draws, name)
            low, high = np.quantile(samples, [0.05, 0.95])
            assert getattr(rows[m - 1].low, name) == pytest.approx(low, abs=1e-12)
            assert getattr(rows[m - 1].high, name) == pytest.approx(high, abs=1e-12)
            change = samples - pooled_samples(single, draws, name)
            low, high = np.quantile(change, [0.05, 0.95])
            assert getattr(rows[m - 1].change_low, name) == pytest.approx(low, abs=1e-12)
            assert getattr(rows[m - 1].change_high, name) == pytest.approx(high, abs=1e-12)


def test_members_with_independent_errors_improve_brier_and_nll(report):
    last = ensemble_size_rows(report)[-1]
    assert last.change_low.brier < last.change_high.brier < 0
    assert last.change_low.nll < last.change_high.nll < 0


def test_paper_values_exist_up_to_ten_members(report):
    rows = ensemble_size_rows(report)
    assert (rows[0].paper_brier, rows[0].paper_nll) == (0.0308, 0.180)
    assert (rows[9].paper_brier, rows[9].paper_nll) == (0.0234, 0.114)
    assert (rows[10].paper_brier, rows[10].paper_nll) == (None, None)


def test_values_contain_every_measure_of_every_size(report):
    values = ensemble_size_values(report)
    assert len(values) == 11 * 4 * 3 + 4
    assert values["nll_m11_as_used"] == report.final.predictor.scores.nll
    assert values["bs_m4"] == report.ensembles[3].scores.brier
    assert values["miou_m11"] == report.ensembles[10].scores.miou
    for short in ("pa", "miou", "bs", "nll"):
        assert values[f"{short}_m7_low"] <= values[f"{short}_m7"] <= values[f"{short}_m7_high"]


def test_table_has_the_units_of_the_paper(report):
    text, note = ensemble_size_table(report).split("\n\n")
    assert f"T = {report.final.temperature:.3f}" in note
    lines = text.splitlines()
    assert len(lines) == 2 + 11
    assert len({line.count("|") for line in lines}) == 1
    cells = [cell.strip() for cell in lines[2 + 9].strip("|").split("|")]
    last = report.ensembles[9].scores
    assert cells[0] == "10"
    assert (cells[1], cells[3]) == (f"**{1000 * last.brier:.1f}**", "23.4")
    assert (cells[4], cells[6]) == (f"**{100 * last.nll:.2f}**", "11.4")
    assert re.fullmatch(r"-\d+\.\d to [+-]\d+\.\d", cells[9])
