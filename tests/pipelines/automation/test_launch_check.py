"""A run of the whole chain with defective folders ends before its first step, and names the defects of all folders."""

import dagster as dg

from pipelines.commands import run_job
from pipelines.home import prepare_home
from tests.ensembles import write_hands


def test_defective_folders_end_the_run_before_its_first_step(tmp_path, monkeypatch):
    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "home"))
    root = prepare_home()
    (write_hands(tmp_path / "test") / "masks" / "2.png").unlink()
    ops = {
        "test_hands": {"config": {"folder": str(tmp_path / "test")}},
        "logged_scenes": {"config": {"folder": str(tmp_path / "nowhere")}},
    }
    with dg.DagsterInstance.get() as instance:
        job = dg.build_reconstructable_job(run_job.__name__, run_job.job_named.__name__, ("everything",))
        run_id = dg.execute_job(job, instance=instance, run_config={"ops": ops}).run_id
        events = [entry.dagster_event for entry in instance.all_logs(run_id) if entry.dagster_event]
    assert not [event for event in events if event.is_step_event]
    (failure,) = [event for event in events if event.is_job_failure]
    message = failure.job_failure_data.error.message
    assert "nothing was run, since inputs are defective" in message
    assert "2.png: has no counterpart" in message
    assert f"scenes: {tmp_path / 'nowhere'}" in message
    assert not (root / "store").exists()
