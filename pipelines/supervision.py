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
from dagster._core.storage.tags import BACKFILL_ID_TAG, MAX_RETRIES_TAG

from deltasafe.compute.processes import descendants, kill_with_descendants, parent_of, start_mark
from pipelines.automation.launch_check import lineage_error
from pipelines.home import DATABASE_VARIABLE

if TYPE_CHECKING:
    from dagster._core.execution.context.system import PlanOrchestrationContext
    from dagster._core.execution.plan.plan import ExecutionPlan
    from dagster._core.execution.retries import RetryMode
    from dagster._core.execution.step_dependency_config import StepDependencyConfig
    from dagster._core.storage.dagster_run import DagsterRun

MACHINE_TAG = "deltasafe/machine"
"""Tag of a run with the host name of its machine, if machines share a database."""
PROCESS_TAG = "deltasafe/process"
"""Tag of a run that a command executes: its ID, PID and start mark of the process."""
FAILED_CHECKS_TAG = "deltasafe/failed_checks"
"""Tag of a run with its failed checks."""
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
    """Read the process of a run from its events, else from the tag of a command; None if neither names it yet.

    A re-execution copies the tags of its parent run, so the tag also names the run that it belongs to.
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
    return found or _process_in_tag(instance.get_run_by_id(run_id))


def process_tags(run_id: str) -> dict[str, str]:
    """Return tags with which a run that this process executes is created.

    An event would come too late: the process can end, or the disk be full, before one is stored.
    """
    machine = {MACHINE_TAG: platform.node()} if os.environ.get(DATABASE_VARIABLE) else {}
    return {**machine, PROCESS_TAG: " ".join((run_id, *_process(os.getpid()).values()))}


def _process_in_tag(run: "DagsterRun | None") -> RunProcess | None:
    run_id, *process = (run.tags.get(PROCESS_TAG, "") if run else "").split(" ")
    if run is None or run_id != run.run_id:
        return None
    return RunProcess(int(process[0]), process[1] if len(process) > 1 else None)


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
        failed: set[str] = set()
        servers: set[int] = set()
        killer = threading.Timer(_PATIENCE_S, _kill, (plan_context, steps))
        killer.daemon = True
        try:
            for event in self._executor.execute(plan_context, execution_plan):
                if (step := _pid_of_step(event)) is not None:
                    steps.add(step)
                if event.event_type == dg.DagsterEventType.ASSET_CHECK_EVALUATION:
                    failed |= _failed_check(event)
                if killer.ident is None and _is_termination(event):
                    servers = _fork_servers(steps)
                    killer.start()
                yield event
        finally:
            killer.cancel()
            _tag_failed_checks(plan_context, failed)
            for server in servers:  # otherwise it exits only after this process, and takes seconds
                with contextlib.suppress(ProcessLookupError):
                    os.kill(server, signal.SIGKILL)

    def _refuse_or_start(self, plan_context: "PlanOrchestrationContext", execution_plan: "ExecutionPlan") -> None:
        """Raise `dagster.Failure` if the launch check refuses the run."""
        run = plan_context.dagster_run
        steps = execution_plan.step_keys_to_execute
        if refused := lineage_error(_selected(plan_context, steps)) or self._launch_check(run.run_config, steps):
            plan_context.instance.add_run_tags(run.run_id, {MAX_RETRIES_TAG: "0"})
            raise dg.Failure(refused, allow_retries=False)

    @property
    def retries(self) -> "RetryMode":
        return self._executor.retries

    @property
    def step_dependency_config(self) -> "StepDependencyConfig":
        return self._executor.step_dependency_config


def _selected(plan_context: "PlanOrchestrationContext", steps: Collection[str]) -> set[str]:
    """Return the steps of a run, and the assets of its backfill, which may have several runs."""
    backfill_id = plan_context.dagster_run.tags.get(BACKFILL_ID_TAG)
    backfill = plan_context.instance.get_backfill(backfill_id) if backfill_id else None
    keys = (backfill.asset_selection if backfill else None) or ()
    return {*steps, *(key.path[-1] for key in keys)}


def _process(pid: int) -> dict[str, str]:
    start = start_mark(pid)
    return {_PID: str(pid), **({} if start is None else {_START: start})}


def _pid_of_step(event: DagsterEvent | None) -> int | None:
    if event is None or event.event_type != dg.DagsterEventType.STEP_WORKER_STARTED:
        return None
    pid = event.engine_event_data.metadata.get("pid")
    return None if pid is None else int(str(pid.value))


def _failed_check(event: DagsterEvent) -> set[str]:
    check = event.asset_check_evaluation_data
    return set() if check.passed else {f"{check.asset_key.to_user_string()}.{check.check_name}"}


def _tag_failed_checks(plan_context: "PlanOrchestrationContext", failed: set[str]) -> None:
    """Name failed checks in an event and a tag of the run.

    Dagster colors a run by its steps alone: a check that does not block leaves it green.
    """
    run = plan_context.dagster_run
    if failed or FAILED_CHECKS_TAG in run.tags:  # a re-execution has the tags of its parent run
        text = ", ".join(sorted(failed)) or "none"
        plan_context.instance.add_run_tags(run.run_id, {FAILED_CHECKS_TAG: text})
        plan_context.instance.report_engine_event(f"Failed checks: {text}", run)


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
