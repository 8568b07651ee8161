"""The safety study: thousands of executed motions, and what they say about delta, with intervals."""

from deltasafe.intervals import clopper_pearson, mean_share_upper, scene_bootstrap, upper_bound
from deltasafe.safety_study.evidence import Cell, Pairing, Rate, by_speed, cell, failures, pairing
from deltasafe.safety_study.report import figures_of, write_safety_study
from deltasafe.safety_study.settings import CONTENDERS, CameraSettings, SafetyStudySettings, TaskSettings
from deltasafe.safety_study.study import SafetyStudy, StudyInputs, run_study
from deltasafe.safety_study.trials import Eyes, FrozenEyes, SceneRef, Sight, replay

__all__ = [
    "CONTENDERS",
    "CameraSettings",
    "Cell",
    "Eyes",
    "FrozenEyes",
    "Pairing",
    "Rate",
    "SafetyStudy",
    "SafetyStudySettings",
    "SceneRef",
    "Sight",
    "StudyInputs",
    "TaskSettings",
    "by_speed",
    "cell",
    "clopper_pearson",
    "failures",
    "figures_of",
    "mean_share_upper",
    "pairing",
    "replay",
    "run_study",
    "scene_bootstrap",
    "upper_bound",
    "write_safety_study",
]
