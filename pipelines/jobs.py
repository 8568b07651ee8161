"""Jobs by what people ask for, and the retraining schedule."""

import os

import dagster as dg

from assets.perception import members
from assets.perception_study import cells
from pipelines.home import home
from pipelines.watched_folders import watched_hands

__all__ = [
    "ALL_CELLS",
    "ALL_MEMBERS",
    "UNATTENDED",
    "UNATTENDED_VARIABLE",
    "everything",
    "perception",
    "perception_study",
    "planner_study",
    "planning",
    "retraining",
    "safety_study",
    "single_scene",
    "tracking_study",
]


def _whole_range(partitions: dg.StaticPartitionsDefinition) -> dict[str, str]:
    """One run makes every partition; assets without partitions ignore it."""
    keys = partitions.get_partition_keys()
    return {"dagster/asset_partition_range_start": keys[0], "dagster/asset_partition_range_end": keys[-1]}


UNATTENDED_VARIABLE = "DELTASAFE_UNATTENDED"
UNATTENDED = {"dagster/max_retries": "2", "dagster/retry_strategy": "FROM_FAILURE"}
"""Nobody sits beside these runs: one whose process was killed is taken up again."""

ALL_MEMBERS = _whole_range(members)
ALL_CELLS = _whole_range(cells)

perception = dg.define_asset_job(
    "perception",
    dg.AssetSelection.groups("perception"),
    description="From the labeled images to the frozen, registered ensemble.",
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

perception_study = dg.define_asset_job(
    "perception_study",
    dg.AssetSelection.groups("perception_study") | dg.AssetSelection.assets("raw_hands", "test_hands"),
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


tracking_study = dg.define_asset_job(
    "tracking_study",
    dg.AssetSelection.groups("tracking_study"),
    description="The tracking bound gamma(v), identified from test motions; goes on where it was.",
)


@dg.schedule(
    job=perception,
    cron_schedule="0 3 * * 0",
    default_status=dg.DefaultScheduleStatus("RUNNING" if os.environ.get(UNATTENDED_VARIABLE) == "1" else "STOPPED"),
    description="Retrain all members every Sunday at 3:00, on the watched images where there are any.",
)
def retraining(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    tags, hands = {**ALL_MEMBERS, **UNATTENDED}, watched_hands(home())
    config = {"ops": {"raw_hands": {"config": {"folder": str(hands)}}}} if hands.is_dir() else {}
    return dg.RunRequest(run_key=context.scheduled_execution_time.isoformat(), run_config=config, tags=tags)
