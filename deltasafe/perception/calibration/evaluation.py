"""From the members' predictions on labeled images to a calibration report.

Images are visited one after another; every figure is computed from sums per image, so that memory does not
grow with their pixels, and intervals come from drawing images.

What is fitted (temperature, smallest supported delta, conformal threshold) is judged on images that the fit has not
seen: on the test images if there are calibration images beside them, otherwise fold by fold (cross-fitting).
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.accumulators import FitTally, Tally, WholeTally
from deltasafe.perception.calibration.conformal_risk import RiskControl, control_risk
from deltasafe.perception.calibration.delta_support import HeldOutDelta, delta_support, held_out_support
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.metrics import mean_and_sd
from deltasafe.perception.calibration.reliability import (
    BinCounts,
    bootstrap_weights,
    curve,
    safety_counts,
    stack_counts,
)
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, EvaluationResult
from deltasafe.perception.calibration.temperature import (
    apply_temperature,
    cross_fitted_temperatures,
    fit_temperature,
    folds_of,
    stack_logit_counts,
)

__all__ = ["evaluate"]

_ALPHAS = (0.02, 0.03, 0.05, 0.1)


def evaluate(
    image_ids: Sequence[str],
    labels: Sequence[NDArray[np.generic]],
    predictions: Sequence[NDArray[np.floating]],
    settings: CalibrationSettings | None = None,
    progress: Progress = silent,
    calibration: LabeledPredictions | None = None,
) -> CalibrationReport:
    """Judge an ensemble and its members on labeled images.

    Args:
        image_ids, labels, predictions: of the images to judge on, see `LabeledPredictions`.
        calibration: further images of the same members, to fit temperature, delta and threshold on; without them
            each fold of the images is judged by fits on the others.

    Raises:
        SettingsError: nothing to judge on, numbers that do not match, or values that are no masks or
            probabilities.
    """
    settings = settings or CalibrationSettings()
    judged = LabeledPredictions(image_ids, labels, predictions)
    n_images, n_fitted = len(judged), len(calibration or judged)
    if 1 < n_fitted < settings.n_folds:
        raise SettingsError(f"n_folds is {settings.n_folds}, but there are {n_fitted} images")
    n_steps = 2 * n_images + (0 if calibration is None else 2 * n_fitted)
    members: list[Tally] = []
    ensembles: list[Tally] = []
    whole, fit = WholeTally(), FitTally()
    for index, (label, stack) in enumerate(judged.checked()):
        members = members or [Tally() for _ in stack]
        ensembles = ensembles or [Tally() for _ in stack]
        total = np.zeros(label.shape)
        for m, p_member in enumerate(stack):
            total += p_member
            members[m].add(p_member, label)
            if m + 1 < len(stack):
                ensembles[m].add(total / (m + 1), label)
        whole.add(total / len(stack), label)
        fit.add(total / len(stack), label)
        progress(index + 1, n_steps, f"judged {image_ids[index]}")
    ensembles[-1] = whole.tally

    weights = bootstrap_weights(n_images, settings.n_bootstrap, settings.seed)
    judge = _Judge(judged, calibration, weights, settings)
    test_shares = fit.missed_shares
    if calibration is not None:
        fit = FitTally()
        for index, _ in enumerate(calibration.checked(len(members))):
            label, p_mean = calibration.pooled(index)
            fit.add(p_mean, label)
            progress(n_images + index + 1, n_steps, f"calibrated on {calibration.image_ids[index]}")
    as_it_is = judge.judgment(whole, 1.0, np.ones(n_images), stack_counts(fit.safety))
    recalibrated = None
    if n_fitted > 1:
        logits = stack_logit_counts(fit.logits)
        temperature = fit_temperature(logits)
        unseen = cross_fitted_temperatures(logits, settings.n_folds or None)
        applied = unseen if calibration is None else np.full(n_images, temperature)
        again = WholeTally()
        for index in range(n_images):
            label, p_mean = judged.pooled(index)
            again.add(apply_temperature(p_mean, applied[index]), label)
            progress(n_steps - n_images + index + 1, n_steps, f"recalibrated {image_ids[index]}")
        safety = stack_counts(again.safety if calibration is None else _safety(calibration, unseen))
        recalibrated = judge.judgment(again, temperature, applied, safety)
    used = recalibrated.temperature if settings.recalibrate and recalibrated is not None else 1.0
    member_results = tuple(member.result(weights, settings.level) for member in members)
    return CalibrationReport(
        settings=settings,
        image_ids=tuple(image_ids),
        calibration_image_ids=() if calibration is None else tuple(calibration.image_ids),
        members=member_results,
        member_mean=mean_and_sd([member.scores for member in member_results]),
        ensembles=tuple(ensemble.result(weights, settings.level) for ensemble in ensembles),
        as_it_is=as_it_is,
        recalibrated=recalibrated,
        risk=_risk(fit.missed_shares, None if calibration is None else test_shares, used, settings),
    )


@dataclasses.dataclass(frozen=True)
class _Judge:
    judged: LabeledPredictions
    calibration: LabeledPredictions | None
    weights: NDArray[np.int64]
    settings: CalibrationSettings

    def judgment(
        self, whole: WholeTally, temperature: float, applied: NDArray[np.float64], fitted_on: BinCounts
    ) -> EvaluationResult:
        """``fitted_on``: safety counts of the calibration images, at temperatures that have not seen them."""
        level = self.settings.level
        safety = stack_counts(whole.safety)
        hand = [image.n_hand_pixels for image in whole.tally.scores]
        missed = np.cumsum(safety.event, axis=1)[:, :-1]
        return EvaluationResult(
            temperature=temperature,
            lowest=float(applied.min()),
            highest=float(applied.max()),
            predictor=whole.tally.result(self.weights, level),
            hand=curve(stack_counts(whole.hand), self.weights, level),
            background=curve(stack_counts(whole.background), self.weights, level),
            safety=curve(safety, self.weights, level),
            support=delta_support(fitted_on, **self._bootstrap),
            held_out_delta=self._held_out(safety, fitted_on),
            taken_for_free=tuple(tuple((row / n).tolist()) if n else None for row, n in zip(missed, hand, strict=True)),
        )

    @property
    def _bootstrap(self) -> dict[str, Any]:
        return {
            "n_bootstrap": self.settings.n_bootstrap,
            "level": self.settings.level,
            "seed": self.settings.seed,
        }

    def _held_out(self, safety: BinCounts, fitted_on: BinCounts) -> HeldOutDelta | None:
        everything = np.arange(len(self.judged))
        if self.calibration is not None:
            return held_out_support(safety, [fitted_on], [everything], **self._bootstrap)
        if len(everything) == 1:
            return None
        fold = folds_of(len(everything), self.settings.n_folds or None)
        parts = [np.nonzero(fold == k)[0] for k in range(fold.max() + 1)]
        others = [safety.take(np.setdiff1d(everything, part)) for part in parts]
        return held_out_support(safety, others, parts, **self._bootstrap)


def _safety(labeled: LabeledPredictions, temperatures: NDArray[np.float64]) -> list[BinCounts]:
    pooled = (labeled.pooled(index) for index in range(len(labeled)))
    return [
        safety_counts(apply_temperature(p_mean, temperature), label)
        for (label, p_mean), temperature in zip(pooled, temperatures, strict=True)
    ]


def _risk(
    shares: NDArray[np.float64], held_out: NDArray[np.float64] | None, temperature: float, settings: CalibrationSettings
) -> tuple[RiskControl, ...]:
    """Thresholds of the mean as it is, carried through the temperature."""
    rows = [control_risk(shares, alpha, held_out) for alpha in sorted({*_ALPHAS, settings.missed_hand_alpha})]
    return tuple(
        row
        if row.threshold is None
        else dataclasses.replace(row, threshold=float(apply_temperature(np.array([row.threshold]), temperature).item()))
        for row in rows
    )
