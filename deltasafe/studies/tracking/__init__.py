"""The tracking bound gamma(v), identified: test motions over the workspace, a tolerance bound, held-out coverage."""

from deltasafe.studies.tracking.bound import Coverage, coverage_of, fitted_bound, gamma0_over, slope_of
from deltasafe.studies.tracking.report import write_tracking_report
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
    "fitted_bound",
    "gamma0_over",
    "run_study",
    "slope_of",
    "write_tracking_report",
]
