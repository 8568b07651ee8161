"""From labeled images to a frozen ensemble whose mean is a probability.

The steps in order: `LabeledImageSet.load`, `augment_images`, `train_ensemble`, `evaluate_ensemble`, `gate`,
`freeze_ensemble`, `load_ensemble`. The default settings are those of the preset ``default``. Names are imported on
first use, because importing torch and OpenCV takes seconds.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from deltasafe.io.images import read_rgb
    from deltasafe.perception.artifact.frozen_ensemble import FrozenEnsemble, golden_difference, load_ensemble
    from deltasafe.perception.calibration.delta_support import require_supported_delta
    from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, gate
    from deltasafe.perception.data.augmentation.settings import AugmentationSettings
    from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
    from deltasafe.perception.data.dataset_info import DatasetInfo
    from deltasafe.perception.data.importing.import_hands import import_hands
    from deltasafe.perception.data.importing.settings import ImportSettings
    from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint
    from deltasafe.perception.data.near_copies import near_copies
    from deltasafe.perception.evaluate_and_freeze import EvaluationSettings, evaluate_ensemble, freeze_ensemble
    from deltasafe.perception.folder_evaluation import evaluate_folder
    from deltasafe.perception.settings import GateThresholds, InferenceSettings, NetworkSettings, TrainingSettings
    from deltasafe.perception.training.member import Member
    from deltasafe.perception.training.train_ensemble import train_ensemble

__all__ = [
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
]

_HOMES = {
    ".io.images": ["read_rgb"],
    "artifact.frozen_ensemble": ["FrozenEnsemble", "golden_difference", "load_ensemble"],
    "calibration.delta_support": ["require_supported_delta"],
    "calibration.report": ["CalibrationReport", "CalibrationSettings", "gate"],
    "data.augmentation.settings": ["AugmentationSettings"],
    "data.augmented_set": ["AugmentedSet", "augment_images"],
    "data.dataset_info": ["DatasetInfo"],
    "data.importing.import_hands": ["import_hands"],
    "data.importing.settings": ["ImportSettings"],
    "data.labeled_images": ["LabeledImageSet", "check_disjoint"],
    "data.near_copies": ["near_copies"],
    "evaluate_and_freeze": ["EvaluationSettings", "evaluate_ensemble", "freeze_ensemble"],
    "folder_evaluation": ["evaluate_folder"],
    "settings": ["GateThresholds", "InferenceSettings", "NetworkSettings", "TrainingSettings"],
    "training.member": ["Member"],
    "training.train_ensemble": ["train_ensemble"],
}
_HOME_OF = {name: module for module, names in _HOMES.items() for name in names}


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f".{_HOME_OF[name]}", __name__), name)


def __dir__() -> list[str]:
    return sorted(__all__)
