"""The safety study: thousands of executed motions, and rates of violations and contacts with confidence intervals."""

from deltasafe.studies.safety.evidence import MethodResult, Pairing, Rate, by_speed, evaluate, failures, pair
from deltasafe.studies.safety.predictors import FrozenEnsemblePredictor, Prediction, Predictor
from deltasafe.studies.safety.report import figures_of, write_report
from deltasafe.studies.safety.runs import SceneRef, replay
from deltasafe.studies.safety.settings import METHODS, CameraSettings, SafetyStudySettings, TaskSettings
from deltasafe.studies.safety.study import SafetyStudy, StudyInputs, run_study

__all__ = [
    "METHODS",
    "CameraSettings",
    "FrozenEnsemblePredictor",
    "MethodResult",
    "Pairing",
    "Prediction",
    "Predictor",
    "Rate",
    "SafetyStudy",
    "SafetyStudySettings",
    "SceneRef",
    "StudyInputs",
    "TaskSettings",
    "by_speed",
    "evaluate",
    "failures",
    "figures_of",
    "pair",
    "replay",
    "run_study",
    "write_report",
]
