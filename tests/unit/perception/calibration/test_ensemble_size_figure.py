"""The figures of Fig. 4 and Table III draw the values of the report."""

import numpy as np
import pytest

from deltasafe.perception.calibration.ensemble_size_figure import ensemble_reliability_figure, ensemble_size_figure
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.paper_results import ENSEMBLE_SIZE_RESULTS, RELIABILITY_RESULTS
from deltasafe.perception.calibration.report import CalibrationSettings
from tests.unit.perception.calibration.test_reliability_figure import lines, report


def test_figure_4_draws_three_sizes_five_members_and_the_curves_of_the_paper():
    result = report(11)
    ours, paper, counts, _ = ensemble_reliability_figure(result).axes
    drawn = [np.asarray(line.get_xydata()) for line in ours.get_lines()]

    def shows(curves, stated, observed):
        return any(c.shape == (len(stated), 2) and np.allclose(c.T, [stated, observed]) for c in curves)

    for m in (2, 5, 10):
        curve = result.ensembles[m - 1].reliability
        assert shows(drawn, curve.predicted, curve.observed)
        assert shows(drawn, *RELIABILITY_RESULTS[m])
        assert shows([np.asarray(line.get_xydata()) for line in paper.get_lines()], *RELIABILITY_RESULTS[m])
    for index, member in enumerate(result.members):
        assert shows(drawn, member.reliability.predicted, member.reliability.observed) == (index < 5)
    heights = [bar.get_height() for bar in counts.patches]
    count = np.concatenate([result.ensembles[m - 1].reliability.count for m in (2, 5, 10)])
    np.testing.assert_allclose(heights, count / result.n_pixels)
    styles = sorted(line.get_linestyle() for line in paper.get_lines())
    assert styles == 8 * ["--"] + [":"]


@pytest.mark.parametrize(("n_members", "sharpness"), [(1, 1.0), (2, 50.0), (11, 0.01)])
def test_both_figures_can_be_drawn_for_any_ensemble_size(n_members, sharpness, tmp_path):
    result = report(n_members, sharpness=sharpness)
    for draw in (ensemble_reliability_figure, ensemble_size_figure):
        draw(result).savefig(tmp_path / "picture.png", dpi=40)


def test_a_perfect_ensemble_can_be_drawn(tmp_path):
    label = np.zeros((8, 9), bool)
    label[2:5] = True
    p_occupied = np.stack([label, label]).astype(np.float32)
    images = LabeledPredictions(["a", "b"], [label] * 2, [p_occupied] * 2)
    result = evaluate(images, CalibrationSettings(n_bootstrap=100))
    for draw in (ensemble_reliability_figure, ensemble_size_figure):
        draw(result).savefig(tmp_path / "picture.png", dpi=40)


def test_scores_by_ensemble_size_are_those_of_the_report():
    result = report(3)
    figure = ensemble_size_figure(result)
    for column, (axes, name) in enumerate(zip(figure.axes, ("brier", "nll"), strict=True)):
        drawn = lines(axes)
        ours = next(data for label, data in drawn.items() if "first $M$ members" in label)
        np.testing.assert_allclose(ours[:, 1], [getattr(ensemble.scores, name) for ensemble in result.ensembles])
        printed = [ENSEMBLE_SIZE_RESULTS[m][column] for m in (1, 2, 3)]
        np.testing.assert_allclose(drawn["paper, Table III"][:, 1], printed)
