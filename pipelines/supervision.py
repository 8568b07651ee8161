"""The executor of all runs: refuses a run before its first step, records its process, and kills steps that ignore a
termination request."""

import contextlib
import os
import platform
import signal
import threading
from collections.abc import Callable, Collection, Iterator, Mapping
from typing import TYPE_CHECKING, Any, NamedTuple, cast

import dagster as dg
from dagster import DagsterEvent, Executor
from dagster._core.events import EngineEventData
from dagster._core.storage.tags import MAX_RETRIES_TAG

from deltasafe.compute.processes import descendants, kill_with_descendants, parent_of, start_mark
from pipelines.home import DATABASE_VARIABLE

if TYPE_CHECKING:
    from dagster._core.execution.context.system import PlanOrchestrationContext
    from dagster._core.execution.plan.plan import ExecutionPlan
    from dagster._core.execution.retries import RetryMode
    from dagster._core.execution.step_dependency_config import StepDependencyConfig

MACHINE_TAG = "deltasafe/machine"
"""Tag of a run with the host name of its machine, if machines share a database."""
_PATIENCE_S = 6.0
"""From the termination request to SIGKILL. Python cannot interrupt compiled code."""
_PID, _START = "pid", "start"


class RunProcess(NamedTuple):
    """The process of a run.

    Attributes:
        pid: its PID.
        start: its `deltasafe.compute.processes.start_mark`; None if the executor did not record it.
    """

    pid: int
    start: str | None


def process_of(instance: dg.DagsterInstance, run_id: str) -> RunProcess | None:
    """Read the process of a run from its events; None if no event names it yet.

    Tags were rejected: a re-execution copies the tags of its parent run.
    """
    found: RunProcess | None = None
    for entry in instance.all_logs(run_id, of_type=dg.DagsterEventType.ENGINE_EVENT):
        event = entry.dagster_event
        if event is None or event.step_key is not None or _PID not in event.engine_event_data.metadata:
            continue
        metadata = event.engine_event_data.metadata
        data = {key: str(metadata[key].value) for key in (_PID, _START) if key in metadata}
        if found is None or found.start is None or _START in data:
            found = RunProcess(int(data[_PID]), data.get(_START))
    return found


def step_processes(instance: dg.DagsterInstance, run_id: str) -> set[int]:
    """Return the PIDs of all steps that a run has started, on any machine."""
    events = instance.all_logs(run_id, of_type=dg.DagsterEventType.STEP_WORKER_STARTED)
    return {pid for entry in events if (pid := _pid_of_step(entry.dagster_event)) is not None}


LaunchCheck = Callable[[Mapping[str, Any], Collection[str]], str]
"""Run configuration and names of the steps -> why the run must not start; empty if it may."""


def supervised(executor: dg.ExecutorDefinition, launch_check: LaunchCheck = lambda *_: "") -> dg.ExecutorDefinition:
    """Wrap an executor: its runs record their process, and termination takes seconds.

    If machines share a database, it also tags runs with the host name of the machine or container.

    Args:
        launch_check: called before the first step. A run that it refuses fails, and Dagster does not retry it.
    """
    create = executor.executor_creation_fn
    assert create is not None
    return dg.ExecutorDefinition(
        name=executor.name,
        config_schema=cast(Any, executor.config_schema),
        requirements=executor.get_requirements,
        executor_creation_fn=lambda context: _Supervised(create(context), launch_check),
        description=executor.description,
    )


class _Supervised(Executor):
    def __init__(self, executor: Executor, launch_check: LaunchCheck) -> None:
        self._executor, self._launch_check = executor, launch_check

    def execute(
        self, plan_context: "PlanOrchestrationContext", execution_plan: "ExecutionPlan"
    ) -> Iterator[DagsterEvent]:
        if os.environ.get(DATABASE_VARIABLE):
            plan_context.instance.add_run_tags(plan_context.run_id, {MACHINE_TAG: platform.node()})
        pid = os.getpid()
        yield DagsterEvent.engine_event(plan_context, f"The run is process {pid}", EngineEventData(_process(pid)))
        self._refuse_or_start(plan_context, execution_plan)
        steps: set[int] = set()
        servers: set[int] = set()
        killer = threading.Timer(_PATIENCE_S, _kill, (plan_context, steps))
        killer.daemon = True
        try:
            for event in self._executor.execute(plan_context, execution_plan):
                if (step := _pid_of_step(event)) is not None:
                    steps.add(step)
                if killer.ident is None and _is_termination(event):
                    servers = _fork_servers(steps)
                    killer.start()
                yield event
        finally:
            killer.cancel()
            for server in servers:  # otherwise it exits only after this process, and takes seconds
                with contextlib.suppress(ProcessLookupError):
                    os.kill(server, signal.SIGKILL)

    def _refuse_or_start(self, plan_context: "PlanOrchestrationContext", execution_plan: "ExecutionPlan") -> None:
        """Raise `dagster.Failure` if the launch check refuses the run."""
        run = plan_context.dagster_run
        if refused := self._launch_check(run.run_config, execution_plan.step_keys_to_execute):
            plan_context.instance.add_run_tags(run.run_id, {MAX_RETRIES_TAG: "0"})
            raise dg.Failure(refused, allow_retries=False)

    @property
    def retries(self) -> "RetryMode":
        return self._executor.retries

    @property
    def step_dependency_config(self) -> "StepDependencyConfig":
        return self._executor.step_dependency_config


def _process(pid: int) -> dict[str, str]:
    start = start_mark(pid)
    return {_PID: str(pid), **({} if start is None else {_START: start})}


def _pid_of_step(event: DagsterEvent | None) -> int | None:
    if event is None or event.event_type != dg.DagsterEventType.STEP_WORKER_STARTED:
        return None
    pid = event.engine_event_data.metadata.get("pid")
    return None if pid is None else int(str(pid.value))


def _is_termination(event: DagsterEvent) -> bool:
    return event.is_engine_event and "steps_interrupted" in event.engine_event_data.metadata


def _fork_servers(steps: set[int]) -> set[int]:
    """Return the PIDs of the children of this process that forked the running steps."""
    return set(descendants(os.getpid())).intersection(map(parent_of, steps))


def _kill(plan_context: "PlanOrchestrationContext", steps: set[int]) -> None:
    left = steps.intersection(descendants(os.getpid()))
    for step in left:
        kill_with_descendants(step)
    if left:
        text = (
            f"Steps did not end within {_PATIENCE_S:g} s after the termination request and were killed: {sorted(left)}"
        )
        plan_context.instance.report_engine_event(text, plan_context.dagster_run)
