"""The tracking bound gamma(v), identified: test motions over the workspace, a tolerance bound, held-out coverage."""

from deltasafe.tracking_study.bound import Coverage, coverage_of, fitted_bound, gamma0_over, slope_of
from deltasafe.tracking_study.report import write_tracking_report
from deltasafe.tracking_study.settings import TrackingStudySettings
from deltasafe.tracking_study.study import TrackingStudy, run_study
from deltasafe.tracking_study.tracks import PHASES_OF_SPEED, Tracks
from deltasafe.tracking_study.trajectories import KINDS, TestMotion, draw_motion

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
