"""Motion: from logged scenes to executed motions and the safety report."""

import functools
import pathlib

import dagster as dg

from assets.config import configurable
from assets.interfaces import Store
from assets.policies import ALL_CORES, ON_NEW_DATA, RETRY_TWICE, no_retry
from assets.progress import progress_of
from assets.reporting import Metadata, folder_facts, inline_picture, readable, report_with_summary
from assets.run_settings import planning_delta
from deltasafe import presets
from deltasafe.compute.executor import Executor
from deltasafe.perception.data.dataset_info import DatasetInfo

PRESET = presets.active()
_asset = functools.partial(dg.asset, group_name="motion", owners=["team:motion"], code_version="1")
_derived = functools.partial(_asset, retry_policy=RETRY_TWICE, automation_condition=ON_NEW_DATA)

FieldConfig = configurable(PRESET.field)
PlannerConfig = configurable(PRESET.motion)
ExecutionConfig = configurable(PRESET.execution)


class ScenesConfig(dg.Config):
    """`folder` contains scene folders with scene.json. If it is empty, the packaged scenes are used.

    `n_scenes` limits the number of scenes; 0 means all.
    """

    folder: str = ""
    n_scenes: int = PRESET.n_scenes


class MotionConfig(dg.Config):
    """Scene k is planned with the seed `first_seed` + k."""

    motion: PlannerConfig = PlannerConfig()
    first_seed: int = 0


class ExecutedConfig(dg.Config):
    """Scene k is executed with the seed `first_seed` + k, which draws the arm's friction."""

    execution: ExecutionConfig = ExecutionConfig()
    first_seed: int = 0
    workers: int = 2


class SafetyConfig(dg.Config):
    """Films show the `n_films` executions that came closest to the obstacle. Failures are always filmed."""

    n_films: int = PRESET.n_films


