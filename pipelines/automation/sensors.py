"""Sensors: new labeled images, new scenes, changed inputs, decisions in MLflow, stale partitions, and lost runs."""

import json
import os
import pathlib
from collections.abc import Sequence
from typing import Any

import dagster as dg

from assets import staleness
from assets.single_scene import scenes as scene_partitions
from deltasafe.errors import DeltasafeError
from pipelines import jobs
from pipelines.addresses import masked
from pipelines.automation.lost_runs import end_leftover_processes, fail_lost_runs
from pipelines.home import tracking_uri
from pipelines.watched_folders import (
    HANDS_VARIABLE,
    SCENES_VARIABLE,
    WatchState,
    digest_of_folder,
    stamp_of_folder,
    watched_hands,
    watched_scenes,
)

INTERVAL_VARIABLE = "DELTASAFE_SENSOR_INTERVAL_S"

_READING_S = 30.0
"""How long a tick reads changed files: Dagster ends a tick after a minute."""
_N_NAMED = 5

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
_DECISIONS_DESCRIPTION = (
    "Follows decisions that a person made in MLflow: if the alias `champion` was moved, Dagster gets that ensemble as "
    "a new version of `champion`. A tick says if no version is in use. Also sends MLflow calls that are pending."
)
_LOST_RUNS_DESCRIPTION = (
    "Marks runs as failed whose process was killed, frees their pool slots, and kills processes of ended runs."
)

_STALE_DESCRIPTION = (
    f"Evaluates the check {staleness.CHECK} of partitioned assets when one of their inputs was made again: Dagster "
    "itself shows such partitions as fresh."
)


def all_sensors(home: pathlib.Path) -> Sequence[dg.SensorDefinition]:
    """Build the sensors for a home. Those that start work are off unless `$DELTASAFE_UNATTENDED` is 1."""
    running = dg.DefaultSensorStatus.RUNNING
    unattended = jobs.is_unattended()
    common: dict[str, Any] = {
        "minimum_interval_seconds": int(os.environ.get(INTERVAL_VARIABLE) or 30),
        "default_status": running if unattended else dg.DefaultSensorStatus.STOPPED,
    }

    @dg.sensor(job=jobs.perception, description=_IMAGES_DESCRIPTION, **common)
    def labeled_images(context: dg.SensorEvaluationContext) -> dg.SensorResult:
        return check_images(context, watched_hands(home), home / "sensors" / "labeled_images")

    @dg.sensor(job=jobs.single_scene, description=_SCENES_DESCRIPTION, **common)
    def logged_scenes_folder(context: dg.SensorEvaluationContext) -> dg.SensorResult:
        return check_scenes(context, watched_scenes(home), home / "sensors" / "logged_scenes")

    @dg.sensor(jobs=[jobs.perception], description=_LOST_RUNS_DESCRIPTION, **{**common, "default_status": running})
    def lost_runs(context: dg.SensorEvaluationContext) -> dg.SkipReason:
        found = {
            "marked as failed": fail_lost_runs(context.instance),
            "processes killed of ended runs": end_leftover_processes(context.instance),
        }
        messages = [f"{action}: {', '.join(runs)}" for action, runs in found.items() if runs]
        return dg.SkipReason("; ".join(messages) or "no lost run and no leftover process")

    @dg.sensor(jobs=[jobs.planning], description=_DECISIONS_DESCRIPTION, **{**common, "default_status": running})
    def decisions_in_mlflow(context: dg.SensorEvaluationContext) -> dg.SkipReason:
        return dg.SkipReason(check_decisions(context, home))

    @dg.sensor(jobs=[jobs.perception], description=_STALE_DESCRIPTION, **{**common, "default_status": running})
    def stale_partitions(context: dg.SensorEvaluationContext) -> dg.SkipReason:
        return dg.SkipReason(check_stale(context))

    follow_changes = dg.AutomationConditionSensorDefinition(
        "follow_changes",
        target=dg.AssetSelection.groups("motion"),
        description=_CHANGES_DESCRIPTION,
        run_tags=jobs.UNATTENDED,
        **common,
    )
    return [labeled_images, logged_scenes_folder, follow_changes, lost_runs, decisions_in_mlflow, stale_partitions]


def check_stale(context: dg.SensorEvaluationContext) -> str:
    """Report the check of each partitioned asset if its result has changed; return one sentence on what was found."""
    reported = json.loads(context.cursor or "{}")
    for asset in staleness.CHECKED:
        if not context.instance.get_materialized_partitions(dg.AssetKey(asset)):
            continue
        found = staleness.evaluation(context.instance, asset)
        if reported.get(asset) != found.description:
            context.instance.report_runless_asset_event(found)
            reported[asset] = found.description
    context.update_cursor(json.dumps(reported))
    return "; ".join(f"{asset}: {text}" for asset, text in reported.items()) or "no partition was made yet"


