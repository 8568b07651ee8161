"""The figure of missed hands draws the values of the report."""

import numpy as np
import pytest

from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.missed_hands_figure import missed_hands_figure
from deltasafe.perception.calibration.reliability import DELTA_GRID
from deltasafe.perception.calibration.report import CalibrationSettings
from tests.unit.perception.calibration.test_reliability_figure import lines, report


def test_bars_are_the_missed_fractions_largest_first_with_names():
    result = report(3, planning_delta=0.04)
    left, right = missed_hands_figure(result).axes
    heights = [bar.get_height() for bar in right.patches]
    order = sorted(range(4), key=lambda i: -result.images[i].missed_hand_rate)
    column = DELTA_GRID.index(0.05)  # the next larger of the grid
    expected = [100 * result.images[i].missed_hand_rate for i in order]
    expected += [100 * result.final.missed_at_delta[i][column] for i in order]
    np.testing.assert_allclose(heights, expected)
    assert heights[:4] == sorted(heights[:4], reverse=True)
    assert result.image_ids[order[0]] in {text.get_text() for text in right.texts}
    for name, curve in (("hand", result.final.hand), ("background", result.final.background)):
        drawn = lines(left)[f"Predicted {name}"]
        filled = [row for row in zip(curve.predicted, curve.observed, strict=True) if row[0] is not None]
        np.testing.assert_allclose(drawn, filled)


@pytest.mark.parametrize("hand", [True, False])
def test_perfect_ensembles_and_images_without_hands_can_be_drawn(hand, tmp_path):
    label = np.zeros((8, 9), bool)
    label[2:5] = hand
    p_occupied = np.stack([label, label]).astype(np.float32)
    images = LabeledPredictions(["a", "b"], [label] * 2, [p_occupied] * 2)
    result = evaluate(images, CalibrationSettings(n_bootstrap=100))
    missed_hands_figure(result).savefig(tmp_path / "picture.png", dpi=40)
