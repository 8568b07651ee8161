"""Sensors: new labeled images, new scenes, changed inputs, and lost runs."""

import os
import pathlib
from collections.abc import Sequence
from typing import Any

import dagster as dg

from assets.single_scene import scenes as scene_partitions
from deltasafe.errors import DeltasafeError
from pipelines import jobs
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.watched_folders import (
    HANDS_VARIABLE,
    SCENES_VARIABLE,
    WatchCursor,
    digest_of_folder,
    watched_hands,
    watched_scenes,
)

INTERVAL_VARIABLE = "DELTASAFE_SENSOR_INTERVAL_S"

_IMAGES_DESCRIPTION = (
    f"Starts the job `perception` when labeled images in `incoming/hands` of the home (or in ${HANDS_VARIABLE}) were "
    "added or changed. It waits until the folder has not changed between two ticks, and skips defective sets."
)
_SCENES_DESCRIPTION = (
    f"Starts the job `single_scene` for every new or changed scene in `incoming/scenes` of the home (or in "
    f"${SCENES_VARIABLE}), with the ensemble in use."
)
_CHANGES_DESCRIPTION = (
    "Materializes the assets of the group `motion` again when the ensemble in use or the logged scenes have changed."
)
_LOST_RUNS_DESCRIPTION = (
    "Marks runs as failed whose process was killed, frees their pool slots, and kills processes of ended runs."
)


def all_sensors(home: pathlib.Path) -> Sequence[dg.SensorDefinition]:
    """Build the sensors for a home. Those that start work are off unless `$DELTASAFE_UNATTENDED` is 1."""
    running = dg.DefaultSensorStatus.RUNNING
    unattended = os.environ.get(jobs.UNATTENDED_VARIABLE) == "1"
    common: dict[str, Any] = {
        "minimum_interval_seconds": int(os.environ.get(INTERVAL_VARIABLE) or 30),
        "default_status": running if unattended else dg.DefaultSensorStatus.STOPPED,
    }

    @dg.sensor(job=jobs.perception, description=_IMAGES_DESCRIPTION, **common)
    def labeled_images(context: dg.SensorEvaluationContext) -> dg.SensorResult:
        return check_images(context, watched_hands(home))

    @dg.sensor(job=jobs.single_scene, description=_SCENES_DESCRIPTION, **common)
    def logged_scenes_folder(context: dg.SensorEvaluationContext) -> dg.SensorResult:
        return check_scenes(context, watched_scenes(home))

    @dg.sensor(jobs=[jobs.perception], description=_LOST_RUNS_DESCRIPTION, **{**common, "default_status": running})
    def lost_runs(context: dg.SensorEvaluationContext) -> dg.SkipReason:
        found = {
            "marked as failed": fail_lost_runs(context.instance),
            "processes killed of ended runs": end_leftover_processes(context.instance),
        }
        messages = [f"{action}: {', '.join(runs)}" for action, runs in found.items() if runs]
        return dg.SkipReason("; ".join(messages) or "no lost run and no leftover process")

    follow_changes = dg.AutomationConditionSensorDefinition(
        "follow_changes",
        target=dg.AssetSelection.groups("motion"),
        description=_CHANGES_DESCRIPTION,
        run_tags=jobs.UNATTENDED,
        **common,
    )
    return [labeled_images, logged_scenes_folder, follow_changes, lost_runs]


def check_images(context: dg.SensorEvaluationContext, folder: pathlib.Path) -> dg.SensorResult:
    """Request a run of the job `perception` if the images of ``folder`` are new, settled and valid."""
    from deltasafe.perception.data.labeled_images import LabeledImageSet

    cursor, digest = WatchCursor.from_json(context.cursor), digest_of_folder(folder)
    if not digest:
        return _skip(cursor, f"no images in {folder}")
    if not cursor.settled({"hands": digest}):
        is_known = cursor.done.get("hands") == digest
        return _skip(cursor, "nothing new" if is_known else f"{folder} has changed; waiting until it is settled")
    cursor.done["hands"] = digest
    try:
        LabeledImageSet.load(folder)
    except DeltasafeError as error:
        return _skip(cursor, f"not used for training until it is changed: {error}")
    config = {"ops": {"raw_hands": {"config": {"folder": str(folder)}}}}
    request = dg.RunRequest(cursor.run_key("hands"), config, tags={**jobs.ALL_MEMBERS, **jobs.UNATTENDED})
    return dg.SensorResult([request], cursor=cursor.to_json())


def check_scenes(context: dg.SensorEvaluationContext, folder: pathlib.Path) -> dg.SensorResult:
    """Request a partition and a run for every scene below ``folder`` that is new or changed, settled and valid."""
    from deltasafe.scene import LoggedScene

    digests = {path.parent.name: digest_of_folder(path.parent) for path in sorted(folder.glob("*/scene.json"))}
    cursor, requests, refused = WatchCursor.from_json(context.cursor), [], []
    for name in cursor.settled(digests):
        cursor.done[name] = digests[name]
        try:
            LoggedScene.load(folder / name)
        except DeltasafeError as error:
            refused.append(str(error))
            continue
        config = {"ops": {"logged_scene": {"config": {"folder": str(folder)}}}}
        requests.append(dg.RunRequest(cursor.run_key(name), config, partition_key=name, tags=jobs.UNATTENDED))
    if not requests:
        return _skip(cursor, "; ".join(refused) or f"no new settled scene in {folder}")
    partitions = scene_partitions.build_add_request([str(request.partition_key) for request in requests])
    return dg.SensorResult(requests, dynamic_partitions_requests=[partitions], cursor=cursor.to_json())


def _skip(cursor: WatchCursor, reason: str) -> dg.SensorResult:
    return dg.SensorResult(skip_reason=reason, cursor=cursor.to_json())