@_asset(kinds={"image", "json"})
@no_retry
def logged_scenes(
    context: dg.AssetExecutionContext, config: ScenesConfig, store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """The selected scenes: image of a table with an obstacle, camera, start and goal. Each is checked.

    True mask and mesh of the obstacle are optional, and only for evaluation. A failure names the file and the defect.
    """
    from deltasafe.io.storage import sha256_of_file
    from deltasafe.trials.overview import tile_pictures
    from deltasafe.trials.selection import select_scenes

    source, _ = store.dataset(config.folder, "scenes")
    folder = store.folder("logged_scenes", context.run.run_id[:8])
    scenes = select_scenes(source, config.n_scenes, folder)
    version = sha256_of_file(folder / "scenes.json")[:16]
    sheet = folder.with_name(f"{folder.name}-sheet.jpg")
    tile_pictures([scene.image_path for scene in scenes[:20]], sheet, columns=5)
    judged = sum(scene.mesh_path is not None for scene in scenes)
    facts = {"scenes": len(scenes), "with true obstacles": judged, "source folder": str(source)}
    metadata = {"scenes as logged": inline_picture(sheet), **facts, **folder_facts(folder, version)}
    return dg.Output(folder, metadata=metadata, data_version=dg.DataVersion(version))


@_derived(kinds={"pytorch", "numpy"})
@no_retry
def occupancy_fields(
    context: dg.AssetExecutionContext,
    config: FieldConfig,
    logged_scenes: pathlib.Path,
    champion: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Occupancy probability of each scene: the prediction of the ensemble, extruded along camera rays to its height.

    Made from logged_scenes with the ensemble in use (champion).
    """
    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
    from deltasafe.trials.occupancy_fields import write_fields
    from deltasafe.trials.overview import overview
    from deltasafe.trials.selection import load_selection

    scenes = load_selection(logged_scenes)
    folder = store.folder("occupancy_fields", context.run.run_id[:8])
    write_fields(load_ensemble(champion), scenes, folder, config.settings(), progress_of(context))
    picture = overview(scenes, folder, planning_delta(context.run.run_config), folder / "overview.jpg")
    metadata: Metadata = {"overview": inline_picture(picture), "scenes": len(scenes), "ensemble": champion.name}
    return dg.Output(folder, metadata={**metadata, **folder_facts(folder)})


@_derived(kinds={"numba"}, pool=ALL_CORES)
@no_retry
def planned_motions(
    context: dg.AssetExecutionContext,
    config: MotionConfig,
    logged_scenes: pathlib.Path,
    occupancy_fields: pathlib.Path,
    champion: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """A delta-safe path and a velocity schedule per scene, planned by SCC-RRT*, or the reason that none was found.

    Made from occupancy_fields. Scenes without a motion are listed and do not fail the asset.
    """
    from deltasafe.perception.calibration.delta_support import Calibration
    from deltasafe.trials.motions import plan_scenes
    from deltasafe.trials.selection import load_selection

    calibration = Calibration.load(champion / "calibration.json")
    scenes, settings = load_selection(logged_scenes), config.motion.settings()
    folder, progress = store.folder("planned_motions", context.run.run_id[:8]), progress_of(context, every_s=2.0)
    motions = plan_scenes(scenes, occupancy_fields, folder, settings, calibration, config.first_seed, progress)
    first = next((name for name, motion in motions.items() if motion.is_safe), scenes[0].id)
    reasons = {name: motion.reason for name, motion in motions.items() if not motion.is_safe}
    metadata: Metadata = {
        "first motion": inline_picture(folder / first / "plan.png"),
        "scenes": len(scenes),
        "with a safe motion": len(scenes) - len(reasons),
        **({"reasons": reasons} if reasons else {}),
        **folder_facts(folder),
    }
    return dg.Output(folder, metadata=metadata)


@_derived(kinds={"bullet"}, pool=ALL_CORES)
@no_retry
def executed_motions(
    context: dg.AssetExecutionContext,
    config: ExecutedConfig,
    logged_scenes: pathlib.Path,
    occupancy_fields: pathlib.Path,
    planned_motions: pathlib.Path,
    store: dg.ResourceParam[Store],
    executor: dg.ResourceParam[Executor],
) -> dg.Output[pathlib.Path]:
    """Recordings of all planned motions on the simulated arm with impedance control, next to the true obstacle.

    Made from planned_motions. A scene without a true one is executed in an empty world. Motions that were not
    executed are listed with the reason.
    """
    from deltasafe.trials.executions import execute_scenes
    from deltasafe.trials.motions import PlannedScenes
    from deltasafe.trials.selection import load_selection

    folder = store.folder("executed_motions", context.run.run_id[:8])
    outcomes = execute_scenes(
        PlannedScenes(load_selection(logged_scenes), occupancy_fields, planned_motions),
        folder,
        config.execution.settings(),
        config.first_seed,
        config.workers,
        executor,
        progress_of(context, every_s=2.0),
    )
    executed = sum(outcome.executed for outcome in outcomes)
    reasons = {outcome.scene_id: outcome.reason for outcome in outcomes if not outcome.executed}
    metadata = {
        "executed": executed,
        "not executed": len(reasons),
        **({"reasons": reasons} if reasons else {}),
        **folder_facts(folder),
    }
    return dg.Output(folder, metadata=metadata)


@_derived(kinds={"markdown"})
@no_retry
def safety_report(
    context: dg.AssetExecutionContext,
    config: SafetyConfig,
    logged_scenes: pathlib.Path,
    occupancy_fields: pathlib.Path,
    planned_motions: pathlib.Path,
    executed_motions: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Report on the executed motions: delta-safety, clearance to the true obstacle, contacts, tracking errors, films.

    Made from executed_motions. Without a true obstacle, contacts are not judged. The checks executions_were_safe and
    tracking_kept_its_bound decide on its figures.
    """
    from deltasafe.trials.motions import PlannedScenes
    from deltasafe.trials.selection import load_selection
    from deltasafe.trials.write_safety_report import write_safety_report

    folder = store.folder("safety_report", context.run.run_id[:8])
    report = write_safety_report(
        PlannedScenes(load_selection(logged_scenes), occupancy_fields, planned_motions),
        executed_motions,
        folder,
        n_films=config.n_films,
        progress=progress_of(context, every_s=2.0),
    )
    executed = folder / "executed.jpg"
    film = next((inline_picture(folder / scene.film, 20_000) for scene in report.scenes if scene.film), None)
    metadata: Metadata = {
        **report_with_summary(folder / "summary.md"),
        "plans": inline_picture(folder / "plans.jpg", 35_000),
        **({"executed": inline_picture(executed, 35_000)} if executed.is_file() else {}),
        **({} if film is None else {"film": film}),
        **readable(report.figures(), DatasetInfo.load(folder).singular),
        **folder_facts(folder),
    }
    return dg.Output(folder, metadata=metadata)