def check_decisions(context: dg.SensorEvaluationContext, home: pathlib.Path) -> str:
    """Let Dagster follow the registry; return one sentence on what was found."""
    from pipelines.tracking.reconciliation import reconcile
    from pipelines.tracking.registry import EnsembleRegistry
    from pipelines.tracking.tracker import MlflowTracker, is_reachable

    if not (home / "champion.json").is_file():
        return "no ensemble was promoted here yet"
    if not is_reachable(tracking_uri(home)):
        return f"MLflow cannot be reached at {masked(tracking_uri(home))}; the note champion.json decides"
    found = reconcile(EnsembleRegistry(MlflowTracker(home)), context.instance)
    return "; ".join(found) or "Dagster uses the version with the alias champion"


def check_images(context: dg.SensorEvaluationContext, folder: pathlib.Path, memory: pathlib.Path) -> dg.SensorResult:
    """Request a run of the job `perception` if the images of ``folder`` are new, settled and valid.

    Args:
        memory: folder for what the sensor remembers.
    """
    from deltasafe.perception.data.labeled_images import LabeledImageSet

    state, name, stamp = WatchState.load(context.cursor, memory), "hands", stamp_of_folder(folder)

    def skip(reason: str) -> dg.SensorResult:
        return dg.SensorResult(skip_reason=reason, cursor=state.save(memory, context.cursor))

    if not stamp:
        return skip(f"no images in {folder}")
    if not state.settled({name: stamp}):
        is_known = state.done.get(name) == stamp
        return skip(_nothing_new(state) if is_known else f"{folder} has changed; waiting until it is settled")
    digest = digest_of_folder(folder, memory / "digests" / f"{name}.json", _READING_S)
    if digest is None:
        return skip(f"reading {folder}; the next tick continues")
    if not state.is_new(name, stamp, digest):
        return skip(_nothing_new(state))
    try:
        LabeledImageSet.load(folder)
    except DeltasafeError as error:
        state.defects[name] = str(error)
        return skip(_nothing_new(state))
    config = {"ops": {"raw_hands": {"config": {"folder": str(folder)}}}}
    request = dg.RunRequest(state.run_key(name), config, tags={**jobs.ALL_MEMBERS, **jobs.UNATTENDED})
    return dg.SensorResult([request], cursor=state.save(memory, context.cursor))


def check_scenes(context: dg.SensorEvaluationContext, folder: pathlib.Path, memory: pathlib.Path) -> dg.SensorResult:
    """Request a partition and a run for every scene below ``folder`` that is new or changed, settled and valid.

    Args:
        memory: folder for what the sensor remembers.
    """
    from deltasafe.scene import LoggedScene
    from deltasafe.scene.logged_scenes import scene_files

    stamps = {path.parent.name: stamp_of_folder(path.parent) for path in scene_files(folder)}
    state, requests = WatchState.load(context.cursor, memory), []
    state.defects = {name: text for name, text in state.defects.items() if name in stamps}
    for name in state.settled(stamps):
        if not state.is_new(name, stamps[name], digest_of_folder(folder / name) or ""):
            continue
        try:
            LoggedScene.load(folder / name)
        except DeltasafeError as error:
            state.defects[name] = str(error)
            continue
        config = {"ops": {"logged_scene": {"config": {"folder": str(folder)}}}}
        requests.append(dg.RunRequest(state.run_key(name), config, partition_key=name, tags=jobs.UNATTENDED))
    cursor = state.save(memory, context.cursor)
    if not requests:
        reason = _nothing_new(state) if state.defects else f"no new settled scene in {folder}"
        return dg.SensorResult(skip_reason=reason, cursor=cursor)
    if state.defects:  # a tick that requests runs has no reason to skip
        context.log.warning(_nothing_new(state))
    partitions = scene_partitions.build_add_request([str(request.partition_key) for request in requests])
    return dg.SensorResult(requests, dynamic_partitions_requests=[partitions], cursor=cursor)


def _nothing_new(state: WatchState) -> str:
    """Name the defects, in every tick until they are mended; only some of many, since Dagster stores every tick."""
    if not state.defects:
        return "nothing new"
    named = [f"{text:.300}" for _, text in sorted(state.defects.items())[:_N_NAMED]]
    more = len(state.defects) - len(named)
    return f"not used until it is changed: {'; '.join(named)}{f'; and {more} more' if more else ''}"
