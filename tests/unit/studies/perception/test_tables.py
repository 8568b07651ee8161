"""Tables I and II and the ablation: scores, paired bootstrap, and reports with missing cells."""

import dataclasses
import json
import pathlib

import numpy as np
import pytest

from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.paper_results import AUGMENTATION_RESULTS
from deltasafe.perception.calibration.reliability import bootstrap_weights
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings
from deltasafe.studies.perception import StudySettings
from deltasafe.studies.perception.report import study_values, write_study
from deltasafe.studies.perception.tables import ablation_rows, missing_cells, ours_is_best, scheme_rows

SETTINGS = StudySettings(n_members=2, n_members_most=3, n_members_ablation=2, left_out=("flip", "noise"))
CALIBRATION = CalibrationSettings(n_bootstrap=100)
N = 5


def report(noise: float, n_members: int = 3, seed: int = 0) -> CalibrationReport:
    """The report of members whose logits have Gaussian noise of scale ``noise``."""
    rng = np.random.default_rng(seed)
    masks = [rng.random((12, 16)) < 0.3 + 0.1 * k for k in range(N)]
    draws = np.random.default_rng(seed + 1).normal(size=(N, n_members, 12, 16))
    logits = [4.0 * (2 * mask - 1) + noise * draws[k] for k, mask in enumerate(masks)]
    stacks = [(1 / (1 + np.exp(-values))).astype(np.float32) for values in logits]
    return evaluate(LabeledPredictions([f"image_{k}" for k in range(N)], masks, stacks), CALIBRATION)


@pytest.fixture(scope="module")
def reports() -> dict[str, CalibrationReport]:
    ours, others = report(2.0), report(4.0)
    return {cell.name: ours if cell.scheme == "ours" and not cell.left_out else others for cell in SETTINGS.cells()}


def test_rows_have_the_scores_of_the_first_members_and_their_mean(reports) -> None:
    rows = scheme_rows(SETTINGS, reports)
    assert [(row.cell.n_images, row.cell.scheme) for row in rows] == [
        (printed.n_images, printed.scheme) for printed in AUGMENTATION_RESULTS
    ]
    assert {row.cell.n_members for row in rows} == {2}, "the same M in every row, though ours has more"
    for row in rows:
        whole = reports[row.cell.name]
        pa = [member.scores.pixel_accuracy for member in whole.members[:2]]
        assert row.members.mean.pixel_accuracy == pytest.approx(np.mean(pa))
        assert row.members.sd.pixel_accuracy == pytest.approx(np.std(pa, ddof=1))
        assert row.ensemble == whole.ensembles[1].scores
        assert (row.low, row.high) == (whole.ensembles[1].low, whole.ensembles[1].high)
        assert row.paper == next(
            p for p in AUGMENTATION_RESULTS if (p.scheme, p.n_images) == (row.cell.scheme, row.cell.n_images)
        )
        assert row.table_scores.pixel_accuracy == row.members.mean.pixel_accuracy
        assert row.table_scores.nll == row.ensemble.nll


def test_lead_is_a_paired_bootstrap_over_images(reports) -> None:
    """Against scores pooled over explicitly repeated images."""
    row = next(row for row in scheme_rows(SETTINGS, reports) if row.cell.name == "mixup-200")
    ours, other = reports["ours-200"], reports["mixup-200"]
    leads = []
    for weights in bootstrap_weights(N, CALIBRATION.n_bootstrap, CALIBRATION.seed):
        chosen = np.repeat(np.arange(N), weights)
        nll = [np.mean([r.ensembles[1].images[k].nll for k in chosen]) for r in (ours, other)]
        pa = [np.mean([[m.images[k].pixel_accuracy for k in chosen] for m in r.members[:2]]) for r in (ours, other)]
        leads.append((pa[0] - pa[1], nll[1] - nll[0]))
    low, high = np.quantile(leads, [0.025, 0.975], axis=0)
    assert (row.lead_low.pixel_accuracy, row.lead_low.nll) == pytest.approx(tuple(low))
    assert (row.lead_high.pixel_accuracy, row.lead_high.nll) == pytest.approx(tuple(high))
    assert all(value > 0 for value in dataclasses.astuple(row.lead_low))
    assert all(r.lead_low is None for r in scheme_rows(SETTINGS, reports) if r.cell.scheme == "ours")


