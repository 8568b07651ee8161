"""The planner study of section V-B: path cost over uncertainty (Fig. 5) and search time over obstacles (Fig. 6)."""

from deltasafe.studies.planner.cost_comparison import Comparison, n_plans, run_comparison
from deltasafe.studies.planner.report import write_report
from deltasafe.studies.planner.settings import ComparisonSettings, TimingSettings
from deltasafe.studies.planner.timing import Timing, run_timing

__all__ = [
    "Comparison",
    "ComparisonSettings",
    "Timing",
    "TimingSettings",
    "n_plans",
    "run_comparison",
    "run_timing",
    "write_report",
]
