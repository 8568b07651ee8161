"""The tracking study: identifies the tracking bound gamma(v) from test motions and tests it on held-out runs."""

from deltasafe.studies.tracking.report import write_report
from deltasafe.studies.tracking.settings import TrackingStudySettings
from deltasafe.studies.tracking.study import TrackingStudy, run_study

__all__ = ["TrackingStudy", "TrackingStudySettings", "run_study", "write_report"]
