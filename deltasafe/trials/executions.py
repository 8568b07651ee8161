"""Executions of the planned motions on the simulated arm, beside the true hand of each scene that has one."""

import contextlib
import dataclasses
import pathlib

from deltasafe.compute.executor import LOCAL, Executor, Needs, Task
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, PlanningError
from deltasafe.execution import ExecutionSettings, MonitorLimits, Workcell, execute
from deltasafe.execution.recording import Execution
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning import DistanceField
from deltasafe.scene import LoggedScene
from deltasafe.trials.motions import PlannedScenes, load_motion
from deltasafe.trials.occupancy_fields import load_image_stamp, load_occupancy_grid


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Whether the motion of a scene was executed, and if not, why."""

    scene_id: str
    executed: bool
    reason: str


def execute_scenes(
    planned: PlannedScenes,
    folder: pathlib.Path,
    settings: ExecutionSettings,
    seed: int,
    workers: int = 1,
    executor: Executor = LOCAL,
    progress: Progress = silent,
) -> list[Outcome]:
    """Execute every scene that has a safe motion; write `SCENE/` into ``folder``, which appears atomically.

    A scene without a motion, or with one that the arm cannot follow, is an outcome with its reason. No link of the
    arm may come below the upper face of the field. A scene without a true mesh is executed in a world without a hand.

    Args:
        seed: draws the arm's friction; scene k uses seed + k.
        workers: parallel executions on one machine; the results do not depend on it.
        executor: runs one task per scene.

    Raises:
        DataError: a motion was planned from another image than its field.
        SettingsError: ``workers`` is less than 1.
        WorkerLostError: the worker of a scene was lost repeatedly.
    """
    tasks = [
        Task(f"execution of {scene.id}", _execute, (scene, planned.fields, planned.motions, settings, seed + index))
        for index, scene in enumerate(planned.scenes)
    ]
    outcomes = {}
    with (
        atomic_folder(folder) as temporary,
        # a process of its own even for one worker: PyBullet's C code may crash, and writes to the standard streams
        contextlib.closing(executor.run(tasks, workers, Needs(own_process=True))) as results,
    ):
        for index, (outcome, execution) in results:
            outcomes[index] = outcome
            if execution is not None:
                execution.save(temporary / outcome.scene_id)
            verb = "executed" if outcome.executed else "did not execute"
            progress(len(outcomes), len(tasks), f"{verb} {outcome.scene_id} {outcome.reason}".strip())
        ordered = [outcomes[index] for index in range(len(tasks))]
        write_json(temporary / "outcomes.json", [dataclasses.asdict(outcome) for outcome in ordered])
    return ordered


def _execute(
    scene: LoggedScene, fields: pathlib.Path, motions: pathlib.Path, settings: ExecutionSettings, seed: int
) -> tuple[Outcome, Execution | None]:
    motion = load_motion(motions, scene.id)
    if motion.trajectory is None:
        return Outcome(scene.id, False, motion.reason), None
    if motion.image_stamp is not None and motion.image_stamp != load_image_stamp(fields, scene.id):
        raise DataError(motions / scene.id, "was planned from another image than its field; plan it again")
    grid = load_occupancy_grid(fields, scene.id)
    field = DistanceField.build(motion.planned_in(grid), motion.settings.delta)
    try:
        execution = execute(
            motion.trajectory,
            Workcell(motion.body, scene.mesh_if_known(), scene.table_z_m),
            settings,
            seed,
            limits=MonitorLimits.of(motion.settings, field),
            unsafe_below_m=float(grid.upper_m[2]) + float(motion.tracking.error_m(motion.settings.v_max_mps)),
        )
    except PlanningError as error:
        return Outcome(scene.id, False, str(error)), None
    return Outcome(scene.id, True, execution.stop_reason), execution


def load_outcomes(folder: pathlib.Path) -> list[Outcome]:
    """Load the outcomes that `execute_scenes` returned.

    Raises:
        DataError: ``folder`` holds no executions.
    """
    file = folder / "outcomes.json"
    try:
        return [Outcome(**entry) for entry in read_json(file)]
    except TypeError as error:
        raise DataError(file, f"is not a list of outcomes ({error}); execute the motions again") from error


def load_execution(folder: pathlib.Path, scene_id: str) -> Execution:
    """Load the recording of a scene.

    Raises:
        DataError: there is none in ``folder``.
    """
    return Execution.load(folder / scene_id)
