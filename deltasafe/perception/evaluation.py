"""From the members' predictions on labelled images to a calibration report.

Images are visited one after another; every figure is computed from sums per image, so that memory does not
grow with their number, and intervals come from drawing images.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration import DeltaSupport, delta_support, smallest_supported_delta
from deltasafe.perception.calibration_report import (
    CalibrationReport,
    CalibrationSettings,
    Predictor,
    RecalibrationResult,
)
from deltasafe.perception.metrics import (
    ImageScores,
    bootstrap_scores,
    mean_and_sd,
    percentile_interval,
    pool_scores,
    require_label,
    require_p_occupied,
    score_image,
)
from deltasafe.perception.recalibration import (
    LogitCounts,
    apply_temperature,
    cross_fitted_temperatures,
    fit_temperature,
    logit_counts,
    stack_logit_counts,
)
from deltasafe.perception.reliability import (
    BinCounts,
    bootstrap_weights,
    confidence_counts,
    curve,
    expected_calibration_error,
    safety_counts,
    stack_counts,
)
from deltasafe.progress import Progress, silent

__all__ = ["calibrate"]


def calibrate(
    image_ids: Sequence[str],
    labels: Sequence[NDArray[np.generic]],
    predictions: Sequence[NDArray[np.floating]],
    settings: CalibrationSettings | None = None,
    progress: Progress = silent,
) -> CalibrationReport:
    """Judge an ensemble and its members on labelled images.

    Args:
        image_ids: N unique names.
        labels: N masks (H, W), bool or 0/255; sizes may differ between images.
        predictions: N arrays (M, H, W) of the members' p_occupied; read one at a time (`MemberPredictions`).

    Raises:
        SettingsError: nothing to judge on, numbers that do not match, or values that are no masks or
            probabilities.
    """
    settings = settings or CalibrationSettings()
    n_images = len(image_ids)
    if not n_images == len(labels) == len(predictions) or n_images == 0:
        raise SettingsError(
            f"one label and one prediction an image are needed, got {n_images} ids, {len(labels)} labels, "
            f"{len(predictions)} predictions"
        )
    if len(set(image_ids)) != n_images:
        raise SettingsError("image_ids must be unique")
    if 1 < n_images < settings.n_folds:
        raise SettingsError(f"n_folds is {settings.n_folds}, but there are {n_images} images")
    passes = 2 if n_images > 1 else 1
    members: list[_Tally] = []
    ensembles: list[_Tally] = []
    safety, logits = [], []
    for index, image_id in enumerate(image_ids):
        label, stack = _checked(image_id, labels[index], predictions[index], len(members))
        members = members or [_Tally() for _ in stack]
        ensembles = ensembles or [_Tally() for _ in stack]
        total = np.zeros(label.shape)
        for m, p_member in enumerate(stack):
            total += p_member
            p_mean = total / (m + 1)
            members[m].add(p_member, label)
            ensembles[m].add(p_mean, label)
        safety.append(safety_counts(p_mean, label))
        logits.append(logit_counts(p_mean, label))
        progress(index + 1, passes * n_images, f"judged {image_id}")

    weights = bootstrap_weights(n_images, settings.n_bootstrap, settings.seed)
    safety_all = stack_counts(safety)
    member_results = tuple(member.result(weights, settings.level) for member in members)
    recalibration = None
    if n_images > 1:
        recalibration = _recalibrated(labels, predictions, stack_logit_counts(logits), weights, settings, progress)
    return CalibrationReport(
        settings=settings,
        image_ids=tuple(image_ids),
        members=member_results,
        member_mean=mean_and_sd([member.scores for member in member_results]),
        ensembles=tuple(ensemble.result(weights, settings.level) for ensemble in ensembles),
        safety=curve(safety_all, weights, settings.level),
        support=_support(safety_all, settings),
        recalibration=recalibration,
    )


@dataclasses.dataclass
class _Tally:
    """Sums of one predictor, image by image."""

    scores: list[ImageScores] = dataclasses.field(default_factory=list)
    confidence: list[BinCounts] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.floating], label: NDArray[np.bool_]) -> None:
        self.scores.append(score_image(p_occupied, label))
        self.confidence.append(confidence_counts(p_occupied, label))

    def result(self, weights: NDArray[np.int64], level: float) -> Predictor:
        counts = stack_counts(self.confidence)
        low, high = percentile_interval(bootstrap_scores(self.scores, weights), level)
        return Predictor(
            images=tuple(self.scores),
            scores=pool_scores(self.scores),
            low=low,
            high=high,
            expected_calibration_error=expected_calibration_error(counts),
            reliability=curve(counts, weights, level),
        )


def _checked(
    image_id: str, label: NDArray[np.generic], stack: NDArray[np.floating], n_members: int
) -> tuple[NDArray[np.bool_], NDArray[np.floating]]:
    try:
        occupied = require_label(label)
        if np.ndim(stack) != 3 or len(stack) == 0 or n_members not in (0, len(stack)):
            raise SettingsError(
                f"predictions must have shape (M, H, W), M the same in all images, got {np.shape(stack)}"
            )
        require_p_occupied(stack[0], occupied.shape)
        require_p_occupied(stack)
    except SettingsError as error:
        raise SettingsError(f"{image_id}: {error}") from error
    return occupied, stack


def _recalibrated(
    labels: Sequence[NDArray[np.generic]],
    predictions: Sequence[NDArray[np.floating]],
    counts: LogitCounts,
    weights: NDArray[np.int64],
    settings: CalibrationSettings,
    progress: Progress,
) -> RecalibrationResult:
    unseen = cross_fitted_temperatures(counts, settings.n_folds or None)
    n_images = len(unseen)
    tally, safety = _Tally(), []
    for index, temperature in enumerate(unseen.tolist()):
        occupied = require_label(labels[index])
        p_mean = np.asarray(predictions[index], dtype=np.float64).mean(axis=0)
        p_occupied = apply_temperature(p_mean, temperature)
        tally.add(p_occupied, occupied)
        safety.append(safety_counts(p_occupied, occupied))
        progress(n_images + index + 1, 2 * n_images, f"recalibrated image {index + 1} of {n_images}")
    result = tally.result(weights, settings.level)
    return RecalibrationResult(
        temperature=fit_temperature(counts),
        lowest=float(unseen.min()),
        highest=float(unseen.max()),
        scores=result.scores,
        expected_calibration_error=result.expected_calibration_error,
        smallest_supported_delta=smallest_supported_delta(_support(stack_counts(safety), settings)),
    )


def _support(counts: BinCounts, settings: CalibrationSettings) -> tuple[DeltaSupport, ...]:
    return delta_support(counts, n_bootstrap=settings.n_bootstrap, level=settings.level, seed=settings.seed)
