"""Single scene: plan and execute one logged scene at a time. Every scene is a partition."""

import functools
import pathlib

import dagster as dg

from assets.checks import audit_result, safety_result
from assets.interfaces import Store
from assets.motion import ExecutionConfig, FieldConfig, PlannerConfig
from assets.policies import ALL_CORES, RETRY_TWICE, no_retry
from assets.progress import progress_of
from assets.reporting import Metadata, folder_facts, inline_picture, readable, report_with_summary
from deltasafe.perception.data.dataset_info import DatasetInfo

scenes = dg.DynamicPartitionsDefinition(name="scenes")
_asset = functools.partial(
    dg.asset, group_name="single_scene", owners=["team:motion"], code_version="1", partitions_def=scenes
)
_heavy = functools.partial(_asset, pool=ALL_CORES, retry_policy=RETRY_TWICE)


class SceneConfig(dg.Config):
    """`folder` contains a folder with the name of the partition and scene.json in it.

    If it is empty, the packaged scenes are used.
    """

    folder: str = ""


class SceneMotionConfig(dg.Config):
    """Settings of the occupancy field and of planning. `seed` is the seed of the planner."""

    field: FieldConfig = FieldConfig()
    motion: PlannerConfig = PlannerConfig()
    seed: int = 0


class SceneExecutionConfig(dg.Config):
    """Settings of the simulated execution. `seed` draws the friction of the arm."""

    execution: ExecutionConfig = ExecutionConfig()
    seed: int = 0


@_asset(kinds={"image", "json"})
@no_retry
def logged_scene(
    context: dg.AssetExecutionContext, config: SceneConfig, store: dg.ResourceParam[Store]
) -> dg.Output[pathlib.Path]:
    """A newly logged scene: image, camera, start and goal, all checked.

    A failure names the file and the defect.
    """
    from deltasafe.io.storage import sha256_of_file
    from deltasafe.trials.selection import select_scene

    source, _ = store.dataset(config.folder, "scenes")
    folder = store.folder("logged_scene", f"{context.partition_key}-{context.run.run_id[:8]}")
    scene = select_scene(source / context.partition_key, folder)
    version = sha256_of_file(folder / "scenes.json")[:16]
    shown = {"image": inline_picture(scene.image_path, 60_000), "with true obstacles": scene.mesh_path is not None}
    metadata = {**shown, **folder_facts(scene.image_path.parent, version)}
    return dg.Output(folder, metadata=metadata, data_version=dg.DataVersion(version))


@_heavy(kinds={"pytorch", "numba"})
@no_retry
def scene_motion(
    context: dg.AssetExecutionContext,
    config: SceneMotionConfig,
    logged_scene: pathlib.Path,
    champion: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """Occupancy field of the scene and a delta-safe motion in it, or the reason that none was found.

    Made from logged_scene with the ensemble in use (champion).
    """
    from deltasafe.trials.single_scene import plan_scene

    folder = store.folder("scene_motion", f"{context.partition_key}-{context.run.run_id[:8]}")
    settings, field = config.motion.settings(), config.field.settings()
    motion = plan_scene(logged_scene, champion, folder, field, settings, config.seed, progress_of(context))
    plan = inline_picture(folder / "motions" / context.partition_key / "plan.png", 60_000)
    facts: Metadata = {"safe motion": motion.is_safe, "reason": motion.reason, "ensemble": champion.name}
    return dg.Output(folder, metadata={"plan": plan, **facts, **folder_facts(folder)})


@_heavy(kinds={"bullet", "markdown"})
@no_retry
def scene_execution(
    context: dg.AssetExecutionContext,
    config: SceneExecutionConfig,
    logged_scene: pathlib.Path,
    scene_motion: pathlib.Path,
    store: dg.ResourceParam[Store],
) -> dg.Output[pathlib.Path]:
    """The motion on the simulated arm next to the true obstacle, with a safety report.

    Made from scene_motion. Without true obstacles, contacts are not judged. The check execution_of_the_scene_was_safe
    decides on its figures.
    """
    from deltasafe.trials.single_scene import execute_scene

    folder = store.folder("scene_execution", f"{context.partition_key}-{context.run.run_id[:8]}")
    report = execute_scene(
        logged_scene, scene_motion, folder, config.execution.settings(), config.seed, progress_of(context)
    )
    shown = {
        **report_with_summary(folder / "report" / "summary.md"),
        **readable(report.figures(), DatasetInfo.load(folder / "report").singular),
    }
    return dg.Output(folder, metadata={**shown, **folder_facts(folder)})


@dg.asset_check(
    asset="scene_motion",
    additional_ins={"logged_scene": dg.AssetIn("logged_scene")},
    partitions_def=scenes,
    blocking=True,
    description="An audit that shares no code with the planner finds no unsafe pose on the trajectory. A failure means "
    "an error in the planner, and stops the run before execution.",
)
def audit_of_the_scene(scene_motion: pathlib.Path, logged_scene: pathlib.Path) -> dg.AssetCheckResult:
    return audit_result(logged_scene, scene_motion / "fields", scene_motion / "motions")


@dg.asset_check(
    asset="scene_execution",
    partitions_def=scenes,
    description="The executed motion was completed, had no contact with obstacle or table, and was delta-safe at every "
    "pose. The safety report shows why it failed.",
)
def execution_of_the_scene_was_safe(scene_execution: pathlib.Path) -> dg.AssetCheckResult:
    return safety_result(scene_execution / "report", n_required=0)
