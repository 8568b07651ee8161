"""SIGKILL steps, run workers and daemons under Dagster: every run ends within two minutes, and no process is left.

``--without parent_watchdog`` and ``--without lost_runs`` switch off one protection of the project, to show its effect.
"""

import collections
import contextlib
import dataclasses
import math
import os
import pathlib
import signal
import subprocess
import sys
import time
from collections.abc import Collection, Iterable, Mapping
from random import Random

import dagster as dg

from deltasafe.compute.progress import Progress, silent
from evidence.fixtures import temporary_home
from evidence.reporting import command_parser, finish, print_progress
from pipelines.home import PROJECT, prepare_home
from pipelines.supervision import process_of

LOCATION = "evidence.faults.dagster_location"
PROTECTIONS = ("parent_watchdog", "lost_runs")
EVERYTHING = "everything"
"""The run worker, the daemon and its code servers, as when a machine goes down; steps keep running."""
ENDED = (dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED)
EXIT_S = 8.0
"""Time that processes get to exit after the last run; shorter than a step of `dagster_location.beside` takes."""
SERVICES = ("dagster._daemon", "grpc", "resource_tracker")
"""Parts of the command lines of processes that may stay when no run is left."""


@dataclasses.dataclass(frozen=True)
class KillSettings:
    """How runs are killed.

    Attributes:
        kinds: what is killed, drawn at random for each run.
        concurrent_runs: runs that are started together; the home allows four.
        during: the step that must have started before its run is hit; empty for any.
        timeout_s: a run that has not ended by then is stuck.
    """

    kinds: tuple[str, ...] = ("step", "step", "run worker", "run worker", "daemon", EVERYTHING)
    concurrent_runs: int = 4
    during: str = ""
    timeout_s: float = 120.0


class Deployment:
    """A home with a daemon that starts one run per request.

    Args:
        home: a new folder.
        without: protections that are switched off.
    """

    def __init__(self, home: pathlib.Path, without: Collection[str] = ()) -> None:
        for folder in ("requests", "without"):
            (home / folder).mkdir(parents=True)
        os.environ["DELTASAFE_HOME"] = str(home)
        self.home = prepare_home()
        self.instance = dg.DagsterInstance.get()
        self._n_requests = 0
        self.switch_off(without)
        self.start_daemon()

    def switch_off(self, protections: Collection[str]) -> None:
        """Switch these protections off and all others on."""
        for name in PROTECTIONS:
            flag = self.home / "without" / name
            if name in protections:
                flag.touch()
            else:
                flag.unlink(missing_ok=True)

    def start_daemon(self) -> None:
        """Start a new daemon."""
        command = [sys.executable, "-m", "dagster._daemon", "run", "-m", LOCATION, "-d", str(PROJECT)]
        with (self.home / "daemon.log").open("a") as log:
            self.daemon = subprocess.Popen(command, cwd=PROJECT, stdout=log, stderr=log, start_new_session=True)

    def close(self) -> None:
        """Kill all processes of this home."""
        _kill(self.processes())
        self.daemon.wait()
        self.instance.dispose()

    def request_run(self) -> str:
        """Request a run; return its name."""
        self._n_requests += 1
        name = f"{self._n_requests:05d}"
        (self.home / "requests" / name).touch()
        return name

    def run(self, name: str) -> dg.DagsterRun | None:
        """Return the run of a request, or None if it is not launched yet."""
        return next(iter(self.instance.get_runs(dg.RunsFilter(tags={"request": name}))), None)

    def processes(self) -> dict[int, str]:
        """Return PID and command line of all processes of this home except this one."""
        marker, found = f"DELTASAFE_HOME={self.home}".encode(), {}
        for folder in pathlib.Path("/proc").glob("[0-9]*"):
            try:
                if int(folder.name) == os.getpid() or marker not in (folder / "environ").read_bytes().split(b"\0"):
                    continue
                command = (folder / "cmdline").read_bytes()
            except OSError:
                continue
            found[int(folder.name)] = command.replace(b"\0", b" ").decode(errors="replace")
        return found

    def run_processes(self) -> dict[int, str]:
        """Return the processes that belong to a run."""
        return {pid: command for pid, command in self.processes().items() if not _is_service(command)}

    def left_over(self) -> list[str]:
        """Return the command lines of run processes that have not exited some seconds after the last run."""
        deadline, left = time.monotonic() + EXIT_S, [""]
        while left and time.monotonic() < deadline:
            time.sleep(0.5)
            left = list(self.run_processes().values())
        return left

    def kill(self, kind: str, name: str) -> bool:
        """Kill the daemon or a process of the run ``name``; False if there is no such process."""
        if kind == EVERYTHING:
            killed = self.kill("run worker", name)
            _kill(pid for pid, command in self.processes().items() if _is_service(command))
            self.daemon.wait()
            return killed
        if kind == "daemon":
            self.daemon.kill()
            self.daemon.wait()
            return True
        pid = self._pid_of(kind, name)
        return pid is not None and _kill([pid]) == 1

    def has_ended(self, name: str) -> bool:
        """Tell whether the run has ended."""
        run = self.run(name)
        return run is not None and run.is_finished

    def can_be_hit(self, kind: str, name: str, during: str) -> bool:
        """Tell whether the run has started (and the step ``during``, if given) and has a process of this kind."""
        run = self.run(name)
        if run is None or run.status in (dg.DagsterRunStatus.NOT_STARTED, dg.DagsterRunStatus.QUEUED):
            return False
        started = self.instance.all_logs(run.run_id, of_type=dg.DagsterEventType.STEP_START) if during else []
        if during and not any(entry.step_key == during for entry in started):
            return run.is_finished
        return kind != "step" or run.is_finished or self._pid_of(kind, name) is not None

    def _pid_of(self, kind: str, name: str) -> int | None:
        run = self.run(name)
        if run is None or run.is_finished:
            return None
        if kind == "run worker":
            worker = process_of(self.instance, run.run_id)
            return None if worker is None else worker.pid
        ends = {dg.DagsterEventType.STEP_SUCCESS, dg.DagsterEventType.STEP_FAILURE}
        ended = {entry.step_key for entry in self.instance.all_logs(run.run_id, of_type=ends)}
        for entry in self.instance.all_logs(run.run_id, of_type=dg.DagsterEventType.STEP_WORKER_STARTED):
            if entry.step_key not in ended and entry.dagster_event is not None:
                pid = entry.dagster_event.engine_event_data.metadata.get("pid")
                if pid is not None:
                    return int(str(pid.value))
        return None


