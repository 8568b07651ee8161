"""The planner study of section V-B: Fig. 5 (cost over uncertainty) and Fig. 6 (time over obstacles), and what holds."""

from deltasafe.planner_study.comparison import Comparison, compare
from deltasafe.planner_study.contenders import MAIN, Contender, contenders
from deltasafe.planner_study.effects import Effect, effects_of_cost, effects_of_time
from deltasafe.planner_study.paper import paper_curves
from deltasafe.planner_study.report import write_study
from deltasafe.planner_study.scenes import EllipticDisc, StudyScene, cluttered_scene, crowded_scene, simple_scene
from deltasafe.planner_study.settings import ComparisonSettings, TimingSettings
from deltasafe.planner_study.timing import Timing, measure_times

__all__ = [
    "MAIN",
    "Comparison",
    "ComparisonSettings",
    "Contender",
    "Effect",
    "EllipticDisc",
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
