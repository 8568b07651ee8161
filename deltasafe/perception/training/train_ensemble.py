"""Training of all members of an ensemble in parallel, one process per member."""

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
from deltasafe.perception.training.device import pick_device
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_member import StepReport, train_member, training_identity


@dataclasses.dataclass(frozen=True)
class MemberJob:
    """One member to train: name, seed, and destination folder."""

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

    A second call reuses finished members and resumes interrupted ones: a subfolder is named by the digest of settings,
    data and seed.

    Args:
        n_members: M.
        device: ``cpu``, ``cuda`` or ``auto``.
        workers: members trained at a time; 0 is one per core on a CPU and one on a GPU. Each member is trained in a
            process of its own, so a script needs the guard ``if __name__ == "__main__":``.
        on_step: called with the member's name and a `StepReport` after every step.

    Raises:
        SettingsError: ``n_members`` is less than 1, or for the reasons of `train_members`.
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
    """Train ``workers`` members at a time; each is reused or resumed as in `train_member`.

    Single-threaded processes in parallel are faster than one process with all cores, because they have no thread
    barriers. If the last group is smaller, its processes get more threads each.

    Args:
        data: folder of the augmented set. It and the members' folders must be reachable from the executor's workers.
        workers: processes; 0 means one per core on a CPU, and one on a GPU.
        on_step: called with the member's name and a report after each step of each member.
        executor: runs the trainings. A member whose process is lost resumes from its checkpoint.

    Raises:
        SettingsError: ``workers`` is negative, or for the reasons of `train_member`.
        WorkerLostError: a member's process was lost repeatedly.
    """
    if workers < 0:
        raise SettingsError(f"workers must not be negative, got {workers}")
    workers = workers or ((os.cpu_count() or 1) if pick_device(device).type == "cpu" else 1)
    trained: dict[str, Member] = {}

    def forward_report(report: tuple[str, StepReport]) -> None:
        if on_step is not None:
            on_step(*report)

    for size, n_threads in executor.rounds(len(jobs), workers):
        group = jobs[len(trained) : len(trained) + size]
        tasks = [Task(f"training of {job.name}", _train, (data, settings, device, n_threads, job)) for job in group]
        needs = Needs(n_threads, gpu=device != "cpu", own_process=True)
        with contextlib.closing(executor.run(tasks, size, needs, forward_report)) as results:
            members = dict(results)
        trained |= {job.name: members[index] for index, job in enumerate(group)}
    return trained


def _train(
    send: Callable[[tuple[str, StepReport]], None],
    data: str | pathlib.Path,
    settings: TrainingSettings,
    device: str,
    n_threads: int,
    job: MemberJob,
) -> Member:
    torch.set_num_threads(n_threads)
    augmented = AugmentedSet.load(data)
    return train_member(augmented, settings, job.seed, job.folder, device, lambda step: send((job.name, step)))
