"""A home is for one obstacle, which names its registered model."""

import mlflow
import pytest

from deltasafe.errors import DataError
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from pipelines.home import obstacle_of, require_obstacle, tracking_uri
from pipelines.tracking.model_versions import MODEL_NAME, model_name
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant
from tests.registered import light_registration


def test_the_registered_model_is_named_after_the_obstacle(tmp_path, monkeypatch):
    assert model_name("hand") == MODEL_NAME == "deltasafe-hand-ensemble"
    light_registration(monkeypatch)
    cups = freeze_constant(tmp_path / "made", 0.0, DatasetInfo("coffee_cup", images="rendered"))
    tracker = MlflowTracker(tmp_path)
    tracker.register("i" * 64, cups)
    (model,) = mlflow.MlflowClient(tracking_uri(tmp_path)).search_registered_models()
    assert model.name == "deltasafe-coffee-cup-ensemble"
    with tracker.records() as records:
        (version,) = records.versions()
        assert version.tags["artifact"] == cups.name
    assert obstacle_of(tmp_path) == "coffee_cup"
    card = (cups / "model_card.md").read_text()
    assert "shows a coffee cup" in card
    assert "measured on rendered images" in card


def test_an_ensemble_for_another_obstacle_needs_another_home(tmp_path):
    assert obstacle_of(tmp_path) == HANDS.obstacle
    require_obstacle(tmp_path, "coffee_cup")
    (tmp_path / "champion.json").write_text('{"artifact": "ensemble-0123456789abcdef"}')
    require_obstacle(tmp_path, "hand")
    with pytest.raises(DataError, match="ensembles for the obstacle 'hand', not 'coffee_cup'; set DELTASAFE_HOME"):
        require_obstacle(tmp_path, "coffee_cup")
