"""The safety study: thousands of executed motions, and what they say about delta, with intervals."""

from deltasafe.studies.intervals import clopper_pearson, mean_share_upper, scene_bootstrap, upper_bound
from deltasafe.studies.safety.evidence import Cell, Pairing, Rate, by_speed, cell, failures, pairing
from deltasafe.studies.safety.report import figures_of, write_safety_study
from deltasafe.studies.safety.runs import Eyes, FrozenEyes, SceneRef, Sight, replay
from deltasafe.studies.safety.settings import CONTENDERS, CameraSettings, SafetyStudySettings, TaskSettings
from deltasafe.studies.safety.study import SafetyStudy, StudyInputs, run_study

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
