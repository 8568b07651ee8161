"""The paper's results equal the printed tables, and the printed headings of Table II are swapped."""

import json
import pathlib

import numpy as np
import pytest

from deltasafe.perception.calibration.metrics import pool_scores, score_image
from deltasafe.perception.calibration.paper_results import (
    AUGMENTATION_RESULTS,
    ENSEMBLE_SIZE_RESULTS,
    RELIABILITY_RESULTS,
)

PRINTED = json.loads(
    (pathlib.Path(__file__).parents[3] / "golden" / "perception_tables_as_printed.json").read_text("utf-8")
)


def test_tables_1_and_2_equal_the_print_with_swapped_headings():
    for ours, one, two in zip(
        AUGMENTATION_RESULTS, PRINTED["table_1"]["rows"], PRINTED["table_2"]["rows"], strict=True
    ):
        assert [ours.n_images, ours.scheme] == one[:2] == two[:2]
        figures = (ours.pixel_accuracy, ours.pixel_accuracy_sd, ours.miou, ours.miou_sd)
        assert [100 * value for value in figures] == pytest.approx(one[2:])
        assert [1000 * ours.brier, 100 * ours.nll] == pytest.approx(two[2:])


def test_table_3_equals_the_print():
    brier, nll = np.transpose([ENSEMBLE_SIZE_RESULTS[m] for m in range(1, 11)])
    np.testing.assert_allclose(1000 * brier, PRINTED["table_3"]["BS x 10^3"])
    np.testing.assert_allclose(100 * nll, PRINTED["table_3"]["NLL x 10^2"])


def test_printed_headings_violate_the_brier_bound_and_swapped_ones_do_not():
    bound = [(1 - row[2] / 100) / 4 for row in PRINTED["table_1"]["rows"]]
    as_printed = [row[3] / 1000 for row in PRINTED["table_2"]["rows"]]
    swapped = [row[2] / 1000 for row in PRINTED["table_2"]["rows"]]
    broken = [
        row[:2]
        for row, brier, least in zip(PRINTED["table_2"]["rows"], as_printed, bound, strict=True)
        if brier < least
    ]
    assert broken == [[200, "mixup"], [200, "ours"]]
    assert all(brier >= least for brier, least in zip(swapped, bound, strict=True))


def test_row_ours_1000_equals_the_ensemble_of_ten():
    ours = AUGMENTATION_RESULTS[-1]
    assert (ours.brier, ours.nll) == ENSEMBLE_SIZE_RESULTS[10]


def test_brier_bound_holds_for_random_predictions():
    rng = np.random.default_rng(3)
    for _ in range(30):
        p_occupied = rng.beta(0.3, 0.3, size=(7, 9))
        label = rng.random((7, 9)) < rng.random()
        scores = pool_scores([score_image(p_occupied, label)])
        assert scores.brier >= (1 - scores.pixel_accuracy) / 4
    at_threshold = pool_scores([score_image(np.full((4, 4), 0.5), np.zeros((4, 4), bool))])
    assert at_threshold.brier == (1 - at_threshold.pixel_accuracy) / 4


def test_figure_4_has_the_values_cited_by_decision_5():
    confidence, accuracy = RELIABILITY_RESULTS[10]
    assert (round(confidence[-1], 3), round(accuracy[-1], 3)) == (0.999, 0.990)
    confidence, accuracy = RELIABILITY_RESULTS[5]
    assert (round(confidence[-2], 2), round(accuracy[-2], 2)) == (0.93, 0.85)
