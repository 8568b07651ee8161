"""One cell after another: augmented set -> members -> predictions -> scores; what is finished is found, not remade."""

import dataclasses
import functools
import pathlib
from collections.abc import Callable, Sequence
from typing import overload

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.code_digest import digest_of_code
from deltasafe.compute.executor import LOCAL, Executor
from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import digest_of, sha256_of_file, write_json
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.report import FORMAT_VERSION, CalibrationReport, CalibrationSettings
from deltasafe.perception.data.augmentation import AugmentationSettings
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes import SCHEMES, ComparedSettings, CutoutSettings, MixupSettings, SchemeSettings
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.inference.predictions import MemberPredictions
from deltasafe.perception.settings import InferenceSettings, TrainingSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_ensemble import MemberJob, train_members
from deltasafe.perception.training.train_member import StepReport, pick_device, training_identity
from deltasafe.studies.perception.settings import Cell, StudySettings
from deltasafe.studies.perception.store import StudyStore

__all__ = ["Study"]


@dataclasses.dataclass(frozen=True)
class Study:
    """The studies of section V-A on a training and a test set.

    Attributes:
        settings: which cells there are.
        augmentation: of our scheme; its ``n_variants`` and ``left_out`` are the cells'. The compared schemes share
            its size and seed.
        training: of a cell of the largest size; smaller ones get more epochs, so that all take as many steps. Width of
            the images and epochs are ``settings``' own for comparisons that have a lighter recipe.
        inference: resolution at which ensembles look; in proportion smaller where comparisons have smaller images.
        calibration: bootstrap of the intervals.
        train: the originals.
        test: the images that every cell is judged on.
        backgrounds: folder of pictures without hands, for our scheme; None uses procedural surfaces alone.
        store: where everything is kept.
        device: of training and prediction.
        workers: processes; 0 is one a core.
    """

    settings: StudySettings
    augmentation: AugmentationSettings
    training: TrainingSettings
    inference: InferenceSettings
    calibration: CalibrationSettings
    train: LabeledImageSet
    test: LabeledImageSet
    backgrounds: pathlib.Path | None
    store: StudyStore
    device: str = "auto"
    workers: int = 0
    executor: Executor = LOCAL

    def scheme_settings(self, cell: Cell) -> SchemeSettings:
        """What makes exactly ``cell.n_images`` images of the originals.

        Raises:
            SettingsError: the number is no multiple of the number of originals.
        """
        n_variants, rest = divmod(cell.n_images, len(self.train))
        if rest or not n_variants:
            raise SettingsError(f"{cell.n_images} images are no multiple of the {len(self.train)} originals")
        ours = self._lightened(cell)
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
        """The training of ``cell``: as many gradient steps as at the largest size, hence more epochs.

        Raises:
            SettingsError: no whole number of epochs has that many steps.
        """
        n_steps = self.n_steps(cell)
        epochs, rest = divmod(n_steps, self._steps_per_epoch(cell.n_images))
        if rest:
            raise SettingsError(
                f"{n_steps} steps are no whole number of epochs over {cell.n_images} images with batch_size "
                f"{self.training.batch_size}; choose sizes that are multiples of each other and of the batch"
            )
        training = dataclasses.replace(self.training, epochs=epochs)
        if training.schedule == "exponential":  # which counts in epochs
            decay = training.epoch_decay ** (self._epochs(cell) / epochs)
            training = dataclasses.replace(training, epoch_decay=decay)
        return training

    def inference_settings(self, cell: Cell) -> InferenceSettings:
        """The resolution at which the ensemble of ``cell`` looks: to its training images as the preset's to its own."""
        scale = self._lightened(cell).width / self.augmentation.width
        return InferenceSettings(round(scale * self.inference.width), round(scale * self.inference.height))

    def n_steps(self, cell: Cell) -> int:
        """Gradient steps of every member of ``cell``; the same in all cells of one recipe."""
        return self._epochs(cell) * self._steps_per_epoch(self.settings.sizes[-1])

    def find_set(self, cell: Cell) -> AugmentedSet | None:
        """The augmented set of ``cell``, if it was made."""
        try:
            return AugmentedSet.load(self._set_folder(cell))
        except DataError:
            return None

    def find_members(self, cell: Cell) -> list[Member]:
        """The members of ``cell`` that are finished, in the order of their seeds."""
        if (data := self.find_set(cell)) is None:
            return []
        identities = [training_identity(data, self.training_settings(cell), seed) for seed in self._seeds(cell)]
        found = [Member.find(self.store.member(identity), identity) for identity in identities]
        return [member for member in found if member is not None]

    def find(self, cell: Cell) -> CalibrationReport | None:
        """The scores of ``cell``, if they are finished; nothing is computed."""
        members = self.find_members(cell)
        if len(members) < cell.n_members:
            return None
        try:
            return CalibrationReport.load(self.report_folder(cell))
        except DataError:
            return None

    def finished(self) -> dict[str, CalibrationReport]:
        """The scores of all finished cells, by name."""
        found = {cell.name: self.find(cell) for cell in self.settings.cells()}
        return {name: report for name, report in found.items() if report is not None}

    def steps_left(self, cell: Cell) -> int:
        """Gradient steps of the members of ``cell`` that are not finished (checkpoints not counted)."""
        return self.n_steps(cell) * (cell.n_members - len(self.find_members(cell)))

    def augmented_set(self, cell: Cell, progress: Progress = silent) -> AugmentedSet:
        """The augmented set of ``cell``, made where there is none."""
        found = self.find_set(cell)
        settings, folder = self.scheme_settings(cell), self._set_folder(cell)
        return found or augment_images(
            self.train, folder, settings, self.backgrounds, workers=self.workers or 2, progress=progress
        )

    def members(
        self, cell: Cell, on_step: Callable[[str, StepReport], None] | None = None, progress: Progress = silent
    ) -> list[Member]:
        """The members of ``cell``, trained where they are not finished; a killed training is continued."""
        data, training = self.augmented_set(cell, progress), self.training_settings(cell)
        identities = {seed: training_identity(data, training, seed) for seed in self._seeds(cell)}
        jobs = [
            MemberJob(f"{cell.name}/{seed}", seed, self.store.member(identity)) for seed, identity in identities.items()
        ]
        missing = [job for job in jobs if Member.find(job.folder, identities[job.seed]) is None]
        train_members(
            missing,
            data.folder,
            training,
            device=self.device,
            workers=self.workers,
            on_step=on_step,
            executor=self.executor,
        )
        members = [Member.load(job.folder) for job in jobs]
        assert {len(member.losses) for member in members} == {self.n_steps(cell)}
        return members

    def predictions(self, cell: Cell, members: Sequence[Member], progress: Progress = silent) -> "Stacked":
        """What ``members`` of ``cell`` think of every test image; each is asked once, ever."""
        inference = self.inference_settings(cell)
        return Stacked([self._predictions_of(member, inference, progress) for member in members])

    def judge(
        self, cell: Cell, on_step: Callable[[str, StepReport], None] | None = None, progress: Progress = silent
    ) -> CalibrationReport:
        """The scores of ``cell``; whatever is missing on the way to them is made."""
        if (found := self.find(cell)) is not None:
            return found
        members = self.members(cell, on_step, progress)
        ids = [item.id for item in self.test.items]
        report = evaluate(ids, self._labels, self.predictions(cell, members, progress), self.calibration, progress)
        write_json(self.report_folder(cell) / "report.json", report)
        return report

    def _epochs(self, cell: Cell) -> int:
        lighter = 0 if cell.full else self.settings.comparison_epochs
        return lighter or self.training.epochs

    def _lightened(self, cell: Cell) -> AugmentationSettings:
        width = 0 if cell.full else self.settings.comparison_width
        if not width:
            return self.augmentation
        height = round(width * self.augmentation.height / self.augmentation.width)
        return dataclasses.replace(self.augmentation, width=width, height=height)

    def _seeds(self, cell: Cell) -> range:
        return range(self.settings.first_seed, self.settings.first_seed + cell.n_members)

    def _steps_per_epoch(self, n_images: int) -> int:
        return max(1, n_images // self.training.batch_size)

    def _set_folder(self, cell: Cell) -> pathlib.Path:
        backgrounds = self._backgrounds_digest if cell.scheme == "ours" else ""
        key = [
            cell.scheme,
            self.scheme_settings(cell),
            self.train.digest,
            backgrounds,
            digest_of_code(augment_images),
        ]
        return self.store.augmented_set(digest_of(key))

    def report_folder(self, cell: Cell) -> pathlib.Path:
        """Where `judge` keeps the report of ``cell``, whose members are finished."""
        inference = self.inference_settings(cell)
        asked = [self._prediction_key(member, inference) for member in self.find_members(cell)]
        key = [asked, self.calibration, FORMAT_VERSION]
        return self.store.report(digest_of(key))

    def _prediction_key(self, member: Member, inference: InferenceSettings) -> str:
        weights = member.record["weights_sha256"]
        return digest_of([weights, inference, self.test.digest, digest_of_code(Ensemble)])

    def _predictions_of(self, member: Member, inference: InferenceSettings, progress: Progress) -> MemberPredictions:
        folder = self.store.predictions(self._prediction_key(member, inference))
        if (folder / "index.json").is_file():
            return MemberPredictions(folder)
        ensemble = Ensemble([member.network()], inference, str(pick_device(self.device)))
        position = {item.id: index for index, item in enumerate(self.test.items)}
        return MemberPredictions.write(
            folder,
            list(position),
            lambda image_id: ensemble.member_p_occupied(self.test.read(position[image_id])[0]),
            progress,
        )

    @functools.cached_property
    def _labels(self) -> list[NDArray[np.bool_]]:
        return [self.test.read(index)[1].astype(bool) for index in range(len(self.test))]

    @functools.cached_property
    def _backgrounds_digest(self) -> str:
        if self.backgrounds is None:
            return ""
        files = sorted(path for path in self.backgrounds.rglob("*") if path.is_file())
        return digest_of({path.relative_to(self.backgrounds).as_posix(): sha256_of_file(path) for path in files})


class Stacked(Sequence[NDArray[np.float32]]):
    """Predictions of members that are stored one by one, as one sequence of (M, H, W) arrays."""

    def __init__(self, members: Sequence[MemberPredictions]) -> None:
        self.members = members

    def __len__(self) -> int:
        return len(self.members[0])

    @overload
    def __getitem__(self, index: int) -> NDArray[np.float32]: ...
    @overload
    def __getitem__(self, index: slice) -> list[NDArray[np.float32]]: ...
    def __getitem__(self, index: int | slice) -> NDArray[np.float32] | list[NDArray[np.float32]]:
        if isinstance(index, slice):
            return [self[i] for i in range(*index.indices(len(self)))]
        return np.concatenate([member[index] for member in self.members])