@dataclasses.dataclass
class Outcome:
    """Number of kills by kind, final states of the runs, failures, and the longest time from a kill to an end."""

    kills: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    ends: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    failures: list[str] = dataclasses.field(default_factory=list)
    longest_s: float = 0.0


def kill_under_dagster(
    deployment: Deployment, count: int, seed: int, settings: KillSettings | None = None, progress: Progress = silent
) -> Outcome:
    """Start runs in groups and hit each of them once, until there are ``count`` kills or five failures."""
    settings = settings or KillSettings()
    random, outcome = Random(seed), Outcome()
    while outcome.kills.total() < count and len(outcome.failures) < 5:
        names = [deployment.request_run() for _ in range(settings.concurrent_runs)]
        kinds = {name: random.choice(settings.kinds) for name in names}
        hit_s = _hit_runs(deployment, kinds, settings, random, outcome)
        for name in names:
            while (run := deployment.run(name)) is None or run.status not in ENDED:
                if time.monotonic() - hit_s[name] > settings.timeout_s:
                    state = run.status.value if run else "none"
                    outcome.failures.append(f"run {name}: {state} after {settings.timeout_s:g} s")
                    break
                time.sleep(0.25)
            outcome.longest_s = max(outcome.longest_s, time.monotonic() - hit_s[name])
            outcome.ends[run.status.value if run else "none"] += 1
        outcome.failures += [f"left over after {names}: {command}" for command in deployment.left_over()]
        done = min(outcome.kills.total(), count)
        progress(done, count, f"{len(outcome.failures)} failures, longest {outcome.longest_s:.0f} s")
    return outcome


def _hit_runs(
    deployment: Deployment, kinds: Mapping[str, str], settings: KillSettings, random: Random, outcome: Outcome
) -> dict[str, float]:
    """Hit each run once, at a random instant after it can be hit; return the times."""
    due_s: dict[str, float] = {}
    hit_s: dict[str, float] = {}
    deadline = time.monotonic() + 120.0
    while len(hit_s) < len(kinds):
        for name, kind in kinds.items():
            expired = time.monotonic() > deadline
            if name not in due_s and (deployment.can_be_hit(kind, name, settings.during) or expired):
                due_s[name] = time.monotonic() + random.uniform(0.0, 4.0)
            if name in hit_s or time.monotonic() < due_s.get(name, math.inf):
                continue
            killed = deployment.kill(kind, name)
            if not killed and kind != EVERYTHING and not deployment.has_ended(name) and not expired:
                continue  # between two steps, or before the worker has reported its PID
            outcome.kills[kind] += killed
            hit_s[name] = time.monotonic()
            if kind in ("daemon", EVERYTHING):
                time.sleep(random.uniform(0.0, 3.0))
                deployment.start_daemon()
        time.sleep(0.1)
    return hit_s


def _is_service(command: str) -> bool:
    return any(name in command for name in SERVICES)


def _kill(pids: Iterable[int]) -> int:
    """SIGKILL processes; return how many of them existed."""
    killed = 0
    for pid in pids:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)
            killed += 1
    return killed


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.dagster_kills``."""
    parser = command_parser("faults.dagster_kills", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=100, help="kills (default 100)")
    parser.add_argument("--without", choices=PROTECTIONS, help="switch off this protection, to see its effect")
    options = parser.parse_args(arguments)
    with temporary_home() as folder:
        deployment = Deployment(folder / "home", [options.without] if options.without else [])
        try:
            outcome = kill_under_dagster(deployment, options.count, options.seed, progress=print_progress(1))
        finally:
            deployment.close()
    figures = {
        "dagster_kills": outcome.kills.total(),
        "dagster_kills_stuck": len(outcome.failures),
        "dagster_kills_longest_s": outcome.longest_s,
    }
    killed, ends = dict(outcome.kills), dict(outcome.ends)
    print(f"killed: {killed}; final states of the runs: {ends}")
    return finish(options, figures, outcome.failures, killed=killed, ends=ends)


if __name__ == "__main__":
    sys.exit(main())
