"""The problem that a search solves and a refinement improves: constraint, cost and bounds."""

import math
import numbers
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.geometry import as_rows
from deltasafe.planning.search.cost import LineCost


class SearchProblem(NamedTuple):
    """Constraint, cost and bounds of the poses, as compiled code reads them. Made by ``search_problem``."""

    constraint: Any
    cost: LineCost
    lower: tuple[float, ...]
    upper: tuple[float, ...]


def search_problem(
    constraint: Any, cost: LineCost, lower: NDArray[np.float64], upper: NDArray[np.float64]
) -> SearchProblem:
    """Make a problem.

    Args:
        constraint: a ``NamedTuple`` registered with ``register_segment_test``.
        cost: line cost.
        lower, upper: bounds of the poses (4,).

    Raises:
        SettingsError: a bound is not finite, or has another shape.
    """
    bounds = as_rows((lower, upper), 4, "the bounds of a search").tolist()
    return SearchProblem(constraint, cost, tuple(bounds[0]), tuple(bounds[1]))


def require_budget(what: str, count: int | None, deadline_s: float) -> None:
    """Refuse a budget that never ends: neither count nor deadline, a count like 10.5, or a deadline that is NaN.

    Raises:
        SettingsError: such a budget.
    """
    if count is not None and not isinstance(count, numbers.Integral):
        raise SettingsError(f"{what} needs a whole number of steps, got {count!r}")
    if math.isnan(deadline_s) or (count is None and deadline_s == math.inf):
        raise SettingsError(f"{what} needs a number of steps or a deadline, got {count} and {deadline_s}")
