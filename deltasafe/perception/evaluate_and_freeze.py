"""Evaluate trained members on labeled images, and freeze them with the settings they were evaluated with."""

import dataclasses
import pathlib
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import read_json, write_json
from deltasafe.perception.artifact.frozen_ensemble import write_frozen_ensemble
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings
from deltasafe.perception.calibration.write_report import write_calibration_report
from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.inference.predictions import MemberPredictions
from deltasafe.perception.settings import InferenceSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.train_member import pick_device

__all__ = ["EvaluationSettings", "evaluate_ensemble", "freeze_ensemble"]

_RECORD = "judged.json"


@dataclasses.dataclass(frozen=True)
class EvaluationSettings:
    """How an ensemble is evaluated.

    Attributes:
        inference: resolution of the networks' input; stored with the frozen ensemble.
        calibration: intervals, folds, and what is fitted.
    """

    inference: InferenceSettings = dataclasses.field(default_factory=InferenceSettings)
    calibration: CalibrationSettings = dataclasses.field(default_factory=CalibrationSettings)


def evaluate_ensemble(
    members: Sequence[Member],
    test: LabeledImageSet,
    folder: str | pathlib.Path,
    settings: EvaluationSettings | None = None,
    calibration_images: LabeledImageSet | None = None,
    *,
    device: str = "auto",
    progress: Progress = silent,
) -> CalibrationReport:
    """Evaluate members and ensembles of growing size on labeled images, and write the calibration report.

    Args:
        members: of one ensemble.
        test: labeled images that were not used for training. Each is predicted once with every member.
        folder: destination of the report. The predictions are stored beside it in ``FOLDER-predictions``.
        settings: of inference and calibration.
        calibration_images: further labeled images to fit temperature, delta and threshold on (their predictions are
            stored in ``FOLDER-calibration-predictions``). Without them, the test images are cross-fitted.
        device: ``cpu``, ``cuda`` or ``auto``.

    Raises:
        SettingsError: the members were trained with different settings or data.
        DataError: an image is in both sets.
    """
    folder, settings = pathlib.Path(folder), settings or EvaluationSettings()
    if len({member.ensemble_identity for member in members}) > 1:
        raise SettingsError("the members were trained with different settings or data; train all of them again")
    if calibration_images is not None:
        try:
            check_disjoint(calibration_images, test)
        except DataError as error:
            raise DataError(error.path, "is a calibration image as well; remove it from one of the two sets") from error
    ensemble = Ensemble([member.network() for member in members], settings.inference, str(pick_device(device)))
    predictions = _predict(ensemble, test, folder.with_name(f"{folder.name}-predictions"), progress)
    calibration = None
    if calibration_images is not None:
        destination = folder.with_name(f"{folder.name}-calibration-predictions")
        calibration = _predict(ensemble, calibration_images, destination, progress)
    report = evaluate(predictions, settings.calibration, calibration, progress)
    position = _positions(test)
    write_calibration_report(folder, report, predictions, lambda image_id: test.read(position[image_id])[0])
    record = {
        "members": _weights(members),
        "inference": dataclasses.asdict(settings.inference),
        "test_digest": test.digest,
    }
    if calibration_images is not None:
        record["calibration_digest"] = calibration_images.digest
    write_json(folder / _RECORD, record)
    return report


def freeze_ensemble(
    members: Sequence[Member],
    report_folder: str | pathlib.Path,
    golden_rgb: NDArray[np.uint8],
    parent: str | pathlib.Path,
) -> pathlib.Path:
    """Freeze members with the settings and the calibration that they were evaluated with.

    Args:
        members: those that were evaluated.
        report_folder: folder of `evaluate_ensemble`.
        golden_rgb: (H, W, 3) uint8; its prediction is stored, so that users can compare theirs.
        parent: folder that the artifact ``ensemble-DIGEST`` is written into.

    Returns:
        folder of the artifact.

    Raises:
        DataError: the folder holds no report.
        SettingsError: the report is about other members.
    """
    report_folder = pathlib.Path(report_folder)
    record = read_json(report_folder / _RECORD)
    if record["members"] != _weights(members):
        raise SettingsError(f"{report_folder} is about other members; evaluate these members, then freeze them")
    data = {"test_images": record["test_digest"]}
    if "calibration_digest" in record:
        data["calibration_images"] = record["calibration_digest"]
    calibration = CalibrationReport.load(report_folder).calibration
    inference = InferenceSettings(**record["inference"])
    return write_frozen_ensemble(list(members), inference, calibration, golden_rgb, pathlib.Path(parent), data)


def _predict(
    ensemble: Ensemble, images: LabeledImageSet, folder: pathlib.Path, progress: Progress
) -> LabeledPredictions:
    position = _positions(images)
    predictions = MemberPredictions.write(
        folder,
        list(position),
        lambda image_id: ensemble.member_p_occupied(images.read(position[image_id])[0]),
        progress,
    )
    labels = [images.read(index)[1].astype(bool) for index in range(len(images))]
    return LabeledPredictions(list(position), labels, predictions)


def _positions(images: LabeledImageSet) -> dict[str, int]:
    return {item.id: index for index, item in enumerate(images.items)}


def _weights(members: Sequence[Member]) -> list[str]:
    return [member.record["weights_sha256"] for member in members]
