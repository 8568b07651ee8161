"""The planner study of section V-B: Fig. 5 (cost over uncertainty) and Fig. 6 (time over obstacles), and what holds."""

from deltasafe.studies.planner.cost_comparison import Comparison, compare
from deltasafe.studies.planner.effects import Effect, effects_of_cost, effects_of_time
from deltasafe.studies.planner.methods import MAIN, Method, contenders
from deltasafe.studies.planner.paper_curves import paper_curves
from deltasafe.studies.planner.report import write_study
from deltasafe.studies.planner.scenes import EllipticDisc, StudyScene, cluttered_scene, crowded_scene, simple_scene
from deltasafe.studies.planner.settings import ComparisonSettings, TimingSettings
from deltasafe.studies.planner.timing import Timing, measure_times

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
    "compare",
    "contenders",
    "crowded_scene",
    "effects_of_cost",
    "effects_of_time",
    "measure_times",
    "paper_curves",
    "simple_scene",
    "write_study",
]
