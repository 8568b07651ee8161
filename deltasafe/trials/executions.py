"""The planned motion of each scene on the simulated arm, beside the scene's true hand."""

import contextlib
import dataclasses
import pathlib
from collections.abc import Sequence

from deltasafe.compute.executor import LOCAL, Needs, Task, in_order
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, PlanningError, SettingsError
from deltasafe.execution.recording import Execution
from deltasafe.execution.simulate import ExecutionSettings, execute, iiwa_for
from deltasafe.io.storage import atomic_folder, read_json, write_json
from deltasafe.planning import DistanceField
from deltasafe.scene import LoggedScene
from deltasafe.trials.motions import load_motion
from deltasafe.trials.occupancy_fields import load_occupancy_grid, load_seen

__all__ = ["Outcome", "execute_scenes", "load_execution", "load_outcomes"]


@dataclasses.dataclass(frozen=True)
class Outcome:
    """Whether the motion of a scene was executed, and if not, why."""

    scene_id: str
    executed: bool
    reason: str


@dataclasses.dataclass(frozen=True)
class _Job:
    scene: LoggedScene
    fields: pathlib.Path
    motions: pathlib.Path
    folder: pathlib.Path
    settings: ExecutionSettings
    seed: int


def execute_scenes(
    scenes: Sequence[LoggedScene],
    fields: str | pathlib.Path,
    motions: str | pathlib.Path,
    folder: str | pathlib.Path,
    settings: ExecutionSettings,
    seed: int,
    *,
    workers: int = 1,
    progress: Progress = silent,
) -> list[Outcome]:
    """Execute every scene that has a safe motion, into `SCENE/`; the folder appears as a whole.

    A scene without a motion, or with one that the arm cannot follow, is an outcome with its reason.

    Args:
        fields: folder of `write_fields`; no link of the arm may come below the upper face of a field.
        motions: folder of `plan_scenes`.
        seed: draws the arm's friction; scene k uses seed + k. The number of ``workers`` changes nothing.
    """
    if workers < 1:
        raise SettingsError(f"workers must be at least 1, got {workers}")
    outcomes = []
    with atomic_folder(folder) as temporary:
        jobs = [
            _Job(scene, pathlib.Path(fields), pathlib.Path(motions), temporary, settings, seed + index)
            for index, scene in enumerate(scenes)
        ]
        tasks = [Task(f"execution of {job.scene.id}", _execute, (job,)) for job in jobs]
        with contextlib.closing(LOCAL.run(tasks, workers, Needs(apart=True))) as finished:
            for done, outcome in enumerate(in_order(finished), start=1):
                outcomes.append(outcome)
                verb = "executed" if outcome.executed else "did not execute"
                progress(done, len(jobs), f"{verb} {outcome.scene_id} {outcome.reason}".strip())
        write_json(temporary / "outcomes.json", [dataclasses.asdict(outcome) for outcome in outcomes])
    return outcomes


def _execute(job: _Job) -> Outcome:
    scene = job.scene
    motion = load_motion(job.motions, scene.id)
    if motion.trajectory is None:
        return Outcome(scene.id, False, motion.reason)
    if motion.image_stamp is not None and motion.image_stamp != load_seen(job.fields, scene.id):
        raise DataError(job.motions / scene.id, "was planned from another image than its field; plan it again")
    mesh, grid = scene.true_mesh(), load_occupancy_grid(job.fields, scene.id)
    try:
        execution = execute(
            motion.trajectory,
            mesh,
            motion.body,
            job.settings,
            job.seed,
            bound=motion.tracking,
            unsafe_below_m=float(grid.upper_m[2]) + float(motion.tracking.error_m(motion.settings.v_max_mps)),
            field=DistanceField.build(grid, motion.settings.delta),
            make_arm=iiwa_for(motion.body, mesh, scene.table_z_m),
        )
    except PlanningError as error:
        return Outcome(scene.id, False, str(error))
    execution.save(job.folder / scene.id)
    return Outcome(scene.id, True, execution.stop_reason)


def load_outcomes(folder: str | pathlib.Path) -> list[Outcome]:
    """What `execute_scenes` returned.

    Raises:
        DataError: ``folder`` holds no executions.
    """
    file = pathlib.Path(folder) / "outcomes.json"
    try:
        return [Outcome(**entry) for entry in read_json(file)]
    except TypeError as error:
        raise DataError(file, f"is not a list of outcomes ({error}); execute the motions again") from error


def load_execution(folder: str | pathlib.Path, scene_id: str) -> Execution:
    """The recording of a scene.

    Raises:
        DataError: there is none in ``folder``.
    """
    return Execution.load(pathlib.Path(folder) / scene_id)
