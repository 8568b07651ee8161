"""How assets are run: what is tried again, what never runs side by side, what follows when data change."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import dagster as dg

from assets.interfaces import Store
from deltasafe.errors import DeltasafeError, LockedError, WorkerLostError

__all__ = ["ALL_CORES", "ON_NEW_ASSET", "ON_NEW_DATA", "RETRY_TWICE", "no_retry"]

P = ParamSpec("P")
T = TypeVar("T")

ALL_CORES = "all_cores"
"""Pool of the steps that use every core by themselves: one at a time, in whichever runs they are."""

RETRY_TWICE = dg.RetryPolicy(max_retries=2, delay=10.0, backoff=dg.Backoff.EXPONENTIAL, jitter=dg.Jitter.PLUS_MINUS)
"""For what fails by chance: a killed process, a full memory. A training goes on from its checkpoint."""

_Condition = dg.AutomationCondition

# a dependency that is asked for at once brings its checks along, and the run itself blocks if they fail
_BLOCKING_CHECKS_PASSED = _Condition.all_deps_match(
    _Condition.all_checks_match(_Condition.check_passed(), blocking_only=True) | _Condition.will_be_requested()
).with_label("blocking checks passed, or come first in the same run")

ON_NEW_DATA = (
    _Condition.any_deps_match(
        (_Condition.data_version_changed() & ~_Condition.executed_with_root_target()) | _Condition.will_be_requested()
    ).since_last_handled()
    & ~_Condition.any_deps_missing()
    & ~_Condition.any_deps_in_progress()
    & ~_Condition.in_progress()
    & _BLOCKING_CHECKS_PASSED
).with_label("something that it is made from has changed")
"""A dependency has other data than before (not merely been made again), and every blocking check on the way passed."""

ON_NEW_ASSET = _Condition.eager().with_label("what it checks has been made")
"""For checks: else they are left out where assets are asked for, and what comes after waits for them for ever."""


def no_retry(made: Callable[P, T]) -> Callable[P, T]:
    """Wrong input and wrong settings fail at once: another try would end in the same words.

    A run that its store refuses ends here as well, before anything is computed. An error in the resource itself would
    be taken for bad luck, and tried again.
    """

    @functools.wraps(made)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> T:
        for store in (given for given in (*args, *kwargs.values()) if isinstance(given, Store)):
            if store.refused:
                raise dg.Failure(store.refused, allow_retries=False)
        try:
            return made(*args, **kwargs)
        except (LockedError, WorkerLostError):  # these pass
            raise
        except DeltasafeError as error:
            raise dg.Failure(f"{type(error).__name__}: {error}", allow_retries=False) from error

    return wrapped
