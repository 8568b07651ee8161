"""All members of an ensemble, side by side: one process each, the cores of a machine shared among them."""

import contextlib
import dataclasses
import os
import pathlib
from collections.abc import Callable, Sequence

import torch

from deltasafe.compute.executor import LOCAL, Executor, Needs, Task
from deltasafe.errors import SettingsError
from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_member import StepReport, pick_device, train_member, training_identity

__all__ = ["MemberJob", "train_ensemble", "train_members"]


@dataclasses.dataclass(frozen=True)
class MemberJob:
    """One member to train: its name, its seed, and the folder that it is written to."""

    name: str
    seed: int
    folder: pathlib.Path


def train_ensemble(
    data: AugmentedSet,
    folder: str | pathlib.Path,
    settings: TrainingSettings | None = None,
    n_members: int = 5,
    *,
    device: str = "auto",
    workers: int = 0,
    on_step: Callable[[str, StepReport], None] | None = None,
) -> list[Member]:
    """Train ``n_members`` members with seeds 0, 1, ... into subfolders of ``folder``.

    A second call finds finished members and resumes interrupted ones.

    Args:
        folder: each member's subfolder is named by the digest of settings, data and seed.
        device, workers, on_step: see `train_members`.

    Raises:
        SettingsError: ``n_members`` is less than 1, or see `train_members`.
    """
    if n_members < 1:
        raise SettingsError(f"n_members must be at least 1, got {n_members}")
    settings = settings or TrainingSettings()
    jobs = [
        MemberJob(f"member_{seed}", seed, pathlib.Path(folder) / training_identity(data, settings, seed)[:16])
        for seed in range(n_members)
    ]
    trained = train_members(jobs, data.folder, settings, device=device, workers=workers, on_step=on_step)
    return [trained[job.name] for job in jobs]


def train_members(
    jobs: Sequence[MemberJob],
    data: str | pathlib.Path,
    settings: TrainingSettings,
    *,
    device: str = "auto",
    workers: int = 0,
    on_step: Callable[[str, StepReport], None] | None = None,
    executor: Executor = LOCAL,
) -> dict[str, Member]:
    """Train the members of ``jobs``, ``workers`` at a time; each is resumed and found again as in `train_member`.

    Single-threaded processes side by side beat one process with all cores: nothing waits at barriers, which
    matters most on a machine that does other things as well. A last group that is smaller than ``workers``
    gets the spare cores as threads.

    Args:
        data: folder of the augmented set, memory-mapped by every process; it and the members' folders are seen from
            wherever the executor trains.
        workers: processes of this machine; 0 is one a core on a CPU, and one alone on a GPU.
        on_step: hears of every step of every member.
        executor: where they are trained. A member whose process is lost goes on from its checkpoint.

    Raises:
        SettingsError: ``workers`` is negative, or what `train_member` raises.
        WorkerLostError: a member's process was lost again and again.
    """
    if workers < 0:
        raise SettingsError(f"workers must not be negative, got {workers}")
    workers = workers or ((os.cpu_count() or 1) if pick_device(device).type == "cpu" else 1)
    trained: dict[str, Member] = {}

    def hear(report: tuple[str, StepReport]) -> None:
        if on_step is not None:
            on_step(*report)

    for size, n_threads in executor.rounds(len(jobs), workers):
        group = jobs[len(trained) : len(trained) + size]
        tasks = [Task(f"training of {job.name}", _train, (data, settings, device, n_threads, job)) for job in group]
        needs = Needs(n_threads, gpu=device != "cpu", apart=True)
        with contextlib.closing(executor.run(tasks, size, needs, hear)) as finished:
            made = dict(finished)
        trained |= {job.name: made[index] for index, job in enumerate(group)}
    return trained


def _train(
    tell: Callable[[tuple[str, StepReport]], None],
    data: str | pathlib.Path,
    settings: TrainingSettings,
    device: str,
    n_threads: int,
    job: MemberJob,
) -> Member:
    torch.set_num_threads(n_threads)

    def report(step: StepReport) -> None:
        tell((job.name, step))

    return train_member(AugmentedSet.load(data), settings, job.seed, job.folder, device, report)
