"""Run tasks on a Ray cluster. The only module that imports ray.

Every machine of the cluster has the same version of this package and sees inputs under the same paths: augmented sets,
members, scenes and frozen ensembles. Results of studies are sent back, so their folders need not be shared.
"""

import contextlib
import dataclasses
import importlib.util
import logging
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any

from deltasafe.compute.executor import RETRIES, Needs, Task, worker_lost_error
from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_range

_log = logging.getLogger(__name__)
_ADDRESS = re.compile(r"(ray://)?[\w.-]+:\d{1,5}")
_POLL_S = 0.5


@dataclasses.dataclass(frozen=True)
class RaySettings:
    """Address of a cluster, and the resources that it gives to the training of one member.

    Attributes:
        address: ``auto`` for the cluster of this machine (`ray start`), ``host:port`` for a head node that is reached
            from within the cluster, ``ray://host:port`` from outside.
        cpus_per_member: cores and threads per member. Weights are bit-identical only with the same number of threads.
        gpus_per_member: fraction of a GPU per member; 0 trains on CPUs.
    """

    address: str = "auto"
    cpus_per_member: int = 1
    gpus_per_member: float = 0.0

    def __post_init__(self) -> None:
        if self.address != "auto" and not _ADDRESS.fullmatch(self.address):
            raise SettingsError(f"a Ray address is auto, host:port or ray://host:port, got {self.address!r}")
        check_range(self, "[1, inf)", "cpus_per_member")
        check_range(self, "[0, 1]", "gpus_per_member")


class RayExecutor:
    """Runs tasks on a Ray cluster, one core each. It connects when the first task is submitted.

    All tasks are submitted at once; the cluster runs as many in parallel as it has cores, and may grow. Ray ends the
    tasks of a driver process that was killed.

    Raises:
        SettingsError: ray is not installed.
    """

    def __init__(self, settings: RaySettings = RaySettings()) -> None:
        if importlib.util.find_spec("ray") is None:
            raise SettingsError("ray is not installed; pip install 'deltasafe[ray]', or use the local executor")
        self.settings = settings

    def rounds(self, n_tasks: int, workers: int) -> list[tuple[int, int]]:
        """Return one round of all tasks: the cluster decides how many run in parallel."""
        return [(n_tasks, self.settings.cpus_per_member)] if n_tasks else []

    def n_parallel(self, workers: int) -> int:
        """Return the current number of cores of the cluster; 1 without a cluster: finished work needs none."""
        try:
            return max(1, int(self._connected().cluster_resources().get("CPU", 1)))
        except SettingsError:
            return 1

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = Needs(),  # noqa: B008 - frozen
        on_report: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        """Run all tasks, as `deltasafe.compute.executor.Executor.run`; ``workers`` is ignored."""
        if not tasks:
            return
        ray = self._connected()
        gpus = self.settings.gpus_per_member if needs.gpu else 0.0
        _warn_if_nothing_fits(ray, needs.threads, gpus)
        remote = ray.remote(num_cpus=needs.threads, num_gpus=gpus, max_retries=RETRIES, retry_exceptions=False)(_call)
        with _report_queue(ray, on_report) as reports:
            report = () if reports is None else (_Report(reports),)
            pending = {
                remote.options(name=f"deltasafe {task.name}").remote(task.work, *report, *task.arguments): index
                for index, task in enumerate(tasks)
            }
            try:
                yield from _run_all(ray, tasks, pending, reports, on_report)
            finally:
                for reference in pending:
                    with contextlib.suppress(ray.exceptions.RayError):
                        ray.cancel(reference, force=True)

    def disconnect(self) -> None:
        """Close the connection, before the cluster ends; the next task connects again."""
        import ray

        ray.shutdown()

    def _connected(self) -> Any:
        import ray

        if not ray.is_initialized():
            try:
                ray.init(self.settings.address, log_to_driver=False, logging_level=logging.WARNING)
            except (ConnectionError, RuntimeError, ValueError) as error:
                reason = " ".join(str(error).split())[:200]
                raise SettingsError(
                    f"there is no Ray cluster at {self.settings.address!r} ({reason}); start one with `ray start "
                    "--head`, or set the address of a running one"
                ) from error
        return ray


def _call(work: Callable[..., Any], *arguments: Any) -> Any:
    return work(*arguments)


def _run_all(
    ray: Any, tasks: Sequence[Task], pending: dict[Any, int], reports: Any, on_report: Callable[[Any], None] | None
) -> Iterator[tuple[int, Any]]:
    while pending:
        finished, _ = ray.wait(list(pending), num_returns=len(pending), timeout=_POLL_S)
        _forward_reports(ray, reports, on_report)
        for reference in finished:
            index = pending.pop(reference)
            try:
                result = ray.get(reference)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            except ray.exceptions.RayError as error:
                raise worker_lost_error(tasks[index], " ".join(str(error).split())[:200]) from error
            yield index, result


@contextlib.contextmanager
def _report_queue(ray: Any, on_report: Callable[[Any], None] | None) -> Iterator[Any]:
    """Yield a queue on this machine; None without ``on_report``."""
    if on_report is None:
        yield None
        return
    from ray.util.queue import Queue
    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    here = NodeAffinitySchedulingStrategy(ray.get_runtime_context().get_node_id(), soft=True)
    reports = Queue(actor_options={"num_cpus": 0, "scheduling_strategy": here})
    try:
        yield reports
    finally:
        with contextlib.suppress(ray.exceptions.RayError):
            reports.shutdown(force=True)


def _forward_reports(ray: Any, reports: Any, on_report: Callable[[Any], None] | None) -> None:
    """Call ``on_report`` with all queued reports. A lost queue does not end the work."""
    if on_report is None:
        return
    try:
        for report in reports.get_nowait_batch(reports.qsize()):
            on_report(report)
    except ray.exceptions.RayError:
        _log.warning("the queue of progress reports was lost; the work continues")


@dataclasses.dataclass(frozen=True)
class _Report:
    queue: Any

    def __call__(self, report: Any) -> None:
        import ray

        with contextlib.suppress(ray.exceptions.RayError):
            self.queue.put(report)


def _warn_if_nothing_fits(ray: Any, cpus: int, gpus: float) -> None:
    """Log a warning if no machine is large enough: Ray waits for one without a message, since clusters grow."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    if not any(node.get("CPU", 0) >= cpus and node.get("GPU", 0) >= gpus for node in nodes):
        _log.warning("no machine of the Ray cluster has %d cores and %g GPUs; tasks wait until one joins", cpus, gpus)
