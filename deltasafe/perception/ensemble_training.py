"""All members of an ensemble, side by side: one process each, the machine's cores shared among them."""

import concurrent.futures
import dataclasses
import functools
import multiprocessing
import os
import pathlib
import queue
from collections.abc import Callable, Sequence
from typing import Any

import torch

from deltasafe.errors import SettingsError
from deltasafe.perception.augmented_set import AugmentedSet
from deltasafe.perception.member import Member
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training import StepReport, pick_device, train_member

__all__ = ["MemberJob", "train_members"]


@dataclasses.dataclass(frozen=True)
class MemberJob:
    """One member to train: its name, its seed, and the folder that it is written to."""

    name: str
    seed: int
    folder: pathlib.Path


def train_members(
    jobs: Sequence[MemberJob],
    data: str | pathlib.Path,
    settings: TrainingSettings,
    *,
    device: str = "auto",
    workers: int = 0,
    on_step: Callable[[str, StepReport], None] | None = None,
) -> dict[str, Member]:
    """Train the members of ``jobs``, ``workers`` at a time; each is resumed and found again as in `train_member`.

    Single-threaded processes side by side beat one process with all cores: nothing waits at barriers, which
    matters most on a machine that does other things as well. A last group that is smaller than ``workers``
    gets the spare cores as threads.

    Args:
        data: folder of the augmented set, memory-mapped by every process.
        workers: processes; 0 is one a core on a CPU, and one alone on a GPU.
        on_step: hears of every step of every member.

    Raises:
        SettingsError: ``workers`` is negative, or what `train_member` raises.
    """
    if workers < 0:
        raise SettingsError(f"workers must not be negative, got {workers}")
    cores = os.cpu_count() or 1
    workers = workers or (cores if pick_device(device).type == "cpu" else 1)
    trained: dict[str, Member] = {}
    for first in range(0, len(jobs), workers):
        group = jobs[first : first + workers]
        train = functools.partial(_train, data, settings, device, max(1, cores // len(group)), os.getpid())
        trained |= _side_by_side(train, group, on_step)
    return trained


def _side_by_side(
    train: Callable[[Any, MemberJob], Member],
    group: Sequence[MemberJob],
    on_step: Callable[[str, StepReport], None] | None,
) -> dict[str, Member]:
    context = multiprocessing.get_context("spawn")
    with context.Manager() as manager, concurrent.futures.ProcessPoolExecutor(len(group), context) as pool:
        steps = manager.Queue()
        futures = {job.name: pool.submit(train, steps, job) for job in group}
        waiting = set(futures.values())
        while waiting or not steps.empty():
            try:
                name, report = steps.get(timeout=0.5)
            except queue.Empty:
                waiting = {future for future in waiting if not future.done()}
            else:
                if on_step is not None:
                    on_step(name, report)
        return {name: future.result() for name, future in futures.items()}


def _train(
    data: str | pathlib.Path,
    settings: TrainingSettings,
    device: str,
    n_threads: int,
    parent: int,
    steps: Any,
    job: MemberJob,
) -> Member:
    torch.set_num_threads(n_threads)

    def report(step: StepReport) -> None:
        if os.getppid() != parent:
            raise SystemExit("the process that asked for this member is gone; its checkpoint will be continued")
        steps.put((job.name, step))

    return train_member(AugmentedSet.load(data), settings, job.seed, job.folder, device, report)
