"""The planner study of section V-B: path cost over uncertainty (Fig. 5) and search time over obstacles (Fig. 6)."""

from deltasafe.studies.planner.cost_comparison import Comparison, n_plans, run_comparison
from deltasafe.studies.planner.effects import Effect, effects_of_cost, effects_of_time
from deltasafe.studies.planner.methods import MAIN, Method, compared_methods
from deltasafe.studies.planner.paper_curves import paper_curves
from deltasafe.studies.planner.report import write_report
from deltasafe.studies.planner.scenes import EllipticDisc, StudyScene, cluttered_scene, crowded_scene, simple_scene
from deltasafe.studies.planner.settings import ComparisonSettings, TimingSettings
from deltasafe.studies.planner.timing import Timing, run_timing

__all__ = [
    "MAIN",
    "Comparison",
    "ComparisonSettings",
    "Effect",
    "EllipticDisc",
    "Method",
    "StudyScene",
    "Timing",
    "TimingSettings",
    "cluttered_scene",
    "compared_methods",
    "crowded_scene",
    "effects_of_cost",
    "effects_of_time",
    "n_plans",
    "paper_curves",
    "run_comparison",
    "run_timing",
    "simple_scene",
    "write_report",
]
