"""A share of ``python -m evidence.faults.dagster_kills``, with and without the protections of the project."""

import contextlib
import os
import pathlib
import signal
import sys
from collections.abc import Iterator
from functools import partial

import dagster as dg
import pytest

from evidence.faults.dagster_kills import EVERYTHING, PROTECTIONS, SERVES, Stage, kill_under_dagster

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="processes are looked up in /proc")


@pytest.fixture
def stage(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Stage]:
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path))  # both are set by the stage, and are as before afterwards
    made = Stage(tmp_path / "home", without=PROTECTIONS)
    yield made
    made.close()


def test_a_killed_run_ends_and_leaves_nobody_and_without_protection_it_does_neither(stage: Stage) -> None:
    hit = partial(kill_under_dagster, stage, 1, seed=0, kinds=[EVERYTHING], at_once=1, during="beside")
    unprotected = hit(longest_s=5.0)
    assert any("STARTED after 5 s" in words for words in unprotected.wrong), unprotected.wrong
    assert any("left over" in words for words in unprotected.wrong), unprotected.wrong
    for pid, command in stage.processes().items():
        if not any(each in command for each in SERVES):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)

    stage.switch_off([])
    protected = hit()
    assert protected.kills == {EVERYTHING: 1}
    assert protected.wrong == []
    lost = stage.run("00001")
    assert lost is not None
    assert lost.status == dg.DagsterRunStatus.FAILURE, "it was ended as soon as somebody looked after it"
