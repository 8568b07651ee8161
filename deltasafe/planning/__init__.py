"""Planning of motions that avoid possibly occupied space: SCC-RRT*, segment tests, and safe velocity scheduling."""

from deltasafe.planning.audit import Audit, verify_motion
from deltasafe.planning.body import ToolBody
from deltasafe.planning.collision.distance_field import DistanceField
from deltasafe.planning.collision.segment_query import register_segment_test, segment_is_safe
from deltasafe.planning.collision.segment_tests import (
    CheckSettings,
    SegmentTest,
    body_clearance_m,
    is_segment_safe,
    segment_test,
    verification_test,
)
from deltasafe.planning.motion import MotionSettings, PlannedMotion, plan_motion
from deltasafe.planning.parts import ToolPart
from deltasafe.planning.results import PlanResult, PlanStatus
from deltasafe.planning.scc_rrt_star import Planner, PlannerSettings, plan
from deltasafe.planning.search.cost import LineCost, area_m2, line_cost, path_cost
from deltasafe.planning.search.problem import SearchProblem, search_problem
from deltasafe.planning.search.rrt_star import RrtStar, RrtStarSettings, grow_tree
from deltasafe.planning.search.shortcutting import refine_path
from deltasafe.planning.search.tree import SearchTree
from deltasafe.planning.timing.velocity_schedule import SpeedProfile, VelocitySettings, schedule, schedule_at_top_speed
from deltasafe.planning.tool_urdf import tool_from_urdf
from deltasafe.planning.tracking_bound import TrackingBound

__all__ = [
    "Audit",
    "CheckSettings",
    "DistanceField",
    "LineCost",
    "MotionSettings",
    "PlanResult",
    "PlanStatus",
    "PlannedMotion",
    "Planner",
    "PlannerSettings",
    "RrtStar",
    "RrtStarSettings",
    "SearchProblem",
    "SearchTree",
    "SegmentTest",
    "SpeedProfile",
    "ToolBody",
    "ToolPart",
    "TrackingBound",
    "VelocitySettings",
    "area_m2",
    "body_clearance_m",
    "grow_tree",
    "is_segment_safe",
    "line_cost",
    "path_cost",
    "plan",
    "plan_motion",
    "refine_path",
    "register_segment_test",
    "schedule",
    "schedule_at_top_speed",
    "search_problem",
    "segment_is_safe",
    "segment_test",
    "tool_from_urdf",
    "verification_test",
    "verify_motion",
]
