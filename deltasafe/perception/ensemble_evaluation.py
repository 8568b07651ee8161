"""From trained members and labelled images to a report on disk, and from there to the frozen ensemble."""

import dataclasses
import pathlib

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.artifact import freeze_ensemble
from deltasafe.perception.calibration_report import CalibrationReport, CalibrationSettings
from deltasafe.perception.calibration_writing import write_calibration_report
from deltasafe.perception.ensemble import Ensemble
from deltasafe.perception.evaluation import calibrate
from deltasafe.perception.hands import HandSet
from deltasafe.perception.member import Member
from deltasafe.perception.predictions import MemberPredictions
from deltasafe.perception.settings import InferenceSettings
from deltasafe.perception.training import pick_device
from deltasafe.progress import Progress, silent
from deltasafe.storage import read_json, write_json

__all__ = ["evaluate_members", "freeze_evaluated"]


def evaluate_members(
    members: list[Member],
    test: HandSet,
    folder: pathlib.Path,
    *,
    inference: InferenceSettings,
    settings: CalibrationSettings,
    planning_delta: float,
    device: str = "auto",
    progress: Progress = silent,
) -> CalibrationReport:
    """Predict ``test`` once with every member, judge members and ensembles of growing size, write the report.

    Args:
        folder: gets the report; what every member thinks of every image lies beside it in ``FOLDER-predictions``.
        inference: resolution; kept in the folder, so that the ensemble is frozen as it was judged.
        planning_delta: hand with p_occupied up to it is shown as what a planner would drive through.

    Raises:
        SettingsError: the members do not belong together.
    """
    if len({member.ensemble_identity for member in members}) > 1:
        raise SettingsError(
            "the members were trained on different data or with different settings; train all of them again"
        )
    ensemble = Ensemble([member.network() for member in members], inference, str(pick_device(device)))
    position = {item.id: index for index, item in enumerate(test.items)}
    images, labels = zip(*(test.read(index) for index in range(len(test))), strict=True)
    predictions = MemberPredictions.write(
        folder.with_name(f"{folder.name}-predictions"),
        list(position),
        lambda image_id: ensemble.member_p_occupied(images[position[image_id]]),
        progress,
    )
    masks = [label.astype(bool) for label in labels]
    report = calibrate(list(position), masks, predictions, settings, progress)
    write_calibration_report(
        folder,
        report,
        labels=masks,
        predictions=predictions,
        load_image=lambda image_id: images[position[image_id]],
        planning_delta=planning_delta,
    )
    write_json(
        folder / "judged.json",
        {
            "members": [member.record["weights_sha256"] for member in members],
            "inference": dataclasses.asdict(inference),
            "test_digest": test.digest,
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
        {"test_images": judged["test_digest"]},
    )
