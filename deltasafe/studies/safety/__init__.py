"""The safety study: thousands of executed motions, and rates of violations and contacts with confidence intervals."""

from deltasafe.studies.safety.report import write_report
from deltasafe.studies.safety.runs import replay
from deltasafe.studies.safety.settings import SafetyStudySettings
from deltasafe.studies.safety.study import SafetyStudy, StudyInputs, run_study

__all__ = ["SafetyStudy", "SafetyStudySettings", "StudyInputs", "replay", "run_study", "write_report"]
