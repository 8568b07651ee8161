"""Coverage of the conformal margin: scores of scenes by predictor, and their figures."""

import dataclasses
import pathlib

import numpy as np
import pytest

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_margin import ConformalMargins
from deltasafe.perception.calibration.reliability import DELTA_GRID
from deltasafe.scene import LoggedScene
from deltasafe.studies.safety import StudyInputs
from deltasafe.studies.safety.predictors import Prediction
from deltasafe.studies.safety.runs import SceneRef
from deltasafe.studies.safety.scenarios import true_mask
from evidence.guarantee import coverage_figures, margin_figures, scores
from evidence.reporting import named_folder

SCENE = str(pathlib.Path(__file__).parents[2] / "datasets" / "scenes" / "scene_003")


@dataclasses.dataclass(frozen=True)
class ShiftedMask:
    """The ensemble predicts the true mask; a member predicts it without its lowest ``rows`` rows of hand."""

    rows: int

    def predict(self, rgb):
        mask = true_mask(LoggedScene.load(SCENE))
        cut = mask.copy()
        cut[np.flatnonzero(mask.any(axis=1))[: self.rows]] = False
        return Prediction(mask.astype(np.float32), cut[None].astype(np.float32))


def test_scores_by_predictor_and_resumed(tmp_path):
    inputs = StudyInputs((SceneRef(SCENE, "a"),), ("scene_003",), ShiftedMask(5), 1, 0.02)
    found = scores(inputs, tmp_path, 1)
    assert set(found) == {"ensemble", "member_0"}
    assert (found["ensemble"] == 0).all()
    width = true_mask(LoggedScene.load(SCENE)).shape[1]
    assert (found["member_0"] * width >= 5 - 1e-9).all()  # at least the cut rows, straight down to the rest
    files = sorted(tmp_path.iterdir())
    assert np.array_equal(scores(inputs, tmp_path, 1)["member_0"], found["member_0"])
    assert sorted(tmp_path.iterdir()) == files
    other = dataclasses.replace(inputs, predictor=ShiftedMask(9))  # another predictor has other scores
    assert (scores(other, tmp_path, 1)["member_0"] > found["member_0"]).all()


def test_figures_count_the_images_whose_score_is_within_the_margin():
    fitted = np.repeat(np.arange(1, 101)[:, None] / 1000, len(DELTA_GRID), axis=1)
    margins = ConformalMargins.of_images(fitted)
    figures = margin_figures({"ensemble": margins, "member_0": margins})
    assert figures["margin_px"] == pytest.approx(0.384 * 96)  # rank ceil(101 * 0.95) = 96
    tested = np.repeat(np.array([0.05, 0.096, 0.0961, 0.2])[:, None], len(DELTA_GRID), axis=1)
    assert coverage_figures(margins, tested, "")["coverage_alpha_005"] == 0.5


@pytest.mark.parametrize("entry", ["folder", "=folder", "a-b=folder"])
def test_a_set_needs_a_name_and_a_folder(entry):
    with pytest.raises(SettingsError, match="NAME=FOLDER"):
        named_folder(entry)
