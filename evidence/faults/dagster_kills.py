"""SIGKILL of steps, run workers, the daemon, or all but steps, under Dagster: every run ends, and no process stays.

``--without lifeline`` and ``--without lost_runs`` switch off what the project brings for that, to show what it is for.
"""

import collections
import contextlib
import dataclasses
import math
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Collection, Mapping, Sequence
from random import Random

import dagster as dg

from deltasafe.progress import Progress, silent
from evidence.faults.reporting import conclude, parser, progress_every
from pipelines.home import PROJECT, prepare_home
from pipelines.lost_runs import process_of

__all__ = ["Outcome", "Stage", "kill_under_dagster", "main"]

LONGEST_S = 120.0
LEAVING_S = 8.0
"""Time to take one's leave; less than a step of the location that nobody needs any more would still take."""
AT_ONCE = 4
"""As many as the home lets run."""
LOCATION = "evidence.faults.dagster_location"
PROTECTIONS = ("lifeline", "lost_runs")
EVERYTHING = "everything"
"""The worker with all that could notice its end, as when a machine goes down: the daemon and its code servers."""
KINDS = ("step", "step", "run worker", "run worker", "daemon", EVERYTHING)
ENDED = [dg.DagsterRunStatus.SUCCESS, dg.DagsterRunStatus.FAILURE, dg.DagsterRunStatus.CANCELED]
SERVES = ("dagster._daemon", "grpc", "resource_tracker")
"""Command lines of what may stay when no run is left."""


class Stage:
    """A home with a daemon that starts a run for each request.

    Args:
        without: ``lifeline`` and ``lost_runs``, if they are to be off.
    """

    def __init__(self, home: pathlib.Path, without: Collection[str] = ()) -> None:
        for folder in ("requests", "without"):
            (home / folder).mkdir(parents=True)
        os.environ["DELTASAFE_HOME"] = str(home)
        self.home = prepare_home()
        self.instance = dg.DagsterInstance.get()
        self._asked = 0
        self.switch_off(without)
        self.start_daemon()

    def switch_off(self, without: Collection[str]) -> None:
        """From now on these are off, and all others are on."""
        for name in PROTECTIONS:
            (self.home / "without" / name).unlink(missing_ok=True)
        for name in without:
            (self.home / "without" / name).touch()

    def start_daemon(self) -> None:
        """Anew, whether there was one or not."""
        command = [sys.executable, "-m", "dagster._daemon", "run", "-m", LOCATION, "-d", str(PROJECT)]
        with (self.home / "daemon.log").open("a") as log:
            self.daemon = subprocess.Popen(command, cwd=PROJECT, stdout=log, stderr=log, start_new_session=True)

    def close(self) -> None:
        """End all of it."""
        for pid in self.processes():
            os.kill(pid, signal.SIGKILL)
        self.daemon.wait()
        self.instance.dispose()

    def ask(self) -> str:
        """Ask for a run; its name."""
        self._asked += 1
        (self.home / "requests" / f"{self._asked:05d}").touch()
        return f"{self._asked:05d}"

    def run(self, name: str) -> dg.DagsterRun | None:
        """The run that was asked for, once there is one."""
        return next(iter(self.instance.get_runs(dg.RunsFilter(tags={"request": name}))), None)

    def processes(self) -> dict[int, str]:
        """All processes of this home but this one, and their command lines."""
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

    def left_over(self) -> list[str]:
        """Command lines of processes that serve nobody, some seconds after the last run has ended."""
        until, left = time.monotonic() + LEAVING_S, [""]
        while left and time.monotonic() < until:
            time.sleep(0.5)
            left = [command for command in self.processes().values() if not any(each in command for each in SERVES)]
        return left

    def kill(self, kind: str, name: str) -> bool:
        """Kill the daemon, or what works for the run ``name`` now; whether there was such a process."""
        if kind == "daemon":
            self.daemon.kill()
            self.daemon.wait()
            return True
        if kind == EVERYTHING:
            killed = self.kill("run worker", name)
            for serving in [
                pid for pid, command in self.processes().items() if any(each in command for each in SERVES)
            ]:
                with contextlib.suppress(ProcessLookupError):
                    os.kill(serving, signal.SIGKILL)
            self.daemon.wait()
            return killed
        pid = self._pid_of(kind, name)
        if pid is None:
            return False
        try:
            os.kill(pid, signal.SIGKILL)
        except ProcessLookupError:
            return False
        return True

    def has_ended(self, name: str) -> bool:
        """Whether the run is over."""
        run = self.run(name)
        return run is not None and run.is_finished

    def is_at_work(self, kind: str, name: str, during: str) -> bool:
        """Whether a run has begun (the step ``during`` if that is not empty), and has a step if one is to be killed."""
        run = self.run(name)
        if run is None or run.status in (dg.DagsterRunStatus.NOT_STARTED, dg.DagsterRunStatus.QUEUED):
            return False
        begun = self.instance.all_logs(run.run_id, of_type=dg.DagsterEventType.STEP_START) if during else []
        if during and not any(entry.step_key == during for entry in begun):
            return run.is_finished
        return kind != "step" or run.is_finished or self._pid_of(kind, name) is not None

    def _pid_of(self, kind: str, name: str) -> int | None:
        run = self.run(name)
        if run is None or run.is_finished:
            return None
        if kind == "run worker":
            worker = process_of(self.instance, run.run_id)
            return None if worker is None else worker[0]
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
    """Kills by what was killed, ends of the runs that were hit, what was wrong, and the longest time to an end."""

    kills: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    ends: collections.Counter[str] = dataclasses.field(default_factory=collections.Counter)
    wrong: list[str] = dataclasses.field(default_factory=list)
    longest_s: float = 0.0


