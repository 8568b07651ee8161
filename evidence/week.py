"""A week of operation in fast motion: trainings on one home, with terminations, kills, decisions and a full disk.

After every run: each run has ended, no process and no pool slot is left, the champion loads and is what registry and
pointer say, and the home is pruned. Resumable: the home keeps one line per run in ``week.jsonl``.
"""

import argparse
import contextlib
import dataclasses
import json
import os
import pathlib
import resource
import signal
import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from random import Random

import dagster as dg

from deltasafe.errors import DataError
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from evidence.reporting import command_parser, finish, print_progress
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.home import prepare_home
from pipelines.retention import Retention, RetentionSettings
from pipelines.storage.io_manager import FolderPointers
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


@dataclasses.dataclass
class Day:
    """One run and what was found after it.

    Attributes:
        event: what happened to it.
        unfinished: runs without a final state.
        orphans: processes that were left after 10 s.
        slots: pool slots that were left.
        fault: what is wrong with the champion; empty if nothing is.
        megabytes: size of the home after pruning.
    """

    event: str
    unfinished: int
    orphans: int
    slots: int
    fault: str
    megabytes: float


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``python -m evidence.week``; 1 if something was found."""
    parser = command_parser("week", __doc__, seeded=True)
    parser.add_argument("--home", type=pathlib.Path, required=True, help="home of the runs; one that exists is resumed")
    parser.add_argument("--runs", type=int, default=200, help="number of runs (default 200)")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--full-disk", action="store_true", help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.full_disk:
        resource.setrlimit(resource.RLIMIT_FSIZE, (_FILE_LIMIT_BYTES, _FILE_LIMIT_BYTES))
    if options.child is not None:
        return _train(options.child)
    os.environ |= {"DELTASAFE_HOME": str(options.home), "DELTASAFE_PRESET": "smoke"}
    home, progress = prepare_home(), print_progress(1)
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


def _train(number: int) -> int:
    from pipelines.commands.run_job import run_to_end

    prepare_home()
    return 0 if run_to_end("perception", {"ensemble_member": {"first_seed": 100 * number}}, "the next run") else 1


def _day(home: pathlib.Path, instance: dg.DagsterInstance, number: int, event: str, random: Random) -> Day:
    registry = EnsembleRegistry(MlflowTracker(home))
    _decide(registry, event, random)
    command = [sys.executable, "-m", "evidence.week", "--home", str(home), "--child", str(number)]
    command += ["--full-disk"] if event == "full disk" else []
    with (home / "week.log").open("a") as log:
        child = subprocess.Popen(command, stdout=log, stderr=log, start_new_session=True)
        if event in ("terminate", "kill"):
            with contextlib.suppress(subprocess.TimeoutExpired):
                child.wait(timeout=random.uniform(5.0, 60.0))
            child.send_signal(signal.SIGTERM if event == "terminate" else signal.SIGKILL)
        child.wait()
    orphans = _left(home)
    fail_lost_runs(instance)
    end_leftover_processes(instance)
    reconcile(registry, instance)
    fault = _fault(registry, instance)
    retention = Retention(home, instance, KEPT)
    retention.prune(retention.survey())
    finished = (dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED)
    unfinished = sum(run.status not in finished for run in instance.get_runs())
    slots = instance.event_log_storage.get_concurrency_info("all_cores").active_slot_count
    megabytes = retention.disk_use([])[-1]["MB"]
    return Day(event, unfinished, len(orphans), slots, fault or _fault(registry, instance), megabytes)


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
    """Return the processes of the home that are left after some seconds, except this one; kill them."""
    marker, deadline = f"DELTASAFE_HOME={home}".encode(), time.monotonic() + _EXIT_S
    while True:
        left = []
        for folder in pathlib.Path("/proc").glob("[0-9]*"):
            with contextlib.suppress(OSError):
                if int(folder.name) != os.getpid() and marker in (folder / "environ").read_bytes().split(b"\0"):
                    left.append(int(folder.name))
        if not left or time.monotonic() > deadline:
            break
        time.sleep(0.5)
    for pid in left:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
    return left


if __name__ == "__main__":
    sys.exit(main())
