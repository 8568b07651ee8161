"""Outcome of a search: status, path and figures."""

import dataclasses
import enum

from deltasafe.geometry import PosePath


class PlanStatus(enum.StrEnum):
    """How a search ended.

    Attributes:
        SOLVED: the path passed the continuous test.
        UNVERIFIED: the test of the search accepted the path, the continuous test did not; never executed.
        BUDGET_SPENT: no path within ``n_iterations`` or ``time_limit_s``, with any margin; more may help.
        START_UNSAFE, GOAL_UNSAFE: the pose itself has less clearance than the margin.
        NO_CONNECTION: proof, at the resolution of voxels, that no path exists.
        TOO_NARROW: the same search finds a path with a smaller margin only; the message states both margins.
    """

    SOLVED = "solved"
    UNVERIFIED = "path fails the continuous check"
    BUDGET_SPENT = "budget spent"
    START_UNSAFE = "start unsafe"
    GOAL_UNSAFE = "goal unsafe"
    NO_CONNECTION = "no connection"
    TOO_NARROW = "too narrow"


@dataclasses.dataclass(frozen=True)
class PlanResult:
    """Outcome of a search.

    Attributes:
        status: how it ended; only a ``SOLVED`` path has passed the continuous check.
        path: poses from start to goal, or None. An ``UNVERIFIED`` path may be displayed, but must not be executed.
        margin_m: required distance to the unsafe set.
        clearance_m: smallest clearance along the path; of the unsafe pose if start or goal is unsafe.
        cost: of the path, by the line cost of the settings.
        cost_squared_m2: of the path, by the line cost ``squared``.
        area_m2: area between path and table.
        n_iterations: samples drawn.
        n_nodes: nodes of the tree.
        solved_at: first iteration with a path; -1 if there is none.
        message: the outcome in a sentence.
    """

    status: PlanStatus
    path: PosePath | None
    margin_m: float
    clearance_m: float
    cost: float | None
    cost_squared_m2: float | None
    area_m2: float | None
    n_iterations: int
    n_nodes: int
    solved_at: int
    message: str
