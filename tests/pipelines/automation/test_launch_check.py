"""A run of the whole chain with defective folders ends before its first step, and names the defects of all folders."""

from types import SimpleNamespace

import dagster as dg

from pipelines.automation.launch_check import lineage_error
from pipelines.build import build_defs
from pipelines.commands import run_job
from pipelines.home import prepare_home
from pipelines.supervision import _selected
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


def test_all_assets_of_the_lineage_are_refused_in_a_run_and_in_a_run_of_a_backfill(tmp_path, monkeypatch):
    groups = {spec.key.to_user_string(): spec.group_name for spec in build_defs(tmp_path).resolve_all_asset_specs()}
    chain = [name for name, group in groups.items() if group in ("perception", "motion")]
    assert lineage_error(chain) == ""
    assert lineage_error(set(groups) - set(chain)) == "", "studies that were asked for"
    for job in {*groups.values()} - {"perception", "motion", "operation"}:
        assert job in lineage_error(groups)
    backfill = SimpleNamespace(asset_selection=[dg.AssetKey(name) for name in groups])
    instance = SimpleNamespace(get_backfill={"abc": backfill}.get)
    run = SimpleNamespace(tags={"dagster/backfill": "abc"})
    assert _selected(SimpleNamespace(dagster_run=run, instance=instance), ["raw_hands"]) == {*groups}
