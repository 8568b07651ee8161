"""Loading the registered ensemble needs no pickle, and our own code never runs code from the registry."""

import importlib.util
import pathlib
import sys

import numpy as np
import pytest

from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from pipelines.home import tracking_uri
from pipelines.tracking.frozen_folder import frozen_folder
from pipelines.tracking.model_versions import CHAMPION, MODEL_NAME
from pipelines.tracking.tracker import MlflowTracker
from tests.ensembles import freeze_constant

EXAMPLE = pathlib.Path(__file__).parents[3] / "examples" / "from_registry.py"
SWITCH = "MLFLOW_ALLOW_PICKLE_DESERIALIZATION"
IMAGES = np.random.default_rng(0).integers(0, 256, (2, 40, 50, 3), dtype=np.uint8)

pytestmark = pytest.mark.filterwarnings("ignore")  # warnings of MLflow


@pytest.fixture(scope="module")
def champion(tmp_path_factory):
    """Return a home with a champion, and its frozen folder."""
    home = tmp_path_factory.mktemp("home")
    frozen, tracker = freeze_constant(home, -2.0), MlflowTracker(home)
    tracker.register("i" * 64, frozen)
    tracker.call("promote", artifact=frozen.name, because="the first")
    return home, frozen


@pytest.fixture
def mlflow(champion, monkeypatch):
    """MLflow on that home, without pickles; changes of `sys.path` are reverted."""
    import mlflow as module

    monkeypatch.setenv(SWITCH, "false")
    monkeypatch.setattr(sys, "path", [*sys.path])
    module.set_tracking_uri(tracking_uri(champion[0]))
    return module


@pytest.fixture
def tampered(champion, tmp_path):
    """Replace the code in the registry by code that creates a file when it runs; yield the path of the file."""
    trace = tmp_path / "code-was-run"
    codes = [
        path
        for path in (champion[0] / "mlflow" / "artifacts").rglob("*.py")
        if path.name == "mlflow_model.py" or path.parts[-2:] == ("deltasafe", "__init__.py")
    ]
    assert len(codes) == 2
    genuine = {path: path.read_text() for path in codes}
    for path, text in genuine.items():
        path.write_text(f"import pathlib\npathlib.Path({str(trace)!r}).touch()\n{text}")
    yield trace
    for path, text in genuine.items():
        path.write_text(text)


def test_the_model_loads_by_alias_and_predicts(mlflow, champion):
    model = mlflow.pyfunc.load_model(f"models:/{MODEL_NAME}@{CHAMPION}")
    ensemble = load_ensemble(champion[1])
    expected = np.stack([ensemble.p_occupied(image) for image in IMAGES])
    assert np.abs(np.asarray(model.predict(IMAGES)) - expected).max() < 1e-6


def test_a_pickled_model_does_not_load(mlflow, tmp_path):
    class Model(mlflow.pyfunc.PythonModel):
        def predict(self, context, model_input, params=None):
            return model_input

    mlflow.pyfunc.save_model(tmp_path / "pickled", python_model=Model(), pip_requirements=[])
    with pytest.raises(mlflow.MlflowException, match="pickle is disallowed"):
        mlflow.pyfunc.load_model(str(tmp_path / "pickled"))


def test_our_example_runs_no_code_from_the_registry(mlflow, champion, tampered, tmp_path):
    spec = importlib.util.spec_from_file_location("from_registry", EXAMPLE)
    example = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(example)
    pulled = example.load_from_registry(MODEL_NAME, CHAMPION, str(tmp_path))
    assert np.array_equal(pulled.p_occupied(IMAGES[0]), load_ensemble(champion[1]).p_occupied(IMAGES[0]))
    assert not tampered.exists()


def test_fetching_the_champion_runs_no_code_from_the_registry(mlflow, champion, tampered, tmp_path):
    version = mlflow.MlflowClient().get_model_version_by_alias(MODEL_NAME, CHAMPION)
    assert load_ensemble(frozen_folder(version, tmp_path)).folder.name == champion[1].name
    assert not tampered.exists()


def test_loading_it_with_mlflow_runs_code_from_the_registry(mlflow, tampered):
    """MLflow cannot switch this off; docs/explanation/reliability.md says so."""
    mlflow.pyfunc.load_model(f"models:/{MODEL_NAME}@{CHAMPION}")
    assert tampered.exists()
