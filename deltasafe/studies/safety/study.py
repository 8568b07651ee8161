"""The study: situation after situation until enough motions were executed. Interrupted, it goes on where it was."""

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
from deltasafe.io.records import from_json
from deltasafe.io.storage import atomic_folder, digest_of, read_json, sha256_of_file, write_json
from deltasafe.scene import load_scenes
from deltasafe.studies.resumable_jobs import Batch, Effort, run_batches
from deltasafe.studies.safety.motions import OUTCOMES
from deltasafe.studies.safety.runs import BY_SPEED, COLUMNS, STAGES, Eyes, FrozenEyes, SceneRef, meet
from deltasafe.studies.safety.settings import CONTENDERS, LABELS, SafetyStudySettings

__all__ = ["SafetyStudy", "StudyInputs", "run_study"]

MOST_BARREN = 40
"""Situations in a row without a single execution after which the study gives up."""


@dataclasses.dataclass(frozen=True)
class StudyInputs:
    """What a study looks at, and with what.

    Attributes:
        scenes, names: scenes by folder and digest, and how they are called.
        eyes: who looks; None in a study that was read again and was not made with a frozen ensemble.
        n_members, smallest_supported_delta: of the ensemble, by its manifest and calibration; None: it supports none.
    """

    scenes: tuple[SceneRef, ...]
    names: tuple[str, ...]
    eyes: Eyes | None
    n_members: int
    smallest_supported_delta: float | None

    def __post_init__(self) -> None:
        if not self.scenes or len(self.scenes) != len(self.names):
            raise SettingsError(
                f"a study needs at least one scene, each with a name; got {len(self.scenes)} and {len(self.names)}"
            )

    @classmethod
    def gather(
        cls, folders: Sequence[str | pathlib.Path], ensemble: str | pathlib.Path, n_scenes: int = 0
    ) -> "StudyInputs":
        """The first ``n_scenes`` (0: all) scenes of each folder, and a frozen ensemble.

        Raises:
            DataError: a folder holds no scene, or a defective one.
            ArtifactError: the ensemble is incomplete or altered.
        """
        from deltasafe.perception.artifact.frozen_ensemble import verify_artifact
        from deltasafe.perception.calibration.delta_support import Calibration

        found, names = [], []
        for folder in folders:
            for scene in load_scenes(folder)[: n_scenes or None]:
                place = scene.image_path.parent
                files = (place / "scene.json", scene.image_path, scene.mask_path, scene.mesh_path)
                found.append(SceneRef(str(place.resolve()), digest_of([sha256_of_file(file) for file in files])))
                names.append(scene.id if len(folders) == 1 else f"{pathlib.Path(folder).name}/{scene.id}")
        ensemble = pathlib.Path(ensemble).resolve()
        manifest = verify_artifact(ensemble)
        supported = Calibration.load(ensemble / "calibration.json").smallest_supported_delta
        return cls(tuple(found), tuple(names), FrozenEyes(str(ensemble)), manifest["n_members"], supported)


