"""Jobs by what people ask for, and the retraining schedule."""

import dagster as dg

from assets.perception import members
from assets.study import cells

__all__ = [
    "ALL_CELLS",
    "ALL_MEMBERS",
    "everything",
    "perception",
    "planner_study",
    "planning",
    "retraining",
    "safety_study",
    "single_scene",
    "study",
]


def _whole_range(partitions: dg.StaticPartitionsDefinition) -> dict[str, str]:
    """One run makes every partition; assets without partitions ignore it."""
    keys = partitions.get_partition_keys()
    return {"dagster/asset_partition_range_start": keys[0], "dagster/asset_partition_range_end": keys[-1]}


ALL_MEMBERS = _whole_range(members)
ALL_CELLS = _whole_range(cells)

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
    dg.AssetSelection.groups("perception", "motion"),
    description="The whole chain: fifty images in, safely executed motions out.",
    tags=ALL_MEMBERS,
)

single_scene = dg.define_asset_job(
    "single_scene",
    dg.AssetSelection.groups("single_scene"),
    description="One newly logged scene with the ensemble in use: seen, planned, executed, judged.",
)

study = dg.define_asset_job(
    "study",
    dg.AssetSelection.groups("study") | dg.AssetSelection.assets("raw_hands", "test_hands"),
    description="Tables I to III and Fig. 4 of the paper, and the ablation: hours of training; goes on where it was.",
    tags=ALL_CELLS,
)

planner_study = dg.define_asset_job(
    "planner_study",
    dg.AssetSelection.groups("planner_study"),
    description="Fig. 5 and Fig. 6 of the paper: the planner against the compared methods; goes on where it was.",
)

safety_study = dg.define_asset_job(
    "safety_study",
    dg.AssetSelection.groups("safety_study"),
    description="Thousands of executed motions: were they delta-safe? With intervals; goes on where it was.",
)


@dg.schedule(
    job=perception,
    cron_schedule="0 3 * * 0",
    default_status=dg.DefaultScheduleStatus.STOPPED,
    description="Retrain all members every Sunday at 3:00 and freeze them if they pass the gate.",
)
def retraining(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    return dg.RunRequest(run_key=context.scheduled_execution_time.isoformat(), tags=ALL_MEMBERS)
