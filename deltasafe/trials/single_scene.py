"""The steps of the chain for one logged scene: prediction and plan in one folder, execution and report in another."""

import pathlib

from deltasafe.compute.progress import Progress, silent
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.io.storage import atomic_folder
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from deltasafe.planning import MotionSettings, PlannedMotion
from deltasafe.scene import FieldSettings
from deltasafe.trials.executions import execute_scenes
from deltasafe.trials.motions import PlannedScenes, load_motion, plan_scenes
from deltasafe.trials.occupancy_fields import write_fields
from deltasafe.trials.safety_report import SafetyReport
from deltasafe.trials.selection import load_selection
from deltasafe.trials.write_safety_report import write_safety_report


def plan_scene(
    selection: pathlib.Path,
    ensemble: pathlib.Path,
    folder: pathlib.Path,
    field: FieldSettings,
    motion: MotionSettings,
    seed: int,
    progress: Progress = silent,
) -> PlannedMotion:
    """Predict the occupancy of a scene and plan its motion.

    Args:
        selection: folder that `select_scene` wrote.
        ensemble: folder of a frozen ensemble.
        folder: gets ``fields/`` and ``motions/``, atomically.

    Raises:
        SettingsError: the ensemble's calibration does not support the delta of ``motion``.
        DataError: a file of the scene is defective.
    """
    scenes, loaded = load_selection(selection), load_ensemble(ensemble)
    with atomic_folder(folder) as temporary:
        fields, motions = temporary / "fields", temporary / "motions"
        write_fields(loaded, scenes, fields, field, progress)
        plan_scenes(scenes, fields, motions, motion, loaded.calibration, seed, progress)
    return load_motion(folder / "motions", scenes[0].id)


def execute_scene(
    selection: pathlib.Path,
    planned: pathlib.Path,
    folder: pathlib.Path,
    settings: ExecutionSettings,
    seed: int,
    progress: Progress = silent,
) -> SafetyReport:
    """Execute the motion of `plan_scene` on the simulated arm, and write the safety report.

    Args:
        planned: folder that `plan_scene` wrote.
        folder: gets ``executions/`` and ``report/``, atomically.
    """
    scenes = PlannedScenes(load_selection(selection), planned / "fields", planned / "motions")
    with atomic_folder(folder) as temporary:
        executions = temporary / "executions"
        execute_scenes(scenes, executions, settings, seed, progress=progress)
        return write_safety_report(scenes, executions, temporary / "report", n_films=0, progress=progress)
