"""What starts work by itself: new labelled images, new scenes, changed inputs; and what cleans up after a crash."""

import os
import pathlib
from collections.abc import Sequence

import dagster as dg

from assets.single_scene import scenes as scene_partitions
from deltasafe.errors import DeltasafeError
from pipelines import jobs
from pipelines.lost_runs import fail_lost_runs
from pipelines.watching import Watched, digest_of_folder, watched_folder

__all__ = [
    "HANDS_VARIABLE",
    "INTERVAL_VARIABLE",
    "SCENES_VARIABLE",
    "UNATTENDED_VARIABLE",
    "all_sensors",
    "look_at_images",
    "look_at_scenes",
]

HANDS_VARIABLE = "DELTASAFE_WATCHED_HANDS"
SCENES_VARIABLE = "DELTASAFE_WATCHED_SCENES"
INTERVAL_VARIABLE = "DELTASAFE_SENSOR_INTERVAL_S"
UNATTENDED_VARIABLE = "DELTASAFE_UNATTENDED"

UNATTENDED = {"dagster/max_retries": "2", "dagster/retry_strategy": "FROM_FAILURE"}
"""Nobody sits beside these runs: one whose process was killed is taken up again."""


def all_sensors(home: pathlib.Path) -> Sequence[dg.SensorDefinition]:
    """The sensors for a home."""
    interval_s = int(os.environ.get(INTERVAL_VARIABLE) or 30)
    on = dg.DefaultSensorStatus.RUNNING
    chosen = on if os.environ.get(UNATTENDED_VARIABLE) == "1" else dg.DefaultSensorStatus.STOPPED

    @dg.sensor(job=jobs.perception, minimum_interval_seconds=interval_s, default_status=chosen, description=_LABELLED)
    def labelled_images(context: dg.SensorEvaluationContext) -> dg.SensorResult | dg.SkipReason:
        return look_at_images(context, watched_folder(home, HANDS_VARIABLE, "hands"))

    @dg.sensor(job=jobs.single_scene, minimum_interval_seconds=interval_s, default_status=chosen, description=_SCENES)
    def logged_scenes_folder(context: dg.SensorEvaluationContext) -> dg.SensorResult | dg.SkipReason:
        return look_at_scenes(context, watched_folder(home, SCENES_VARIABLE, "scenes"))

    @dg.sensor(
        jobs=[jobs.perception],
        minimum_interval_seconds=interval_s,
        default_status=on,
        description="Marks runs as failed whose process was killed, and frees the cores that they held.",
    )
    def lost_runs(context: dg.SensorEvaluationContext) -> dg.SkipReason:
        lost = fail_lost_runs(context.instance)
        return dg.SkipReason(f"marked as failed: {', '.join(lost)}" if lost else "every run has its process")

    follow_changes = dg.AutomationConditionSensorDefinition(
        "follow_changes",
        target=dg.AssetSelection.groups("motion"),
        minimum_interval_seconds=interval_s,
        default_status=chosen,
        description="Plans and executes the scenes anew when another ensemble is in use or other scenes were logged.",
        run_tags=UNATTENDED,
    )
    return [labelled_images, logged_scenes_folder, follow_changes, lost_runs]


def look_at_images(context: dg.SensorEvaluationContext, folder: pathlib.Path) -> dg.SensorResult | dg.SkipReason:
    """A run of the job `perception` on ``folder`` once its content is new, at rest and well-formed."""
    digest = digest_of_folder(folder)
    if not digest:
        return dg.SkipReason(f"no images in {folder}")
    watched = Watched.from_cursor(context.cursor)
    if not watched.ripe({"hands": digest}):
        context.update_cursor(watched.cursor())
        same = watched.done.get("hands") == digest
        return dg.SkipReason("nothing new" if same else f"{folder} has changed; waiting until it is at rest")
    watched.done["hands"] = digest
    context.update_cursor(watched.cursor())
    from deltasafe.perception.hands import HandSet

    try:
        HandSet.load(folder)
    except DeltasafeError as error:
        return dg.SkipReason(f"not trained on, until it is changed again: {error}")
    config = {"ops": {"raw_hands": {"config": {"folder": str(folder)}}}}
    request = dg.RunRequest(run_key=digest, run_config=config, tags={**jobs.ALL_MEMBERS, **UNATTENDED})
    return dg.SensorResult([request], cursor=watched.cursor())


def look_at_scenes(context: dg.SensorEvaluationContext, folder: pathlib.Path) -> dg.SensorResult | dg.SkipReason:
    """A partition and a run for every scene folder that is new or changed, at rest and well-formed."""
    from deltasafe.scene import LoggedScene

    now = {path.parent.name: digest_of_folder(path.parent) for path in sorted(folder.glob("*/scene.json"))}
    watched, requests, refused = Watched.from_cursor(context.cursor), [], []
    for name in watched.ripe(now):
        watched.done[name] = now[name]
        try:
            LoggedScene.load(folder / name)
        except DeltasafeError as error:
            refused.append(str(error))
            continue
        config = {"ops": {"logged_scene": {"config": {"folder": str(folder)}}}}
        requests.append(dg.RunRequest(now[name], config, partition_key=name, tags=UNATTENDED))
    context.update_cursor(watched.cursor())
    if not requests:
        return dg.SkipReason("; ".join(refused) or f"no new scene at rest in {folder}")
    added = scene_partitions.build_add_request([str(request.partition_key) for request in requests])
    return dg.SensorResult(requests, dynamic_partitions_requests=[added], cursor=watched.cursor())


_LABELLED = (
    f"Retrains when labelled images were added or changed in `incoming/hands` below the home, or in ${HANDS_VARIABLE}; "
    "a folder that is still being written to is left alone."
)
_SCENES = (
    f"Plans and executes every newly logged scene in `incoming/scenes` below the home, or in ${SCENES_VARIABLE}, "
    "with the ensemble in use."
)