def test_ours_is_best_only_if_it_wins_in_every_cell(reports) -> None:
    assert ours_is_best(scheme_rows(SETTINGS, reports), SETTINGS) is True
    better_once = {**reports, "cutout-200": report(1.0)}
    assert ours_is_best(scheme_rows(SETTINGS, better_once), SETTINGS) is False
    tie = {**reports, "cutout-200": reports["ours-200"]}
    assert ours_is_best(scheme_rows(SETTINGS, tie), SETTINGS) is False
    missing = {name: value for name, value in reports.items() if name != "cutout-200"}
    assert ours_is_best(scheme_rows(SETTINGS, missing), SETTINGS) is None


def test_leaving_out_a_helpful_method_is_a_loss_in_all_measures(reports) -> None:
    rows = ablation_rows(SETTINGS, reports)
    assert [row.cell.left_out for row in rows] == ["flip", "noise"]
    whole, without = reports["ours-1000"], reports["ours-1000-without-flip"]
    assert rows[0].loss.nll == pytest.approx(without.ensembles[1].scores.nll - whole.ensembles[1].scores.nll)
    pa = [np.mean([m.scores.pixel_accuracy for m in r.members[:2]]) for r in (whole, without)]
    assert rows[0].loss.pixel_accuracy == pytest.approx(pa[0] - pa[1])
    assert all(value > 0 for value in dataclasses.astuple(rows[0].loss_low))
    alone = {"ours-1000-without-flip": without}
    assert ablation_rows(SETTINGS, alone)[0].loss is None


def test_report_shows_finished_cells_and_names_missing_ones(reports, tmp_path: pathlib.Path) -> None:
    text = write_study(tmp_path / "all", SETTINGS, reports).read_text()
    assert "Not finished" not in text
    assert "beats every other in all four measures" in text
    pictures = {"schemes.png", "table-3.png", "figure-4.png", "ablation.png"}
    assert {path.name for path in (tmp_path / "all").iterdir()} == {"report.md", *pictures}
    assert all(f"({name})" in text for name in pictures)
    for row in scheme_rows(SETTINGS, reports):
        mean, sd = 1e2 * row.members.mean.pixel_accuracy, 1e2 * row.members.sd.pixel_accuracy
        assert (f"| **{mean:.1f} ± {sd:.1f}** |" if row.cell.scheme == "ours" else f"| {mean:.1f} ± {sd:.1f} |") in text
    assert "88.2 ± 0.9" in text, "the paper's values are beside ours"

    few = {"ours-200": reports["ours-200"], "mixup-200": reports["mixup-200"]}
    text = write_study(tmp_path / "few", SETTINGS, few).read_text()
    assert "Not finished yet: cutout-200, flip_rotate90-200," in text
    assert "beats" not in text
    text = write_study(tmp_path / "none", SETTINGS, {}, ["ensemble_size", "ablation"]).read_text()
    assert "Not finished yet: ours-1000." in text
    assert "Augmentation schemes" not in text


def test_values_are_those_of_the_tables_and_only_of_finished_cells(reports) -> None:
    values = study_values(SETTINGS, reports)
    assert json.loads(json.dumps(values)) == values
    row = scheme_rows(SETTINGS, reports)[1]
    assert values["mixup_200_pa"] == row.members.mean.pixel_accuracy
    assert values["mixup_200_bs"] == row.ensemble.brier
    assert values["mixup_200_nll_low"] == row.low.nll
    assert values["nll_m3"] == reports["ours-1000"].ensembles[2].scores.nll
    assert values["without_flip_bs_loss"] == ablation_rows(SETTINGS, reports)[0].loss.brier
    assert values["ours_best_in_all_cells"] is True
    few = study_values(SETTINGS, {"mixup-200": reports["mixup-200"]})
    assert {name.rsplit("_", 1)[0][:9] for name in few} == {"mixup_200"}


def test_missing_cells_are_named_in_order(reports) -> None:
    assert missing_cells(SETTINGS.cells(), {}) == tuple(cell.name for cell in SETTINGS.cells())
    assert missing_cells(SETTINGS.cells(), reports) == ()