def kill_under_dagster(
    stage: Stage,
    count: int,
    seed: int,
    progress: Progress = silent,
    *,
    kinds: Sequence[str] = KINDS,
    at_once: int = AT_ONCE,
    during: str = "",
    longest_s: float = LONGEST_S,
) -> Outcome:
    """Runs by fours (``at_once``), each hit once; one that has not ended after ``longest_s`` is stuck.

    Args:
        during: the step that must have begun before its run is hit; any or none if empty.
    """
    random, outcome = Random(seed), Outcome()
    while outcome.kills.total() < count and len(outcome.wrong) < 5:
        names = [stage.ask() for _ in range(at_once)]
        hit_s = _strike(stage, {name: random.choice(kinds) for name in names}, during, random, outcome)
        for name in names:
            while (run := stage.run(name)) is None or run.status not in ENDED:
                if time.monotonic() - hit_s[name] > longest_s:
                    outcome.wrong.append(f"run {name}: {run.status.value if run else 'none'} after {longest_s:g} s")
                    break
                time.sleep(0.25)
            outcome.longest_s = max(outcome.longest_s, time.monotonic() - hit_s[name])
            outcome.ends[run.status.value if run else "none"] += 1
        outcome.wrong += [f"left over after {names}: {command}" for command in stage.left_over()]
        done = min(outcome.kills.total(), count)
        progress(done, count, f"{len(outcome.wrong)} wrong, longest {outcome.longest_s:.0f} s")
    return outcome


def _strike(stage: Stage, kinds: Mapping[str, str], during: str, random: Random, outcome: Outcome) -> dict[str, float]:
    """Hit each run once, at a random instant after there is something to be hit; when that was."""
    due_s: dict[str, float] = {}
    hit_s: dict[str, float] = {}
    until_s = time.monotonic() + LONGEST_S
    while len(hit_s) < len(kinds):
        for name, kind in kinds.items():
            if name not in due_s and (stage.is_at_work(kind, name, during) or time.monotonic() > until_s):
                due_s[name] = time.monotonic() + random.uniform(0.0, 4.0)
            if name in hit_s or time.monotonic() < due_s.get(name, math.inf):
                continue
            killed = stage.kill(kind, name)
            if not killed and kind != EVERYTHING and not stage.has_ended(name) and time.monotonic() < until_s:
                continue  # between two of its steps, or before its worker has reported itself
            outcome.kills[kind] += killed
            hit_s[name] = time.monotonic()
            if kind in ("daemon", EVERYTHING):
                time.sleep(random.uniform(0.0, 3.0))
                stage.start_daemon()
        time.sleep(0.1)
    return hit_s


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.dagster_kills``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=100, help="kills (default 100)")
    made.add_argument("--without", choices=PROTECTIONS, help="leave this out, to see what becomes of the runs")
    options = made.parse_args(arguments)
    home = pathlib.Path(tempfile.mkdtemp(prefix="deltasafe-faults-"))
    stage = Stage(home, [options.without] if options.without else [])
    try:
        outcome = kill_under_dagster(stage, options.count, options.seed, progress_every(1))
    finally:
        stage.close()
        shutil.rmtree(home, ignore_errors=True)
    figures = {
        "dagster_kills": outcome.kills.total(),
        "dagster_kills_stuck": len(outcome.wrong),
        "dagster_kills_longest_s": outcome.longest_s,
    }
    about = {"killed": dict(outcome.kills), "ends": dict(outcome.ends)}
    print(about)
    return conclude("dagster_kills", figures, options, outcome.wrong, **about)


if __name__ == "__main__":
    sys.exit(main())
