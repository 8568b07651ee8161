"""The public API: `deltasafe` and `deltasafe.perception`."""

import importlib
import subprocess
import sys

import pytest

PUBLIC = {
    "deltasafe": [
        "ArtifactError",
        "Camera",
        "Cuboid",
        "DeltasafeError",
        "FieldSettings",
        "ImageStamp",
        "LoggedScene",
        "MotionSettings",
        "OccupancyGrid",
        "PlannedMotion",
        "Pose",
        "Sphere",
        "ToolBody",
        "__version__",
        "grid_from_image",
        "grid_from_shapes",
        "load_ensemble",
        "plan_motion",
        "plan_over_image",
        "verify_motion",
    ],
    "deltasafe.perception": [
        "AugmentationSettings",
        "AugmentedSet",
        "CalibrationReport",
        "CalibrationSettings",
        "DatasetInfo",
        "EvaluationSettings",
        "FrozenEnsemble",
        "GateThresholds",
        "ImportSettings",
        "InferenceSettings",
        "LabeledImageSet",
        "Member",
        "NetworkSettings",
        "TrainingSettings",
        "augment_images",
        "check_disjoint",
        "evaluate_ensemble",
        "evaluate_folder",
        "freeze_ensemble",
        "gate",
        "golden_difference",
        "import_hands",
        "load_ensemble",
        "near_copies",
        "read_rgb",
        "require_supported_delta",
        "train_ensemble",
    ],
}


@pytest.mark.parametrize("package", PUBLIC)
def test_the_public_names_are_pinned_and_importable(package):
    module = importlib.import_module(package)
    assert module.__all__ == PUBLIC[package]
    assert dir(module) == sorted(PUBLIC[package])
    for name in PUBLIC[package]:
        assert getattr(module, name) is not None


def test_an_unknown_name_is_an_attribute_error():
    for package in PUBLIC:
        with pytest.raises(AttributeError, match="no_such_name"):
            _ = importlib.import_module(package).no_such_name


def test_planning_loads_neither_torch_nor_a_simulator():
    planning = sorted(set(PUBLIC["deltasafe"]) - {"load_ensemble"})
    code = f"""
import sys
import deltasafe.perception
assert "numpy" not in sys.modules, "importing the packages loads nothing"
from deltasafe import {", ".join(planning)}
loaded = {{"torch", "cv2", "pybullet"}} & set(sys.modules)
assert not loaded, loaded
"""
    subprocess.run([sys.executable, "-c", code], check=True)
