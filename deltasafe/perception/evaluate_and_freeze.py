"""Evaluate trained members on labeled images, and freeze them with the settings they were evaluated with."""

import dataclasses
import pathlib
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json, write_json
from deltasafe.perception.artifact.frozen_ensemble import write_frozen_ensemble
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings
from deltasafe.perception.calibration.write_report import write_calibration_report
from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint, check_distinct
from deltasafe.perception.inference.ensemble import Ensemble
from deltasafe.perception.inference.predictions import MemberPredictions
from deltasafe.perception.settings import EVALUATION_PIXELS, InferenceSettings
from deltasafe.perception.training.device import pick_device
from deltasafe.perception.training.member import Member

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

    Images of more than ``EVALUATION_PIXELS`` pixels are scaled down with their masks. One image at a time is in memory.

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
        DataError: an image is in both sets, or twice in one of them.
    """
    folder, settings = pathlib.Path(folder), settings or EvaluationSettings()
    if len({member.ensemble_identity for member in members}) > 1:
        raise SettingsError("the members were trained with different settings or data; train all of them again")
    check_distinct(test, "test")
    if calibration_images is not None:
        check_distinct(calibration_images, "calibration")
        check_disjoint(calibration_images, test, "calibration")
    ensemble = Ensemble([member.network() for member in members], settings.inference, str(pick_device(device)))
    evaluated = _labeled_predictions(ensemble, test, folder.with_name(f"{folder.name}-predictions"), progress)
    calibration = None
    if calibration_images is not None:
        destination = folder.with_name(f"{folder.name}-calibration-predictions")
        calibration = _labeled_predictions(ensemble, calibration_images, destination, progress)
    report = evaluate(evaluated, settings.calibration, calibration, progress, test.info)
    write_calibration_report(folder, report, evaluated, _image_loader(test))
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
    report = CalibrationReport.load(report_folder)
    inference = from_json(InferenceSettings, record["inference"])
    parent = pathlib.Path(parent)
    return write_frozen_ensemble(list(members), inference, report.calibration, golden_rgb, parent, data, report.info)


def predict_images(
    ensemble: Ensemble, images: LabeledImageSet, folder: str | pathlib.Path, progress: Progress = silent
) -> MemberPredictions:
    """Predict every image once with all members, at the size of `read_labels`, and store the predictions."""
    load = _image_loader(images)
    ids = [item.id for item in images.items]
    return MemberPredictions.write(folder, ids, lambda image_id: ensemble.member_p_occupied(load(image_id)), progress)


def read_labels(images: LabeledImageSet) -> list[NDArray[np.bool_]]:
    """Read the (H, W) labels of all images, at a size of at most ``EVALUATION_PIXELS`` pixels."""
    return [images.read(index, EVALUATION_PIXELS)[1].astype(bool) for index in range(len(images))]


def _labeled_predictions(
    ensemble: Ensemble, images: LabeledImageSet, folder: pathlib.Path, progress: Progress
) -> LabeledPredictions:
    predictions = predict_images(ensemble, images, folder, progress)
    return LabeledPredictions(predictions.image_ids, read_labels(images), predictions)


def _image_loader(images: LabeledImageSet) -> Callable[[str], NDArray[np.uint8]]:
    position = {item.id: index for index, item in enumerate(images.items)}
    return lambda image_id: images.read(position[image_id], EVALUATION_PIXELS)[0]


def _weights(members: Sequence[Member]) -> list[str]:
    return [member.record["weights_sha256"] for member in members]
