"""Policies of assets: retries, the pool of steps that use all cores, and automation conditions."""

import functools
from collections.abc import Callable
from typing import ParamSpec, TypeVar

import dagster as dg

from assets.interfaces import Store
from deltasafe.errors import DeltasafeError, LockedError, WorkerLostError

P = ParamSpec("P")
T = TypeVar("T")

ALL_CORES = "all_cores"
"""Pool of the steps that use all cores. They run one at a time, across all runs."""

RETRY_TWICE = dg.RetryPolicy(max_retries=2, delay=10.0, backoff=dg.Backoff.EXPONENTIAL, jitter=dg.Jitter.PLUS_MINUS)
"""For transient failures, e.g. a killed process or a lack of memory. A training resumes from its checkpoint."""

_Condition = dg.AutomationCondition

# a dependency that is requested in the same run brings its checks, and that run stops if they fail
_BLOCKING_CHECKS_PASSED = _Condition.all_deps_match(
    _Condition.all_checks_match(_Condition.check_passed(), blocking_only=True) | _Condition.will_be_requested()
).with_label("blocking checks passed, or run first in the same run")

ON_NEW_DATA = (
    _Condition.any_deps_match(
        (_Condition.data_version_changed() & ~_Condition.executed_with_root_target()) | _Condition.will_be_requested()
    ).since_last_handled()
    & ~_Condition.any_deps_missing()
    & ~_Condition.any_deps_in_progress()
    & ~_Condition.in_progress()
    & _BLOCKING_CHECKS_PASSED
).with_label("an input has changed")
"""A dependency has a new data version, and its blocking checks passed. Making the same data again does not count."""

ON_NEW_ASSET = _Condition.eager().with_label("the checked asset was made")
"""For checks. Otherwise automation skips them, and all downstream assets wait for them forever."""


def no_retry(asset: Callable[P, T]) -> Callable[P, T]:
    """Fail without retries on errors of the library (invalid input or settings); other exceptions are retried.

    A run that the store refuses also fails here, before anything is computed. An exception in the resource itself
    would be retried.
    """

    @functools.wraps(asset)
    def wrapped(*args: P.args, **kwargs: P.kwargs) -> T:
        for store in (argument for argument in (*args, *kwargs.values()) if isinstance(argument, Store)):
            if store.refused:
                raise dg.Failure(store.refused, allow_retries=False)
        try:
            return asset(*args, **kwargs)
        except (LockedError, WorkerLostError):  # transient
            raise
        except DeltasafeError as error:
            raise dg.Failure(f"{type(error).__name__}: {error}", allow_retries=False) from error

    return wrapped
