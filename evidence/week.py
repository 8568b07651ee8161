"""A week of operation in fast motion: trainings on one home, with terminations, kills, decisions and a full disk.

After every run: each run has ended, no process and no pool slot is left, the champion loads and is what registry and
pointer say, and the home is pruned. Resumable: the home keeps one line per run in ``week.jsonl``.

The runs train on a few small copies of the packaged images, so that a run takes seconds. Runs that are terminated or
killed have steps and trainings in processes of their own, as in operation. The others run in one process, forked from
a process that has imported torch, Dagster and MLflow already.
"""

import contextlib
import dataclasses
import json
import multiprocessing
import os
import pathlib
import resource
import signal
import statistics
import sys
import time
from collections.abc import Callable, Generator, Sequence
from random import Random
from typing import Any

import dagster as dg

from deltasafe.compute.executor import LocalExecutor, Needs, Task
from deltasafe.compute.processes import parent_of
from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_folder
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from evidence.reporting import command_parser, finish, print_progress
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.home import DATASETS, prepare_home
from pipelines.retention import Retention, RetentionSettings
from pipelines.storage.io_manager import FolderPointers
from pipelines.supervision import supervised
from pipelines.tracking.model_versions import CHAMPION, MODEL_NAME
from pipelines.tracking.reconciliation import reconcile
from pipelines.tracking.registry import EnsembleRegistry
from pipelines.tracking.tracker import MlflowTracker

EVENTS = ("none", "none", "terminate", "kill", "rollback", "move alias")
KEPT = RetentionSettings(runs=3, days=0.0, versions=3)
MAX_GROWTH = 1.1
_EXIT_S = 10.0
_FILE_LIMIT_BYTES = 300_000
"""Stands for a full disk: larger files cannot be written."""
_INTERRUPTED = ("terminate", "kill")
_SIZE_PX = (128, 96)
_N_IMAGES = {"train": 10, "test": 6}
_STEPS: dict[str, Any] = {
    "augmented_hands": {"augmentation": {"n_variants": 2, "width": 64, "height": 48}, "workers": 1},
    "calibration_report": {"calibration": {"n_bootstrap": 100, "n_folds": 2}},
    "champion": {"n_bootstrap": 100},
}
_SETS = {"raw_hands": "train", "test_hands": "test"}
_NEEDS = Needs()
_TRAINING = {"epochs": 9, "batch_size": 4}
_PRELOADED = [
    *("albumentations", "matplotlib.pyplot", "mlflow.pyfunc", "onnxruntime", "onnxscript", "timm", "torch"),
    *("torch._dynamo", "torch.export", "torch.onnx", "torchvision"),
    *("pipelines.definitions", "pipelines.retention", "pipelines.tracking.registry"),
    *("deltasafe.perception.artifact.frozen_ensemble", "deltasafe.perception.evaluate_and_freeze"),
]
"""A failure to import is ignored."""


