"""Jobs, and the retraining schedule."""

import os

import dagster as dg

from assets.perception import members
from assets.perception_study import cells
from pipelines.home import home
from pipelines.watched_folders import watched_hands


def _all_partitions(partitions: dg.StaticPartitionsDefinition) -> dict[str, str]:
    """Return tags with which one run makes every partition. Assets without partitions ignore them."""
    keys = partitions.get_partition_keys()
    return {"dagster/asset_partition_range_start": keys[0], "dagster/asset_partition_range_end": keys[-1]}


UNATTENDED_VARIABLE = "DELTASAFE_UNATTENDED"
UNATTENDED = {"dagster/max_retries": "2", "dagster/retry_strategy": "FROM_FAILURE"}
"""Tags of runs that a sensor or the schedule starts: if their process is killed, Dagster retries them."""


def is_unattended() -> bool:
    """Return whether schedules and the sensors that start work are on from the beginning."""
    return os.environ.get(UNATTENDED_VARIABLE) == "1"


ALL_MEMBERS = _all_partitions(members)
ALL_CELLS = _all_partitions(cells)

_PARTITION = "In the launchpad, leave the field Partition empty: then all members are trained."

perception = dg.define_asset_job(
    "perception",
    dg.AssetSelection.groups("perception"),
    description=f"Trains, evaluates, freezes and registers an ensemble from the labeled images. {_PARTITION}",
    tags=ALL_MEMBERS,
)

planning = dg.define_asset_job(
    "planning",
    dg.AssetSelection.groups("motion"),
    description="Plans and executes a motion for every logged scene with the ensemble in use; writes a safety report.",
)

everything = dg.define_asset_job(
    "everything",
    dg.AssetSelection.groups("perception", "motion"),
    description="The whole pipeline: from labeled images to executed motions and the safety report (`make demo`). "
    f"{_PARTITION}",
    tags=ALL_MEMBERS,
)

single_scene = dg.define_asset_job(
    "single_scene",
    dg.AssetSelection.groups("single_scene"),
    description="Plans, executes and evaluates one logged scene (a partition) with the ensemble in use.",
)

perception_study = dg.define_asset_job(
    "perception_study",
    dg.AssetSelection.groups("perception_study") | dg.AssetSelection.assets("raw_hands", "test_hands"),
    description="Tables I to III, Fig. 4 and the ablation of the paper. Hours of training; resumes where it stopped.",
    tags=ALL_CELLS,
)

planner_study = dg.define_asset_job(
    "planner_study",
    dg.AssetSelection.groups("planner_study"),
    description="Fig. 5 and Fig. 6 of the paper: compares planners. Minutes; resumes where it stopped.",
)

safety_study = dg.define_asset_job(
    "safety_study",
    dg.AssetSelection.groups("safety_study"),
    description="Executes thousands of motions and estimates violation rates. An hour; resumes where it stopped.",
)


tracking_study = dg.define_asset_job(
    "tracking_study",
    dg.AssetSelection.groups("tracking_study"),
    description="Identifies the tracking bound gamma(v) of the arm from test motions. Resumes where it stopped.",
)


@dg.schedule(
    job=perception,
    cron_schedule="0 3 * * 0",
    execution_timezone="UTC",
    default_status=dg.DefaultScheduleStatus("RUNNING" if is_unattended() else "STOPPED"),
    description="Retrains all members on Sundays at 3:00 UTC, on the watched images if there are any.",
)
def retraining(context: dg.ScheduleEvaluationContext) -> dg.RunRequest:
    tags, hands = {**ALL_MEMBERS, **UNATTENDED}, watched_hands(home())
    config = {"ops": {"raw_hands": {"config": {"folder": str(hands)}}}} if hands.is_dir() else {}
    return dg.RunRequest(run_key=context.scheduled_execution_time.isoformat(), run_config=config, tags=tags)
