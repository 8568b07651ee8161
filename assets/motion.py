"""From logged scenes to executed motions, and the evidence that they were safe."""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.interfaces import Store
from assets.progress import progress_of
from assets.reporting import Metadata, inline_picture
from deltasafe import presets

PRESET = presets.active()
GROUP = "motion"
OWNERS = ["team:motion"]

FieldConfig = configurable(PRESET.field)
PlannerConfig = configurable(PRESET.motion)
ExecutionConfig = configurable(PRESET.execution)


class ScenesConfig(dg.Config):
    """`folder` holds scene folders with scene.json; empty for the packaged ones. `n_scenes` = 0 is all of them."""

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
    """Films of the `n_films` executions that came closest to the hand; failures are filmed in any case."""

    n_films: int = PRESET.n_films


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"image", "json"}, code_version="1")
def logged_scenes(
    context: dg.AssetExecutionContext, config: ScenesConfig, store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """Images of a table with a hand on it, with camera, start and goal; mask and mesh are for judging alone."""
    from deltasafe.trials.selection import select_scenes

    source, _ = store.dataset(config.folder, "scenes")
    folder = store.folder("logged_scenes", context.run_id[:8])
    scenes = select_scenes(source, config.n_scenes, folder)
    return dg.Output(folder, metadata={"scenes": len(scenes), "folder": str(source)})


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"pytorch", "numpy"}, code_version="1")
def occupancy_fields(
    context: dg.AssetExecutionContext,
    config: FieldConfig,
    logged_scenes: pathlib.Path,
    frozen_ensemble: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """What the frozen ensemble sees in each scene, extruded along the camera's rays to the height of the hand."""
    from deltasafe.perception.artifact import load_ensemble
    from deltasafe.trials.fields import write_fields
    from deltasafe.trials.overview import overview
    from deltasafe.trials.selection import load_selection

    scenes = load_selection(logged_scenes)
    folder = store.folder("occupancy_fields", context.run_id[:8])
    write_fields(load_ensemble(frozen_ensemble), scenes, folder, config.settings(), progress_of(context))
    picture = overview(scenes, folder, PRESET.motion.delta, folder / "overview.jpg")
    return dg.Output(folder, metadata={"scenes": len(scenes), "overview": inline_picture(picture)})


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"numba"}, code_version="1")
def planned_motions(
    context: dg.AssetExecutionContext,
    config: MotionConfig,
    logged_scenes: pathlib.Path,
    occupancy_fields: pathlib.Path,
    frozen_ensemble: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """A delta-safe path by SCC-RRT* and a velocity schedule for each scene, or the reason why there is none."""
    from deltasafe.perception.calibration import Calibration
    from deltasafe.storage import read_json
    from deltasafe.trials.motions import plan_scenes
    from deltasafe.trials.selection import load_selection

    calibration = Calibration(**read_json(frozen_ensemble / "calibration.json"))
    scenes, settings = load_selection(logged_scenes), config.motion.settings()
    folder, progress = store.folder("planned_motions", context.run_id[:8]), progress_of(context, every_s=2.0)
    motions = plan_scenes(scenes, occupancy_fields, folder, settings, calibration, config.first_seed, progress)
    first = next((name for name, motion in motions.items() if motion.is_safe), scenes[0].id)
    metadata: Metadata = {
        "scenes": len(scenes),
        "with a safe motion": sum(motion.is_safe for motion in motions.values()),
        "first motion": inline_picture(folder / first / "plan.png"),
    }
    return dg.Output(folder, metadata=metadata)


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"bullet"}, code_version="1")
def executed_motions(
    context: dg.AssetExecutionContext,
    config: ExecutedConfig,
    logged_scenes: pathlib.Path,
    occupancy_fields: pathlib.Path,
    planned_motions: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Every planned motion on the simulated iiwa under impedance control, beside the true hand."""
    from deltasafe.trials.executions import execute_scenes
    from deltasafe.trials.selection import load_selection

    folder = store.folder("executed_motions", context.run_id[:8])
    outcomes = execute_scenes(
        load_selection(logged_scenes),
        occupancy_fields,
        planned_motions,
        folder,
        config.execution.settings(),
        config.first_seed,
        workers=config.workers,
        progress=progress_of(context, every_s=2.0),
    )
    executed = sum(outcome.executed for outcome in outcomes)
    return dg.Output(folder, metadata={"executed": executed, "not executed": len(outcomes) - executed})


@dg.asset(group_name=GROUP, owners=OWNERS, kinds={"markdown"}, code_version="1")
def safety_report(
    context: dg.AssetExecutionContext,
    config: SafetyConfig,
    logged_scenes: pathlib.Path,
    occupancy_fields: pathlib.Path,
    planned_motions: pathlib.Path,
    executed_motions: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Was what was executed delta-safe? Clearances to the true hand, contacts, tracking errors, films."""
    from deltasafe.trials.safety_writing import write_safety_report
    from deltasafe.trials.selection import load_selection

    folder = store.folder("safety_report", context.run_id[:8])
    report = write_safety_report(
        load_selection(logged_scenes),
        occupancy_fields,
        planned_motions,
        executed_motions,
        folder,
        n_films=config.n_films,
        progress=progress_of(context, every_s=2.0),
    )
    film = next((inline_picture(folder / scene.film) for scene in report.scenes if scene.film), None)
    metadata: Metadata = {
        "report": dg.MetadataValue.md((folder / "summary.md").read_text(encoding="utf-8")),
        "plans": inline_picture(folder / "plans.jpg"),
        **({} if film is None else {"film": film}),
        **report.figures(),
        "folder": str(folder),
    }
    return dg.Output(folder, metadata=metadata)
