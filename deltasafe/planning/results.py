"""How a search ended, and what it found."""

import dataclasses
import enum

from deltasafe.geometry import PosePath

__all__ = ["PlanResult", "PlanStatus"]


class PlanStatus(enum.StrEnum):
    """How a search ended."""

    SOLVED = "solved"
    UNVERIFIED = "path fails the continuous check"
    BUDGET_SPENT = "budget spent"
    START_UNSAFE = "start unsafe"
    GOAL_UNSAFE = "goal unsafe"
    NO_CONNECTION = "no connection"


@dataclasses.dataclass(frozen=True)
class PlanResult:
    """What the search found, and whether it holds.

    Attributes:
        status: how it ended; only a ``SOLVED`` path has passed the continuous check.
        path: poses from start to goal, or None. An ``UNVERIFIED`` path is shown, never to be executed.
        margin_m: distance to the unsafe set that was asked for.
        clearance_m: of the offending pose if start or goal is unsafe, else the smallest along the path.
        cost: of the path, by the settings' line cost; ``cost_squared_m2`` and ``area_m2`` beside it.
        n_iterations, n_nodes, solved_at: samples drawn, nodes of the tree, first iteration with a path (-1: none).
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