@dataclasses.dataclass
class Day:
    """One run and what was found after it.

    Attributes:
        event: what happened to it.
        status: final state of the run.
        unfinished: runs without a final state.
        orphans: processes that were left after 10 s.
        slots: pool slots that were left.
        fault: what is wrong with the champion; empty if nothing is.
        megabytes: size of the home after pruning.
        seconds: duration.
    """

    event: str
    status: str
    unfinished: int
    orphans: int
    slots: int
    fault: str
    megabytes: float
    seconds: float = 0.0


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m evidence.week``; 1 if something was found."""
    parser = command_parser("week", __doc__, seeded=True)
    parser.add_argument("--home", type=pathlib.Path, required=True, help="home of the runs; one that exists is resumed")
    parser.add_argument("--runs", type=int, default=200, help="number of runs (default 200)")
    options = parser.parse_args(arguments)
    os.environ |= {"DELTASAFE_HOME": str(options.home.resolve()), "DELTASAFE_PRESET": "smoke", "OMP_NUM_THREADS": "1"}
    home, progress = prepare_home(), print_progress(1)
    for name, count in _N_IMAGES.items():
        _write_small(DATASETS / "hands" / name, home / "hands" / name, count)
    multiprocessing.set_forkserver_preload(_PRELOADED)
    log = home / "week.jsonl"
    days = [Day(**json.loads(line)) for line in log.read_text().splitlines()] if log.is_file() else []
    while len(days) < options.runs:
        random = Random(f"{options.seed} {len(days)}")
        event = "full disk" if len(days) == options.runs // 2 else random.choice(EVENTS)
        with dg.DagsterInstance.get() as instance:
            days.append(_day(home, instance, len(days), event, random))
        with log.open("a") as file:
            file.write(json.dumps(dataclasses.asdict(days[-1])) + "\n")
        progress(len(days), options.runs, str(days[-1]))
    sizes = [day.megabytes for day in days]
    third = max(1, len(sizes) // 3)
    growth = statistics.median(sizes[-third:]) / statistics.median(sizes[third : 2 * third] or sizes)
    figures = {
        "week_runs": len(days),
        "week_lost": sum(day.unfinished for day in days),
        "week_orphans": sum(day.orphans for day in days),
        "week_slots_left": sum(day.slots for day in days),
        "week_champion_faults": sum(bool(day.fault) for day in days),
        "week_disk_growth": round(growth, 3),
        "disk_growth_bounded": growth <= MAX_GROWTH,
    }
    found = [
        f"run {number}: {day}"
        for number, day in enumerate(days)
        if day.unfinished or day.orphans or day.slots or day.fault
    ]
    return finish(options, figures, found, events=[day.event for day in days], megabytes=sizes)


def _write_small(source: pathlib.Path, folder: pathlib.Path, count: int) -> None:
    """Write small copies of the first labeled images of a set."""
    import cv2
    import numpy as np

    if folder.is_dir():
        return
    with atomic_folder(folder) as temporary:
        for part, shrink in (("images", cv2.INTER_AREA), ("masks", cv2.INTER_NEAREST)):
            (temporary / part).mkdir(parents=True)
            for path in sorted((source / part).iterdir())[:count]:
                picture = cv2.resize(
                    np.asarray(cv2.imread(str(path), cv2.IMREAD_UNCHANGED)), _SIZE_PX, interpolation=shrink
                )
                cv2.imwrite(str(temporary / part / f"{path.stem}.png"), picture)


def _train(home: pathlib.Path, number: int, event: str) -> None:
    """Make run ``number``; called in a new process."""
    os.setsid()
    with (home / "week.log").open("a") as log:
        for stream in (1, 2):
            os.dup2(log.fileno(), stream)
    if event == "full disk":
        resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_LIMIT_BYTES, _FILE_LIMIT_BYTES))
    prepare_home()

    from pipelines.commands.run_job import execute, run_to_end

    # a longer training is interrupted more often
    training = {**_TRAINING, "epochs": 30} if event in _INTERRUPTED else _TRAINING
    sets = {asset: {"folder": str(home / "hands" / name)} for asset, name in _SETS.items()}
    steps = {**_STEPS, **sets, "ensemble_member": {"first_seed": 100 * number, "training": training, "workers": 2}}
    if event in _INTERRUPTED:
        run_to_end("perception", steps, "the next run")
        return
    config = {"ops": {step: {"config": settings} for step, settings in steps.items()}}
    with dg.DagsterInstance.get() as instance:
        execute(dg.build_reconstructable_job("evidence.week", job_in_process.__name__), instance, config)
    print(f"run {number} took {time.process_time():.0f} s of CPU time", flush=True)


def job_in_process() -> dg.JobDefinition:
    """Return the job `perception` with steps and trainings in the process of the run."""
    from pipelines.commands.run_job import job_named

    job = job_named("perception").with_executor_def(supervised(dg.in_process_executor))
    here = dg.ResourceDefinition.hardcoded_resource(_InProcess())
    return job.with_top_level_resources({**job.resource_defs, "executor": here})


class _InProcess(LocalExecutor):
    """Runs all tasks one after the other in this process: a new one would import torch for seconds."""

    def rounds(self, n_tasks: int, workers: int) -> list[tuple[int, int]]:
        return [(1, 1)] * n_tasks

    def run(
        self,
        tasks: Sequence[Task],
        workers: int,
        needs: Needs = _NEEDS,
        on_report: Callable[[Any], None] | None = None,
    ) -> Generator[tuple[int, Any], None, None]:
        for index, task in enumerate(tasks):
            yield index, task.work(*([] if on_report is None else [on_report]), *task.arguments)


def _day(home: pathlib.Path, instance: dg.DagsterInstance, number: int, event: str, random: Random) -> Day:
    registry, began_s = EnsembleRegistry(MlflowTracker(home)), time.monotonic()
    _decide(registry, event, random)
    child = multiprocessing.get_context("forkserver").Process(target=_train, args=(home, number, event))
    child.start()
    if event in _INTERRUPTED:
        child.join(timeout=random.uniform(5.0, 60.0))
        if child.is_alive() and child.pid is not None:
            os.kill(child.pid, signal.SIGTERM if event == "terminate" else signal.SIGKILL)
    child.join()
    orphans = _left(home)
    fail_lost_runs(instance)
    end_leftover_processes(instance)
    reconcile(registry, instance)
    fault = _fault(registry, instance)
    retention = Retention(home, instance, KEPT)
    retention.prune(retention.survey())
    unfinished = sum(not run.is_finished for run in instance.get_runs())
    status = instance.get_runs(limit=1)[0].status.value
    slots = instance.event_log_storage.get_concurrency_info("all_cores").active_slot_count
    megabytes = retention.disk_use([])[-1]["MB"]
    fault = fault or _fault(registry, instance)
    seconds = round(time.monotonic() - began_s, 1)
    return Day(event, status, unfinished, len(orphans), slots, fault, megabytes, seconds)


def _decide(registry: EnsembleRegistry, event: str, random: Random) -> None:
    """Decide by command, or behind the back of the project, if there are enough versions."""
    if event == "rollback":
        with contextlib.suppress(DataError):  # no earlier version
            registry.rollback("a week in fast motion")
    if event == "move alias":
        with registry.tracker.records() as records:
            versions = records.versions()
            if versions:
                chosen = random.choice(versions).version
                records.client.set_registered_model_alias(MODEL_NAME, CHAMPION, chosen)


def _fault(registry: EnsembleRegistry, instance: dg.DagsterInstance) -> str:
    """Return what is wrong with the champion; empty if there is none yet, or if all agree and it loads."""
    folder = registry.champion()
    if folder is None:
        return ""
    with registry.tracker.records() as records:
        version = records.champion()
    pointed = FolderPointers(home=str(registry.tracker.home)).folder(dg.AssetKey("champion"), instance=instance)
    if version is None or {version.tags["artifact"], pointed.name} != {folder.name}:
        return f"note {folder.name}, pointer {pointed.name}, alias {version and version.tags['artifact']}"
    load_ensemble(folder)
    return ""


def _left(home: pathlib.Path) -> list[int]:
    """Return the processes of the home that are left after some seconds, except this one and its helpers; kill them."""
    marker, deadline = f"DELTASAFE_HOME={home}".encode(), time.monotonic() + _EXIT_S
    while True:
        left = []
        for folder in pathlib.Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                pid = int(folder.name)
                is_helper = os.getpid() in (pid, parent_of(pid))
                if not is_helper and marker in (folder / "environ").read_bytes().split(b"\0"):
                    left.append(pid)
        if not left or time.monotonic() > deadline:
            break
        time.sleep(0.5)
    for pid in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return left


if __name__ == "__main__":
    sys.exit(main())
