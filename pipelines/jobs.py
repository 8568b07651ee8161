"""Jobs by what people ask for, and the retraining schedule."""

import dagster as dg

from assets.perception import members

__all__ = ["ALL_MEMBERS", "everything", "perception", "planning", "retraining"]

_keys = members.get_partition_keys()

# one run trains every member: the range covers all partitions of `ensemble_member`, and assets without
# partitions ignore it
ALL_MEMBERS = {
    "dagster/asset_partition_range_start": _keys[0],
    "dagster/asset_partition_range_end": _keys[-1],
}

perception = dg.define_asset_job(
    "perception",
    dg.AssetSelection.groups("perception"),
    description="From the labelled images to the frozen, registered ensemble.",
    tags=ALL_MEMBERS,
)

planning = dg.define_asset_job(
    "planning",
    dg.AssetSelection.groups("motion"),
    description="From the frozen ensemble and the logged scenes to the safety report.",
)

everything = dg.define_asset_job(
    "everything",
    dg.AssetSelection.all(),
    description="The whole chain: fifty images in, safely executed motions out.",
    tags=ALL_MEMBERS,
)


@dg.schedule(
    job=perception,
    cron_schedule="0 3 * * 0",
    default_status=dg.DefaultScheduleStatus.STOPPED,
    description="Retrain all members every Sunday at 3:00 and freeze them if they pass the gate.",
)
def retraining(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    return dg.RunRequest(run_key=context.scheduled_execution_time.isoformat(), tags=ALL_MEMBERS)