@dataclasses.dataclass(frozen=True)
class SafetyStudy:
    """All trials.

    Attributes:
        settings: of the study.
        inputs: scenes and ensemble.
        trials: by column, (T,) and (T, bins); see ``COLUMNS`` and ``BY_SPEED``. Trial number n is row n.
        effort: what it took; ``stage_s`` is CPU time by stage.
    """

    settings: SafetyStudySettings
    inputs: StudyInputs
    trials: Mapping[str, NDArray[Any]]
    effort: Effort
    stage_s: Mapping[str, float]

    @functools.cached_property
    def executed(self) -> NDArray[np.bool_]:
        """(T,)"""
        return np.asarray(self.trials["outcome"] == OUTCOMES.index("executed"))

    def of(self, contender: str, delta: float) -> NDArray[np.bool_]:
        """(T,) the trials of a contender at a level."""
        chosen = self.trials["contender"] == CONTENDERS.index(contender)
        return np.asarray(chosen & (self.trials["delta"] == delta))

    def label(self, contender: str) -> str:
        """How a contender is called for people."""
        return LABELS[contender].format(members=self.inputs.n_members)

    @property
    def simulated_s(self) -> float:
        """Duration of all executions by the arm's clock."""
        return float(np.nansum(self.trials["simulated_s"]))

    def save(self, folder: str | pathlib.Path) -> None:
        """Write `trials.npz` and `study.json`, as a whole. Equal trials give equal bytes of `trials.npz`."""
        with atomic_folder(folder) as temporary:
            np.savez_compressed(temporary / "trials.npz", **self.trials)  # type: ignore[arg-type]
            write_json(
                temporary / "study.json",
                {
                    "settings": self.settings,
                    "scenes": self.inputs.scenes,
                    "names": self.inputs.names,
                    "ensemble": self.inputs.eyes.folder if isinstance(self.inputs.eyes, FrozenEyes) else None,
                    "n_members": self.inputs.n_members,
                    "smallest_supported_delta": self.inputs.smallest_supported_delta,
                    "stage_s": dict(self.stage_s),
                    **dataclasses.asdict(self.effort),
                },
            )

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "SafetyStudy":
        """Read what ``save`` wrote.

        Raises:
            DataError: a file is missing, or holds something else.
        """
        folder = pathlib.Path(folder)
        record = read_json(folder / "study.json")
        try:
            settings = from_json(SafetyStudySettings, record["settings"])
            with (folder / "trials.npz").open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
                trials = {name: arrays[name] for name in (*COLUMNS, *BY_SPEED)}
            count = len(trials["situation"])
            if any(len(column) != count for column in trials.values()):
                raise ValueError("columns of different lengths")
            inputs = StudyInputs(
                tuple(SceneRef(**scene) for scene in record["scenes"]),
                tuple(record["names"]),
                FrozenEyes(record["ensemble"]) if record["ensemble"] else None,
                record["n_members"],
                record["smallest_supported_delta"],
            )
            return cls(
                settings,
                inputs,
                trials,
                Effort(record["minutes"], record["cpu_minutes"]),
                record["stage_s"],
            )
        except (OSError, EOFError, ValueError, KeyError, TypeError) as error:
            raise DataError(folder, f"holds no safety study of this version ({error})") from error


def run_study(
    settings: SafetyStudySettings,
    inputs: StudyInputs,
    folder: str | pathlib.Path,
    workers: int = 1,
    progress: Progress = silent,
    executor: Executor = LOCAL,
) -> SafetyStudy:
    """Run, or go on with, the study; a batch in ``folder`` is a situation with all its trials.

    Situations are added until ``settings.n_executions`` motions were executed. How many are added at a time follows
    from the outcomes so far alone: the trials depend neither on interruptions nor on ``workers`` or ``executor``.
    Scenes and ensemble are read where the executor works.

    Raises:
        SettingsError: nobody is there to look, or contender after contender refuses every situation.
    """
    if inputs.eyes is None:
        raise SettingsError("a study needs eyes to look with; give StudyInputs a frozen ensemble")
    used = {
        name: getattr(settings, name)
        for name in (field.name for field in dataclasses.fields(settings))
        if name not in _NOT_OF_A_TRIAL
    }
    each = SafetyStudySettings(**used)
    batches: list[Batch] = []
    effort, executed, count = Effort(0.0, 0.0), 0, 0
    while executed < settings.n_executions:
        count += _more(settings, executed, count)
        jobs = [(f"situation-{number:05d}", (each, inputs.scenes, inputs.eyes, number)) for number in range(count)]
        batches, effort = run_batches(meet, jobs, folder, workers, progress, executor=executor)
        executed = sum(int((batch["outcome"] == OUTCOMES.index("executed")).sum()) for batch in batches)
        progress(executed, max(executed, settings.n_executions), "motions executed")
    trials = {name: np.concatenate([batch[name] for batch in batches]) for name in (*COLUMNS, *BY_SPEED)}
    seconds = np.concatenate([batch["seconds"] for batch in batches]).sum(axis=0)
    stage_s = dict(zip(STAGES, map(float, seconds), strict=True))
    return SafetyStudy(settings, inputs, trials, effort, stage_s)


_NOT_OF_A_TRIAL = ("n_executions", "n_bootstrap", "n_films")


def _more(settings: SafetyStudySettings, executed: int, situations: int) -> int:
    """How many situations to add: at first as if few were refused, then what is missing by the rate so far."""
    if situations == 0:
        return max(1, math.floor(settings.n_executions / settings.trials_per_situation))
    if executed == 0:
        if situations >= MOST_BARREN:
            raise SettingsError(f"not one motion was executed in {situations} situations; look at their outcomes")
        return MOST_BARREN
    return math.ceil(1.02 * (settings.n_executions - executed) * situations / executed)
