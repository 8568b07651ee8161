"""Partitions whose inputs were made again are named by a check, and by the sensor without a run."""

import dagster as dg
import pytest

from assets import staleness
from assets.perception import members
from pipelines.automation.sensors import check_stale

MEMBERS = members.get_partition_keys()


@dg.asset
def augmented_hands(context: dg.AssetExecutionContext) -> dg.MaterializeResult:
    return dg.MaterializeResult(data_version=dg.DataVersion(context.run.tags["version"]))


@dg.asset(deps=[augmented_hands], partitions_def=members, backfill_policy=dg.BackfillPolicy.single_run())
def ensemble_member() -> None:
    pass


@pytest.fixture
def instance():
    with dg.DagsterInstance.ephemeral() as made:
        yield made


def make(instance, version, names, partition=None):
    """Materialize assets with their checks; return the evaluation of the check, None if it was not run."""
    span = {f"dagster/asset_partition_range_{end}": MEMBERS[which] for end, which in (("start", 0), ("end", -1))}
    tags = {"version": version} if partition else {"version": version, **span}
    (check,) = (check for check in staleness.CHECKS if check.check_key.asset_key == ensemble_member.key)
    checked = [augmented_hands, ensemble_member, check]
    result = dg.materialize(checked, instance=instance, selection=names, tags=tags, partition_key=partition)
    return next(iter(result.get_asset_check_evaluations()), None)


def test_only_partitions_with_changed_inputs_are_stale(instance):
    assert make(instance, "1", "*").passed
    make(instance, "1", "augmented_hands")
    assert not any(staleness.changed_inputs(instance, "ensemble_member").values()), "the same data again"
    make(instance, "2", "augmented_hands")
    assert staleness.changed_inputs(instance, "ensemble_member") == {key: ["augmented_hands"] for key in MEMBERS}
    found = make(instance, "2", "ensemble_member", MEMBERS[0])
    assert (found.passed, found.severity) == (False, dg.AssetCheckSeverity.WARN)
    assert MEMBERS[1] in found.description
    assert MEMBERS[0] not in found.description
    assert make(instance, "2", "ensemble_member").passed


def test_the_sensor_reports_a_changed_result_once(instance):
    def tick(cursor):
        context = dg.build_sensor_context(instance, cursor=cursor)
        return check_stale(context), context.cursor

    def latest():
        key = dg.AssetCheckKey(dg.AssetKey("ensemble_member"), staleness.CHECK)
        (record,) = instance.event_log_storage.get_asset_check_execution_history(key, limit=1)
        return record.id, record.evaluation.passed

    assert tick(None)[0] == "no partition was made yet"
    make(instance, "1", "*")
    _, cursor = tick(None)
    make(instance, "2", "augmented_hands")
    reason, cursor = tick(cursor)
    assert "made from an earlier version of augmented_hands" in reason
    reported, passed = latest()
    assert not passed
    assert tick(cursor) == (reason, cursor)
    assert latest()[0] == reported
