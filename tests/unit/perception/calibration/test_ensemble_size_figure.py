"""Fig. 4 and Table III as pictures show what the report says."""

import numpy as np
import pytest

from deltasafe.perception.calibration.ensemble_size_figure import ensemble_reliability_figure, ensemble_size_figure
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.paper_results import ENSEMBLE_SIZE_RESULTS, RELIABILITY_RESULTS
from deltasafe.perception.calibration.report import CalibrationSettings
from tests.unit.perception.calibration.test_reliability_figure import lines, report


def test_figure_4_shows_three_sizes_five_members_and_the_paper_s_own_curves():
    result = report(11)
    ours, theirs, counts, _ = ensemble_reliability_figure(result).axes
    drawn = [np.asarray(line.get_xydata()) for line in ours.get_lines()]

    def shows(curves, stated, observed):
        return any(c.shape == (len(stated), 2) and np.allclose(c.T, [stated, observed]) for c in curves)

    for m in (2, 5, 10):
        curve = result.ensembles[m - 1].reliability
        assert shows(drawn, curve.stated, curve.observed)
        assert shows(drawn, *RELIABILITY_RESULTS[m])
        assert shows([np.asarray(line.get_xydata()) for line in theirs.get_lines()], *RELIABILITY_RESULTS[m])
    for index, member in enumerate(result.members):
        assert shows(drawn, member.reliability.stated, member.reliability.observed) == (index < 5)
    assert len(theirs.get_lines()) == 1 + 5 + 3
    heights = [bar.get_height() for bar in counts.patches]
    count = np.concatenate([result.ensembles[m - 1].reliability.count for m in (2, 5, 10)])
    np.testing.assert_allclose(heights, count / result.n_pixels)
    assert {line.get_linestyle() for line in theirs.get_lines()[1:]} == {"--"}


@pytest.mark.parametrize(("n_members", "sharpness"), [(1, 1.0), (2, 50.0), (11, 0.01)])
def test_both_pictures_are_drawn_for_any_ensemble(n_members, sharpness, tmp_path):
    result = report(n_members, sharpness=sharpness)
    for draw in (ensemble_reliability_figure, ensemble_size_figure):
        draw(result).savefig(tmp_path / "picture.png", dpi=40)
        assert (tmp_path / "picture.png").stat().st_size > 1000


def test_a_perfect_ensemble_can_be_drawn(tmp_path):
    label = np.zeros((8, 9), bool)
    label[2:5] = True
    p_occupied = np.stack([label, label]).astype(np.float32)
    result = evaluate(["a", "b"], [label] * 2, [p_occupied] * 2, CalibrationSettings(n_bootstrap=100))
    for draw in (ensemble_reliability_figure, ensemble_size_figure):
        draw(result).savefig(tmp_path / "picture.png", dpi=40)


def test_the_gain_by_ensemble_size_is_that_of_the_report():
    result = report(3)
    figure = ensemble_size_figure(result)
    for column, (axes, name) in enumerate(zip(figure.axes, ("brier", "nll"), strict=True)):
        drawn = lines(axes)
        ours = next(data for label, data in drawn.items() if "first $M$ members" in label)
        np.testing.assert_allclose(ours[:, 1], [getattr(ensemble.scores, name) for ensemble in result.ensembles])
        paper = [ENSEMBLE_SIZE_RESULTS[m][column] for m in (1, 2, 3)]
        np.testing.assert_allclose(drawn["paper, Table III"][:, 1], paper)
