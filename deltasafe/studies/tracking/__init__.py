"""The tracking study: identifies the tracking bound gamma(v) from test motions and tests it on held-out runs."""

from deltasafe.studies.tracking.bound import Coverage, coverage_of, fit_bound, fit_constant, fit_slope
from deltasafe.studies.tracking.report import write_report
from deltasafe.studies.tracking.settings import TrackingStudySettings
from deltasafe.studies.tracking.study import TrackingStudy, run_study
from deltasafe.studies.tracking.test_motions import KINDS, TestMotion, draw_motion
from deltasafe.studies.tracking.tracking_errors import PHASES_OF_SPEED, Tracks

__all__ = [
    "KINDS",
    "PHASES_OF_SPEED",
    "Coverage",
    "TestMotion",
    "TrackingStudy",
    "TrackingStudySettings",
    "Tracks",
    "coverage_of",
    "draw_motion",
    "fit_bound",
    "fit_constant",
    "fit_slope",
    "run_study",
    "write_report",
]
