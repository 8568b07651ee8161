"""The safety study: scenarios are run until enough motions were executed; an interrupted study resumes."""

import dataclasses
import functools
import math
import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.arrays import read_npz
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, digest_of, read_json, sha256_of_file, write_json
from deltasafe.scene import load_scenes
from deltasafe.studies.resumable_jobs import Batch, Effort, run_batches
from deltasafe.studies.safety.motions import OUTCOMES
from deltasafe.studies.safety.predictors import FrozenEnsemblePredictor, Predictor
from deltasafe.studies.safety.runs import BY_SPEED, COLUMNS, STAGES, SceneRef, run_scenario
from deltasafe.studies.safety.settings import LABELS, METHODS, SafetyStudySettings

MAX_SCENARIOS_WITHOUT_MOTION = 40
"""If no motion was executed in this many scenarios, the study fails."""


@dataclasses.dataclass(frozen=True)
class StudyInputs:
    """Scenes and predictor of a study.

    Attributes:
        scenes, names: scenes by folder and digest, and their names in reports.
        predictor: predicts p_occupied; None if a loaded study did not use a frozen ensemble.
        n_members: number of members of the ensemble.
        smallest_supported_delta: from the calibration of the ensemble; None if it supports no delta.
    """

    scenes: tuple[SceneRef, ...]
    names: tuple[str, ...]
    predictor: Predictor | None
    n_members: int
    smallest_supported_delta: float | None

    def __post_init__(self) -> None:
        if not self.scenes or len(self.scenes) != len(self.names):
            raise SettingsError(
                f"a study needs at least one scene and a name for each, got {len(self.scenes)} and {len(self.names)}"
            )

    @classmethod
    def gather(
        cls, folders: Sequence[str | pathlib.Path], ensemble: str | pathlib.Path, n_scenes: int = 0
    ) -> "StudyInputs":
        """Collect the first ``n_scenes`` (0: all) scenes of each folder, and a frozen ensemble.

        Raises:
            DataError: a folder holds no scene, a defective one, or one without true mask and mesh.
            ArtifactError: the ensemble is incomplete or altered.
        """
        from deltasafe.perception.artifact.frozen_ensemble import verify_artifact
        from deltasafe.perception.calibration.delta_support import Calibration

        found, names = [], []
        for folder in folders:
            for scene in load_scenes(folder)[: n_scenes or None]:
                home = scene.image_path.parent
                if scene.mask_path is None or scene.mesh_path is None:
                    raise DataError(
                        home / "scene.json",
                        "names no true mask and mesh (ground_truth), by which the study judges; leave this scene out",
                    )
                files = (home / "scene.json", scene.image_path, scene.mask_path, scene.mesh_path)
                found.append(SceneRef(str(home.resolve()), digest_of([sha256_of_file(file) for file in files])))
                names.append(scene.id if len(folders) == 1 else f"{pathlib.Path(folder).name}/{scene.id}")
        ensemble = pathlib.Path(ensemble).resolve()
        manifest = verify_artifact(ensemble)
        supported = Calibration.load(ensemble / "calibration.json").smallest_supported_delta
        return cls(tuple(found), tuple(names), FrozenEnsemblePredictor(str(ensemble)), manifest["n_members"], supported)


