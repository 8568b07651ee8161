"""``evidence.faults.dagster_kills`` with one kill, with and without the protections of the project."""

import os
import pathlib
import signal
import sys
from collections.abc import Iterator

import dagster as dg
import pytest

from evidence.faults.dagster_kills import EVERYTHING, PROTECTIONS, Deployment, KillSettings, kill_under_dagster

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="reads /proc")


@pytest.fixture
def deployment(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Deployment]:
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path))  # the deployment overwrites both; this restores them
    made = Deployment(tmp_path / "home", without=PROTECTIONS)
    yield made
    made.close()


def test_killed_run_ends_only_with_protections(deployment: Deployment) -> None:
    kinds = (EVERYTHING,)
    short = KillSettings(kinds, concurrent_runs=1, during="beside", timeout_s=5.0)
    unprotected = kill_under_dagster(deployment, 1, 0, short)
    assert any("STARTED after 5 s" in failure for failure in unprotected.failures), unprotected.failures
    assert any("left over" in failure for failure in unprotected.failures), unprotected.failures
    for pid in deployment.run_processes():
        os.kill(pid, signal.SIGKILL)

    deployment.switch_off([])
    protected = kill_under_dagster(deployment, 1, 0, KillSettings(kinds, concurrent_runs=1, during="beside"))
    assert protected.kills == {EVERYTHING: 1}
    assert protected.failures == []
    lost = deployment.run("00001")
    assert lost is not None
    assert lost.status == dg.DagsterRunStatus.FAILURE, "the sensor must also fail the run that was lost before"
