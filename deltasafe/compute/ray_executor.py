"""Long work on a Ray cluster; the only importer of ray.

Every machine of the cluster has this package at the same version, and sees inputs under the same paths: augmented sets
and members' folders, scenes and frozen ensembles. Batches of studies are sent back and need no shared folder.
"""

import contextlib
import dataclasses
import importlib.util
import logging
import math
import re
from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any

from deltasafe.compute.executor import RETRIES, Needs, Task, lost
from deltasafe.errors import SettingsError

__all__ = ["RayExecutor", "RaySettings"]

_log = logging.getLogger(__name__)
_ADDRESS = re.compile(r"(ray://)?[\w.-]+:\d{1,5}")
_LISTEN_S = 0.5


@dataclasses.dataclass(frozen=True)
class RaySettings:
    """A cluster, and what of it a member gets.

    Attributes:
        address: ``auto`` for the cluster that this machine is part of (`ray start`), ``host:port`` for its head as seen
            from a machine of the cluster, ``ray://host:port`` from outside.
        cpus_per_member: cores, and threads, of a member's training. Sums over other numbers of threads are other sums.
        gpus_per_member: share of a GPU of a member's training; 0 trains on CPUs.
    """

    address: str = "auto"
    cpus_per_member: int = 1
    gpus_per_member: float = 0.0

    def __post_init__(self) -> None:
        if self.address != "auto" and not _ADDRESS.fullmatch(self.address):
            raise SettingsError(f"a Ray address is auto, host:port or ray://host:port, got {self.address!r}")
        if self.cpus_per_member < 1:
            raise SettingsError(f"cpus_per_member must be at least 1, got {self.cpus_per_member}")
        if not (math.isfinite(self.gpus_per_member) and 0 <= self.gpus_per_member <= 1):
            raise SettingsError(f"gpus_per_member must lie in [0, 1], got {self.gpus_per_member}: none uses two")


class RayExecutor:
    """Tasks on a Ray cluster, one core each; connected at the first.

    All tasks are given to the cluster at once, which does as many side by side as it has cores, and may grow. It ends
    what a driver left behind that was killed.

    Raises:
        SettingsError: ray is not installed.
    """

    def __init__(self, settings: RaySettings = RaySettings()) -> None:
        if importlib.util.find_spec("ray") is None:
            raise SettingsError("the executor ray is not installed; pip install 'deltasafe[ray]', or use the local one")
        self.settings = settings

    def rounds(self, n_tasks: int, workers: int) -> list[tuple[int, int]]:
        """One round of all; how many are side by side is the cluster's affair."""
        return [(n_tasks, self.settings.cpus_per_member)] if n_tasks else []

    def width(self, workers: int) -> int:
        """Cores of the cluster, as it is now; 1 if it is not there, since what is finished is found without it."""
        try:
            return max(1, int(self._connected().cluster_resources().get("CPU", 1)))
        except SettingsError:
            return 1

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = Needs(),  # noqa: B008 - frozen
        hear: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        """See `deltasafe.compute.executor.Engine`."""
        if not tasks:
            return
        ray = self._connected()
        gpus = self.settings.gpus_per_member if needs.gpu else 0.0
        _say_if_nothing_fits(ray, needs.threads, gpus)
        remote = ray.remote(num_cpus=needs.threads, num_gpus=gpus, max_retries=RETRIES, retry_exceptions=False)(_do)
        with _reports(ray, hear) as reports:
            told = () if reports is None else (_Tell(reports),)
            pending = {
                remote.options(name=f"deltasafe {task.name}").remote(task.work, *told, *task.arguments): index
                for index, task in enumerate(tasks)
            }
            try:
                yield from _all(ray, tasks, pending, reports, hear)
            finally:
                for one in pending:
                    with contextlib.suppress(ray.exceptions.RayError):
                        ray.cancel(one, force=True)

    def disconnect(self) -> None:
        """End this process's connection, before the cluster ends; the next tasks connect anew."""
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
                    "--head`, or name the one that there is"
                ) from error
        return ray


def _do(work: Callable[..., Any], *arguments: Any) -> Any:
    return work(*arguments)


def _all(
    ray: Any, tasks: Sequence[Task], pending: dict[Any, int], reports: Any, hear: Callable[[Any], None] | None
) -> Iterator[tuple[int, Any]]:
    while pending:
        ended, _ = ray.wait(list(pending), num_returns=len(pending), timeout=_LISTEN_S)
        _hear_all(ray, reports, hear)
        for one in ended:
            index = pending.pop(one)
            try:
                result = ray.get(one)
            except ray.exceptions.RayTaskError as error:
                raise error.cause from error
            except ray.exceptions.RayError as error:
                raise lost(tasks[index], " ".join(str(error).split())[:200]) from error
            yield index, result


@contextlib.contextmanager
def _reports(ray: Any, hear: Callable[[Any], None] | None) -> Iterator[Any]:
    """A queue on the machine of this process, if somebody listens."""
    if hear is None:
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


def _hear_all(ray: Any, reports: Any, hear: Callable[[Any], None] | None) -> None:
    """What was reported so far; a queue that is gone is no reason to end the work."""
    if hear is None:
        return
    try:
        for report in reports.get_nowait_batch(reports.qsize()):
            hear(report)
    except ray.exceptions.RayError:
        _log.warning("progress is no longer heard of; the work goes on")


@dataclasses.dataclass(frozen=True)
class _Tell:
    reports: Any

    def __call__(self, report: Any) -> None:
        import ray

        with contextlib.suppress(ray.exceptions.RayError):
            self.reports.put(report)


def _say_if_nothing_fits(ray: Any, cpus: int, gpus: float) -> None:
    """Ray waits in silence for a machine that is large enough, since clusters grow."""
    nodes = [node["Resources"] for node in ray.nodes() if node["Alive"]]
    if not any(node.get("CPU", 0) >= cpus and node.get("GPU", 0) >= gpus for node in nodes):
        _log.warning(
            "no machine of the Ray cluster has %d cores and %g GPUs: the work waits for one that has", cpus, gpus
        )