@dataclasses.dataclass(frozen=True)
class SafetyStudy:
    """All trials of a study.

    Attributes:
        settings: of the study.
        inputs: scenes and predictor.
        trials: by column, (T,) and (T, bins); see ``COLUMNS`` and ``BY_SPEED``. Trial number n is row n.
        effort: time spent.
        stage_s: CPU time by stage.
    """

    settings: SafetyStudySettings
    inputs: StudyInputs
    trials: Mapping[str, NDArray[Any]]
    effort: Effort
    stage_s: Mapping[str, float]

    @functools.cached_property
    def executed(self) -> NDArray[np.bool_]:
        """Trials (T,) in which a motion was executed."""
        return np.asarray(self.trials["outcome"] == OUTCOMES.index("executed"))

    def of(self, method: str, delta: float) -> NDArray[np.bool_]:
        """Select the trials (T,) of a method at a delta."""
        chosen = self.trials["method"] == METHODS.index(method)
        return np.asarray(chosen & (self.trials["delta"] == delta))

    def label(self, method: str) -> str:
        """Return the name of a method in tables and legends."""
        return LABELS[method].format(members=self.inputs.n_members, alpha=self.settings.motion_alpha)

    @property
    def simulated_s(self) -> float:
        """Duration of all executions in simulated time."""
        return float(np.nansum(self.trials["simulated_s"]))

    def save(self, folder: str | pathlib.Path) -> None:
        """Write trials.npz and study.json atomically. Equal trials give equal bytes of trials.npz."""
        predictor = self.inputs.predictor
        with atomic_folder(folder) as temporary:
            np.savez_compressed(temporary / "trials.npz", **self.trials)  # type: ignore[arg-type]
            write_json(
                temporary / "study.json",
                {
                    "settings": self.settings,
                    "scenes": self.inputs.scenes,
                    "names": self.inputs.names,
                    "ensemble": predictor.folder if isinstance(predictor, FrozenEnsemblePredictor) else None,
                    "n_members": self.inputs.n_members,
                    "smallest_supported_delta": self.inputs.smallest_supported_delta,
                    "stage_s": dict(self.stage_s),
                    **dataclasses.asdict(self.effort),
                },
            )

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "SafetyStudy":
        """Read a folder that ``save`` wrote.

        Raises:
            DataError: a file is missing or has other content.
        """
        folder = pathlib.Path(folder)
        record, arrays = read_json(folder / "study.json"), read_npz(folder / "trials.npz")
        try:
            settings = from_json(SafetyStudySettings, record["settings"])
            trials = {name: arrays[name] for name in (*COLUMNS, *BY_SPEED)}
            if len({len(column) for column in trials.values()}) > 1:
                raise ValueError("columns of different lengths")
            inputs = StudyInputs(
                tuple(SceneRef(**scene) for scene in record["scenes"]),
                tuple(record["names"]),
                FrozenEnsemblePredictor(record["ensemble"]) if record["ensemble"] else None,
                record["n_members"],
                record["smallest_supported_delta"],
            )
            effort = Effort(record["minutes"], record["cpu_minutes"])
            return cls(settings, inputs, trials, effort, record["stage_s"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(folder, f"is not a safety study of this version ({error}); run it again") from error


def run_study(
    settings: SafetyStudySettings,
    inputs: StudyInputs,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> SafetyStudy:
    """Run or resume the study; each batch in ``folder`` is one scenario with all its trials.

    Scenarios are added until ``settings.n_executions`` motions were executed. The number added at a time depends only
    on the outcomes so far, so that interruptions, ``workers`` and ``executor`` do not change the trials. The executor's
    processes read scenes and ensemble from their folders.

    Raises:
        SettingsError: there is no predictor, or no motion was executed in many scenarios.
    """
    if inputs.predictor is None:
        raise SettingsError("a study needs a predictor; give StudyInputs a frozen ensemble")
    default = SafetyStudySettings()
    of_trial = dataclasses.replace(settings, n_executions=default.n_executions, n_films=default.n_films)
    batches: list[Batch] = []
    effort, executed, count = Effort(0.0, 0.0), 0, 0
    while executed < settings.n_executions:
        count += _scenarios_to_add(settings, executed, count)
        jobs = [(f"scenario-{n:05d}", (of_trial, inputs.scenes, inputs.predictor, n)) for n in range(count)]
        batches, effort = run_batches(run_scenario, jobs, folder, workers, progress, executor=executor)
        executed = sum(int((batch["outcome"] == OUTCOMES.index("executed")).sum()) for batch in batches)
        progress(executed, max(executed, settings.n_executions), "motions executed")
    trials = {name: np.concatenate([batch[name] for batch in batches]) for name in (*COLUMNS, *BY_SPEED)}
    seconds = np.concatenate([batch["seconds"] for batch in batches]).sum(axis=0)
    stage_s = dict(zip(STAGES, map(float, seconds), strict=True))
    return SafetyStudy(settings, inputs, trials, effort, stage_s)


def _scenarios_to_add(settings: SafetyStudySettings, executed: int, scenarios: int) -> int:
    """Choose the number of scenarios to add: first as if no trial were refused, then by the rate of executions."""
    if scenarios == 0:
        return max(1, math.floor(settings.n_executions / settings.trials_per_scenario))
    if executed == 0:
        if scenarios >= MAX_SCENARIOS_WITHOUT_MOTION:
            raise SettingsError(f"no motion was executed in {scenarios} scenarios; see the outcomes of their trials")
        return MAX_SCENARIOS_WITHOUT_MOTION
    return math.ceil(1.02 * (settings.n_executions - executed) * scenarios / executed)
