"""Train and evaluate the cells: augmented set, members, predictions, scores. Finished work is reused."""

import dataclasses
import functools
import pathlib
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.code_digest import digest_of_code
from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import digest_of, sha256_of_file, write_json
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import FORMAT_VERSION, CalibrationReport, CalibrationSettings
from deltasafe.perception.data.augmentation import AugmentationSettings
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes import SCHEMES, ComparedSettings, CutoutSettings, MixupSettings, SchemeSettings
from deltasafe.perception.evaluate_and_freeze import predict_images, read_labels
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.inference.predictions import MemberPredictions
from deltasafe.perception.settings import InferenceSettings, TrainingSettings
from deltasafe.perception.training.device import pick_device
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_ensemble import MemberJob, train_members
from deltasafe.perception.training.train_member import StepReport, training_identity
from deltasafe.studies.perception.settings import Cell, StudySettings

OnStep = Callable[[str, StepReport], None]


@dataclasses.dataclass(frozen=True)
class Study:
    """The studies of section V-A on a training and a test set.

    Every folder below ``home`` is named by a digest of all inputs that determine its content. Members have the folders
    of the chain's own members, so that study and chain share them.

    Attributes:
        settings: the cells.
        augmentation: of our scheme; ``n_variants`` and ``left_out`` are set by the cell. The compared schemes have the
            same image size and seed.
        training: of a cell of the largest size. Smaller cells have more epochs, so that all take the same number of
            steps. A lighter recipe of the comparisons replaces image width and epochs.
        inference: resolution of the ensembles; scaled down with the image width of the comparisons.
        calibration: bootstrap of the intervals.
        train: labeled images that the augmented sets are made from.
        test: labeled images that every cell is evaluated on.
        backgrounds: folder of pictures without hands, for our scheme; None: procedural surfaces only.
        home: folder of all results; it can contain other files.
        device: of training and prediction.
        workers: processes; 0: one per core.
        executor: runs the trainings.
    """

    settings: StudySettings
    augmentation: AugmentationSettings
    training: TrainingSettings
    inference: InferenceSettings
    calibration: CalibrationSettings
    train: LabeledImageSet
    test: LabeledImageSet
    backgrounds: pathlib.Path | None
    home: pathlib.Path
    device: str = "auto"
    workers: int = 0
    executor: Executor = LOCAL

    def scheme_settings(self, cell: Cell) -> SchemeSettings:
        """Return the settings that make exactly ``cell.n_images`` images from the originals.

        Raises:
            SettingsError: the number of images is no multiple of the number of originals.
        """
        n_variants, rest = divmod(cell.n_images, len(self.train))
        if rest or not n_variants:
            raise SettingsError(f"{cell.n_images} images are no multiple of the {len(self.train)} originals")
        ours = self._augmentation_of(cell)
        if cell.scheme == "ours":
            left_out = (cell.left_out,) if cell.left_out else ()
            return dataclasses.replace(ours, n_variants=n_variants, left_out=left_out)
        kind = SCHEMES[cell.scheme]
        shared = {"n_variants": n_variants, "width": ours.width, "height": ours.height, "seed": ours.seed}
        if kind is CutoutSettings:
            return CutoutSettings(**shared, side=self.settings.cutout_side)
        if kind is MixupSettings:
            return MixupSettings(**shared, alpha=self.settings.mixup_alpha)
        assert issubclass(kind, ComparedSettings)
        return kind(**shared)

    def training_settings(self, cell: Cell) -> TrainingSettings:
        """Return the training settings: as many gradient steps as at the largest size, hence more epochs.

        Raises:
            SettingsError: no integer number of epochs has that many steps.
        """
        n_steps = self.n_steps(cell)
        epochs, rest = divmod(n_steps, self._steps_per_epoch(cell.n_images))
        if rest:
            raise SettingsError(
                f"{n_steps} steps are no integer number of epochs over {cell.n_images} images with batch_size "
                f"{self.training.batch_size}; choose sizes that are multiples of each other and of the batch"
            )
        training = dataclasses.replace(self.training, epochs=epochs)
        if training.schedule == "exponential":  # its decay is per epoch
            decay = training.epoch_decay ** (self._epochs(cell) / epochs)
            training = dataclasses.replace(training, epoch_decay=decay)
        return training

    def inference_settings(self, cell: Cell) -> InferenceSettings:
        """Return the resolution of inference, scaled with the width of the cell's training images."""
        scale = self._augmentation_of(cell).width / self.augmentation.width
        width, height = round(scale * self.inference.width), round(scale * self.inference.height)
        return dataclasses.replace(self.inference, width=width, height=height)

    def n_steps(self, cell: Cell) -> int:
        """Return the number of gradient steps of each member; the same in all cells of one recipe."""
        return self._epochs(cell) * self._steps_per_epoch(self.settings.sizes[-1])

    def find_set(self, cell: Cell) -> AugmentedSet | None:
        """Load the augmented set of the cell; None if it does not exist."""
        try:
            return AugmentedSet.load(self._set_folder(cell))
        except DataError:
            return None

    def find_members(self, cell: Cell) -> list[Member]:
        """Load the finished members of the cell, in the order of their seeds."""
        if (data := self.find_set(cell)) is None:
            return []
        found = [Member.find(job.folder, identity) for identity, job in self._jobs(cell, data).items()]
        return [member for member in found if member is not None]

    def find(self, cell: Cell) -> CalibrationReport | None:
        """Load the report of the cell, without computing anything; None if it is not finished."""
        members = self.find_members(cell)
        if len(members) < cell.n_members:
            return None
        try:
            return CalibrationReport.load(self.report_folder(cell))
        except DataError:
            return None

    def finished(self) -> dict[str, CalibrationReport]:
        """Load the reports of all finished cells, by name."""
        found = {cell.name: self.find(cell) for cell in self.settings.cells()}
        return {name: report for name, report in found.items() if report is not None}

    def steps_left(self, cell: Cell) -> int:
        """Return the number of gradient steps of the unfinished members; checkpoints are not considered."""
        return self.n_steps(cell) * (cell.n_members - len(self.find_members(cell)))

    def augmented_set(self, cell: Cell, progress: Progress = silent) -> AugmentedSet:
        """Load the augmented set of the cell, or make it."""
        settings, folder, workers = self.scheme_settings(cell), self._set_folder(cell), self.workers or 2
        return self.find_set(cell) or augment_images(
            self.train, folder, settings, self.backgrounds, workers=workers, progress=progress
        )

    def members(self, cell: Cell, on_step: OnStep | None = None, progress: Progress = silent) -> list[Member]:
        """Load the members of the cell, and train the unfinished ones; an interrupted training is resumed."""
        data = self.augmented_set(cell, progress)
        jobs = self._jobs(cell, data)
        train_members(
            [job for identity, job in jobs.items() if Member.find(job.folder, identity) is None],
            data.folder,
            self.training_settings(cell),
            device=self.device,
            workers=self.workers,
            on_step=on_step,
            executor=self.executor,
        )
        members = [Member.load(job.folder) for job in jobs.values()]
        assert {len(member.losses) for member in members} == {self.n_steps(cell)}
        return members

    def predictions(self, cell: Cell, members: Sequence[Member], progress: Progress = silent) -> "StackedPredictions":
        """Load the predictions of the members on all test images, and compute the missing ones."""
        inference = self.inference_settings(cell)
        return StackedPredictions([self._predictions_of(member, inference, progress) for member in members])

    def evaluate(self, cell: Cell, on_step: OnStep | None = None, progress: Progress = silent) -> CalibrationReport:
        """Load the report of the cell, or compute it with everything that it needs."""
        if (found := self.find(cell)) is not None:
            return found
        members = self.members(cell, on_step, progress)
        ids = [item.id for item in self.test.items]
        images = LabeledPredictions(ids, read_labels(self.test), self.predictions(cell, members, progress))
        report = evaluate(images, self.calibration, progress=progress)
        write_json(self.report_folder(cell) / "report.json", report)
        return report

    def report_folder(self, cell: Cell) -> pathlib.Path:
        """Return the folder of the report of a cell whose members are finished."""
        inference = self.inference_settings(cell)
        predictions = [self._prediction_key(member, inference) for member in self.find_members(cell)]
        return self._folder("reports", [predictions, self.calibration, FORMAT_VERSION])

    def _epochs(self, cell: Cell) -> int:
        comparison = 0 if cell.full else self.settings.comparison_epochs
        return comparison or self.training.epochs

    def _augmentation_of(self, cell: Cell) -> AugmentationSettings:
        width = 0 if cell.full else self.settings.comparison_width
        if not width:
            return self.augmentation
        height = round(width * self.augmentation.height / self.augmentation.width)
        return dataclasses.replace(self.augmentation, width=width, height=height)

    def _jobs(self, cell: Cell, data: AugmentedSet) -> dict[str, MemberJob]:
        """Return one job for each member, by the identity of its training."""
        training, jobs = self.training_settings(cell), {}
        for seed in range(self.settings.first_seed, self.settings.first_seed + cell.n_members):
            identity = training_identity(data, training, seed)
            folder = self.home / "ensemble_member" / identity[:16]
            jobs[identity] = MemberJob(f"{cell.name}/{seed}", seed, folder)
        return jobs

    def _steps_per_epoch(self, n_images: int) -> int:
        return max(1, n_images // self.training.batch_size)

    def _set_folder(self, cell: Cell) -> pathlib.Path:
        backgrounds = self._backgrounds_digest if cell.scheme == "ours" else ""
        settings, code = self.scheme_settings(cell), digest_of_code(augment_images)
        return self._folder("sets", [cell.scheme, settings, self.train.digest, backgrounds, code])

    def _folder(self, kind: str, key: object) -> pathlib.Path:
        return self.home / "study" / kind / digest_of(key)[:16]

    def _prediction_key(self, member: Member, inference: InferenceSettings) -> str:
        weights = member.record["weights_sha256"]
        return digest_of([weights, inference, self.test.digest, digest_of_code(Ensemble)])

    def _predictions_of(self, member: Member, inference: InferenceSettings, progress: Progress) -> MemberPredictions:
        folder = self.home / "study" / "predictions" / self._prediction_key(member, inference)[:16]
        if (folder / "index.json").is_file():
            return MemberPredictions(folder)
        ensemble = Ensemble([member.network()], inference, str(pick_device(self.device)))
        return predict_images(ensemble, self.test, folder, progress)

    @functools.cached_property
    def _backgrounds_digest(self) -> str:
        if self.backgrounds is None:
            return ""
        files = sorted(path for path in self.backgrounds.rglob("*") if path.is_file())
        return digest_of({path.relative_to(self.backgrounds).as_posix(): sha256_of_file(path) for path in files})


class StackedPredictions:
    """Predictions that are stored member by member, as a sequence of N arrays (M, H, W)."""

    def __init__(self, members: Sequence[MemberPredictions]) -> None:
        self.members = members

    def __len__(self) -> int:
        return len(self.members[0])

    def __getitem__(self, index: int) -> NDArray[np.float32]:
        return np.concatenate([member[index] for member in self.members])
