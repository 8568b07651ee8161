"""What starts work by itself: new labeled images, new scenes, changed inputs; and what cleans up after a crash."""

import os
import pathlib
from collections.abc import Sequence

import dagster as dg

from assets.single_scene import scenes as scene_partitions
from deltasafe.errors import DeltasafeError
from pipelines import jobs
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.watched_folders import (
    HANDS_VARIABLE,
    SCENES_VARIABLE,
    Watched,
    digest_of_folder,
    watched_hands,
    watched_scenes,
)

__all__ = [
    "INTERVAL_VARIABLE",
    "all_sensors",
    "look_at_images",
    "look_at_scenes",
]

INTERVAL_VARIABLE = "DELTASAFE_SENSOR_INTERVAL_S"


def all_sensors(home: pathlib.Path) -> Sequence[dg.SensorDefinition]:
    """The sensors for a home."""
    interval_s = int(os.environ.get(INTERVAL_VARIABLE) or 30)
    on = dg.DefaultSensorStatus.RUNNING
    chosen = on if os.environ.get(jobs.UNATTENDED_VARIABLE) == "1" else dg.DefaultSensorStatus.STOPPED

    @dg.sensor(job=jobs.perception, minimum_interval_seconds=interval_s, default_status=chosen, description=_LABELED)
    def labeled_images(context: dg.SensorEvaluationContext) -> dg.SensorResult:
        return look_at_images(context, watched_hands(home))

    @dg.sensor(job=jobs.single_scene, minimum_interval_seconds=interval_s, default_status=chosen, description=_SCENES)
    def logged_scenes_folder(context: dg.SensorEvaluationContext) -> dg.SensorResult:
        return look_at_scenes(context, watched_scenes(home))

    @dg.sensor(
        jobs=[jobs.perception],
        minimum_interval_seconds=interval_s,
        default_status=on,
        description="Fails runs whose process was killed and frees their pool slots; kills processes of ended runs.",
    )
    def lost_runs(context: dg.SensorEvaluationContext) -> dg.SkipReason:
        done = {
            "marked as failed": fail_lost_runs(context.instance),
            "processes killed of ended runs": end_leftover_processes(context.instance),
        }
        said = [f"{what}: {', '.join(runs)}" for what, runs in done.items() if runs]
        return dg.SkipReason("; ".join(said) or "every run has its process, and no process has outlived its run")

    follow_changes = dg.AutomationConditionSensorDefinition(
        "follow_changes",
        target=dg.AssetSelection.groups("motion"),
        minimum_interval_seconds=interval_s,
        default_status=chosen,
        description="Plans and executes the scenes anew when another ensemble is in use or other scenes were logged.",
        run_tags=jobs.UNATTENDED,
    )
    return [labeled_images, logged_scenes_folder, follow_changes, lost_runs]


def look_at_images(context: dg.SensorEvaluationContext, folder: pathlib.Path) -> dg.SensorResult:
    """A run of the job `perception` on ``folder`` once its content is new, at rest and well-formed."""
    from deltasafe.perception.data.labeled_images import LabeledImageSet

    watched, digest = Watched.from_cursor(context.cursor), digest_of_folder(folder)
    if not digest:
        return _nothing(watched, f"no images in {folder}")
    if not watched.ripe({"hands": digest}):
        same = watched.done.get("hands") == digest
        return _nothing(watched, "nothing new" if same else f"{folder} has changed; waiting until it is at rest")
    watched.done["hands"] = digest
    try:
        LabeledImageSet.load(folder)
    except DeltasafeError as error:
        return _nothing(watched, f"not trained on, until it is changed again: {error}")
    config = {"ops": {"raw_hands": {"config": {"folder": str(folder)}}}}
    request = dg.RunRequest(run_key=digest, run_config=config, tags={**jobs.ALL_MEMBERS, **jobs.UNATTENDED})
    return dg.SensorResult([request], cursor=watched.cursor())


def look_at_scenes(context: dg.SensorEvaluationContext, folder: pathlib.Path) -> dg.SensorResult:
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
        requests.append(dg.RunRequest(f"{name} {now[name]}", config, partition_key=name, tags=jobs.UNATTENDED))
    if not requests:
        return _nothing(watched, "; ".join(refused) or f"no new scene at rest in {folder}")
    added = scene_partitions.build_add_request([str(request.partition_key) for request in requests])
    return dg.SensorResult(requests, dynamic_partitions_requests=[added], cursor=watched.cursor())


def _nothing(watched: Watched, why: str) -> dg.SensorResult:
    return dg.SensorResult(skip_reason=why, cursor=watched.cursor())


_LABELED = (
    f"Retrains when labeled images were added or changed in `incoming/hands` below the home, or in ${HANDS_VARIABLE}; "
    "a folder that is still being written to is left alone."
)
_SCENES = (
    f"Plans and executes every newly logged scene in `incoming/scenes` below the home, or in ${SCENES_VARIABLE}, "
    "with the ensemble in use."
)
