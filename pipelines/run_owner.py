"""Whose runs are whose, where machines share one database: the process of a run is looked for on its own machine."""

import os
import platform
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any, cast

import dagster as dg
from dagster import Executor

from pipelines.home import DATABASE_VARIABLE

if TYPE_CHECKING:
    from dagster import DagsterEvent
    from dagster._core.execution.context.system import PlanOrchestrationContext
    from dagster._core.execution.plan.plan import ExecutionPlan
    from dagster._core.execution.retries import RetryMode
    from dagster._core.execution.step_dependency_config import StepDependencyConfig

__all__ = ["MACHINE_TAG", "runs_here", "with_machine"]

MACHINE_TAG = "deltasafe/machine"


def runs_here(run: dg.DagsterRun) -> bool:
    """Whether the run's process is, or was, one of this machine.

    A home of its own has no others; in a shared database those runs that say so. A run that died before it could say
    it is ended by Dagster's own start timeout.
    """
    return not os.environ.get(DATABASE_VARIABLE) or run.tags.get(MACHINE_TAG) == platform.node()


def with_machine(executor: dg.ExecutorDefinition) -> dg.ExecutorDefinition:
    """The same executor, whose runs bear the name of the machine (or container) as a tag, if the database is shared."""
    made = executor.executor_creation_fn
    if made is None or not os.environ.get(DATABASE_VARIABLE):
        return executor
    return dg.ExecutorDefinition(
        name=executor.name,
        config_schema=cast(Any, executor.config_schema),
        requirements=executor.get_requirements,
        executor_creation_fn=lambda context: _Tagging(made(context)),
        description=executor.description,
    )


class _Tagging(Executor):
    def __init__(self, executor: Executor) -> None:
        self._executor = executor

    def execute(
        self, plan_context: "PlanOrchestrationContext", execution_plan: "ExecutionPlan"
    ) -> Iterator["DagsterEvent"]:
        plan_context.instance.add_run_tags(plan_context.run_id, {MACHINE_TAG: platform.node()})
        yield from self._executor.execute(plan_context, execution_plan)

    @property
    def retries(self) -> "RetryMode":
        return self._executor.retries

    @property
    def step_dependency_config(self) -> "StepDependencyConfig":
        return self._executor.step_dependency_config
