"""From trained members and labeled images to a report on disk, and from there to the frozen ensemble."""

import dataclasses
import pathlib

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import read_json, write_json
from deltasafe.perception.artifact.frozen_ensemble import freeze_ensemble
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

__all__ = ["evaluate_members", "freeze_evaluated"]


def evaluate_members(
    members: list[Member],
    test: LabeledImageSet,
    folder: pathlib.Path,
    *,
    inference: InferenceSettings,
    settings: CalibrationSettings,
    planning_delta: float,
    device: str = "auto",
    progress: Progress = silent,
    calibration: LabeledImageSet | None = None,
) -> CalibrationReport:
    """Predict ``test`` once with every member, judge members and ensembles of growing size, write the report.

    Args:
        test: labeled images that no training has seen.
        folder: gets the report; what every member thinks of every image lies beside it in ``FOLDER-predictions``.
        inference: resolution; kept in the folder, so that the ensemble is frozen as it was judged.
        planning_delta: hand with p_occupied up to it is shown as what a planner would drive through.
        calibration: further labeled images, to fit temperature, delta and threshold on (their predictions lie in
            ``FOLDER-calibration-predictions``); without them the test images are cross-fitted.

    Raises:
        SettingsError: the members do not belong together.
        DataError: an image is in both sets.
    """
    if len({member.ensemble_identity for member in members}) > 1:
        raise SettingsError(
            "the members were trained on different data or with different settings; train all of them again"
        )
    if calibration is not None:
        try:
            check_disjoint(calibration, test)
        except DataError as error:
            raise DataError(error.path, "is a calibration image as well; remove it from one of the two sets") from error
    ensemble = Ensemble([member.network() for member in members], inference, str(pick_device(device)))
    judged = _predicted(ensemble, test, folder.with_name(f"{folder.name}-predictions"), progress)
    fitted = None
    if calibration is not None:
        destination = folder.with_name(f"{folder.name}-calibration-predictions")
        fitted = _predicted(ensemble, calibration, destination, progress)
    report = evaluate(judged.image_ids, judged.labels, judged.predictions, settings, progress, fitted)
    position = {item.id: index for index, item in enumerate(test.items)}
    write_calibration_report(
        folder,
        report,
        labels=judged.labels,
        predictions=judged.predictions,
        load_image=lambda image_id: test.read(position[image_id])[0],
        planning_delta=planning_delta,
    )
    write_json(
        folder / "judged.json",
        {
            "members": [member.record["weights_sha256"] for member in members],
            "inference": dataclasses.asdict(inference),
            "test_digest": test.digest,
            **({} if calibration is None else {"calibration_digest": calibration.digest}),
        },
    )
    return report


def freeze_evaluated(
    members: list[Member], report_folder: pathlib.Path, golden_rgb: NDArray[np.uint8], parent: pathlib.Path
) -> pathlib.Path:
    """Freeze ``members`` exactly as they were judged in ``report_folder``.

    Raises:
        DataError: the folder holds no report.
        SettingsError: the report is of other members; make it again.
    """
    judged = read_json(report_folder / "judged.json")
    if judged["members"] != [member.record["weights_sha256"] for member in members]:
        raise SettingsError(
            f"{report_folder} judged other members than those to be frozen; make the calibration report again"
        )
    return freeze_ensemble(
        members,
        InferenceSettings(**judged["inference"]),
        CalibrationReport.load(report_folder).calibration,
        golden_rgb,
        parent,
        {
            "test_images": judged["test_digest"],
            **({"calibration_images": judged["calibration_digest"]} if "calibration_digest" in judged else {}),
        },
    )


def _predicted(
    ensemble: Ensemble, hands: LabeledImageSet, folder: pathlib.Path, progress: Progress
) -> LabeledPredictions:
    position = {item.id: index for index, item in enumerate(hands.items)}
    predictions = MemberPredictions.write(
        folder,
        list(position),
        lambda image_id: ensemble.member_p_occupied(hands.read(position[image_id])[0]),
        progress,
    )
    labels = [hands.read(index)[1].astype(bool) for index in range(len(hands))]
    return LabeledPredictions(list(position), labels, predictions)
