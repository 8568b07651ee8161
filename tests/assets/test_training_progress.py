"""The losses of a member are shown while it trains."""

import dagster as dg
import pytest

from assets.training import _StepLog
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training.train_member import StepReport


@pytest.mark.parametrize("resumed_after", [0, 2])
def test_every_epoch_is_an_observation_of_its_partition(resumed_after):
    per_epoch, epochs = 3, 2

    @dg.asset(partitions_def=dg.StaticPartitionsDefinition(["member_00", "member_01"]))
    def ensemble_member(context: dg.AssetExecutionContext) -> None:
        log = _StepLog(context, TrainingSettings(epochs=epochs), {"member_01": 1})
        for step in range(resumed_after + 1, per_epoch * epochs + 1):
            epoch = (step - 1) // per_epoch + 1
            log.on_step("member_01", StepReport(step, per_epoch * epochs, epoch, float(step), 1e-3, 20.0))

    with dg.DagsterInstance.ephemeral() as instance:
        dg.materialize([ensemble_member], partition_key="member_01", instance=instance)
        filtered = dg.AssetRecordsFilter(asset_key=ensemble_member.key)
        found = [record.asset_observation for record in instance.fetch_observations(filtered, limit=9).records][::-1]
    assert [observation.partition for observation in found] == ["member_01"] * epochs
    shown = [{name: each.value for name, each in observation.metadata.items()} for observation in found]
    first = sum(range(resumed_after + 1, 4)) / (3 - resumed_after)
    assert [(each["epoch"], each["loss of the epoch"]) for each in shown] == [(1, first), (2, 5.0)]
