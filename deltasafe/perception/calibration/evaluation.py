"""Compute a calibration report from the members' predictions on labeled images.

Images are processed one at a time, and every figure is computed from sums per image. Memory does not grow with the
number of pixels, and intervals come from a bootstrap over images.

Temperature, smallest supported delta and conformal threshold are evaluated on images that they were not fitted on: on
the test images if there is a separate calibration set, otherwise by cross-fitting (decision 32). Conformal margins are
fitted on the calibration set, or on the test images; each image has a temperature that was fitted without it.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.perception.calibration.accumulators import (
    EnsembleAccumulator,
    FitAccumulator,
    PredictorAccumulator,
    SafetyAccumulator,
)
from deltasafe.perception.calibration.conformal_margin import finite_or_none
from deltasafe.perception.calibration.conformal_risk import RiskControl, control_risk
from deltasafe.perception.calibration.delta_support import (
    HeldOutDelta,
    cumulative_safety_counts,
    delta_support,
    held_out_support,
)
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.metrics import mean_and_sd
from deltasafe.perception.calibration.reliability import (
    BinCounts,
    bootstrap_weights,
    reliability_curve,
    stack_counts,
)
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, EvaluationResult, FrozenFit
from deltasafe.perception.calibration.temperature import (
    apply_temperature,
    cross_fitted_temperatures,
    fit_temperature,
    folds_of,
    pooled_probability,
    stack_logit_counts,
)
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo

_ALPHAS = (0.02, 0.03, 0.05, 0.1)


def evaluate(
    images: LabeledPredictions,
    settings: CalibrationSettings | None = None,
    calibration: LabeledPredictions | None = None,
    progress: Progress = silent,
    info: DatasetInfo = HANDS,
    frozen: FrozenFit | None = None,
) -> CalibrationReport:
    """Evaluate the members, the ensembles of growing size, and the calibrated ensemble on labeled images.

    Args:
        images: to evaluate on.
        settings: intervals, folds, and what is fitted.
        calibration: further images of the same members, to fit temperature, delta and threshold on. Without them, each
            fold of ``images`` is evaluated by fits on the other folds.
        progress: called twice per image.
        info: what the images show.
        frozen: of an ensemble that was frozen before. It is evaluated with its own temperature; none is fitted.

    Raises:
        SettingsError: predictions of another number of members, or values that are no masks or probabilities.
    """
    n_fitted = len(calibration or images)
    settings = (settings or CalibrationSettings()).for_images(n_fitted)
    n_passes = 2 if frozen is None else 1
    done, total = itertools.count(1), n_passes * (len(images) + len(calibration or ()))
    run = _Evaluation(images, calibration, settings, lambda message: progress(next(done), total, message))
    scored = run.score(None if frozen is None else frozen.temperature)
    fit, fitted_on = scored.fit, scored.whole.safety
    if calibration is not None:
        fit, fitted_on = run.accumulate_fit(calibration, len(scored.members))
    uncalibrated = run.result(scored.whole, 1.0, np.ones(len(images)), fitted_on)
    calibrated: EvaluationResult | None
    if frozen is not None:
        applied = np.full(len(images), frozen.temperature)
        calibrated = run.result(scored.frozen, frozen.temperature, applied, scored.frozen.safety)
    else:
        calibrated = run.calibrated(fit) if n_fitted > 1 else None
    used = calibrated.temperature if settings.recalibrate and calibrated is not None else 1.0
    member_results, smaller_results = (
        tuple(predictor.result(run.weights, settings.level) for predictor in predictors)
        for predictors in (scored.members, scored.smaller)
    )
    return CalibrationReport(
        settings=settings,
        image_ids=tuple(images.image_ids),
        calibration_image_ids=() if calibration is None else tuple(calibration.image_ids),
        members=member_results,
        member_mean=mean_and_sd([member.scores for member in member_results]),
        ensembles=(*smaller_results, uncalibrated.predictor),
        uncalibrated=uncalibrated,
        calibrated=calibrated,
        risk=_risk_control(fit.losses, None if calibration is None else scored.fit.losses, used, settings),
        info=info,
        frozen=frozen,
    )


@dataclasses.dataclass
class _Scored:
    """Sums over the test images.

    Attributes:
        members: of each member.
        smaller: of the means of the first 1, .., M - 1 members.
        whole: of the mean of all M members.
        frozen: of the same with the temperature of a frozen ensemble; empty without one.
        fit: counts of the mean, to fit temperature and threshold on.
    """

    members: list[PredictorAccumulator] = dataclasses.field(default_factory=list)
    smaller: list[PredictorAccumulator] = dataclasses.field(default_factory=list)
    whole: EnsembleAccumulator = dataclasses.field(default_factory=EnsembleAccumulator)
    frozen: EnsembleAccumulator = dataclasses.field(default_factory=EnsembleAccumulator)
    fit: FitAccumulator = dataclasses.field(default_factory=FitAccumulator)


@dataclasses.dataclass(frozen=True)
class _Evaluation:
    images: LabeledPredictions
    calibration: LabeledPredictions | None
    settings: CalibrationSettings
    step: Callable[[str], None]

    @functools.cached_property
    def weights(self) -> NDArray[np.int64]:
        """Bootstrap samples of the images, shared by all intervals."""
        return bootstrap_weights(len(self.images), self.settings.n_bootstrap, self.settings.seed)

    def score(self, temperature: float | None) -> _Scored:
        """Read the test images once, at T = 1 and, if it is given, at the ``temperature`` of a frozen ensemble."""
        sums = _Scored()
        for image_id, (label, p_members, valid) in zip(self.images.image_ids, self.images.checked(), strict=True):
            sums.members = sums.members or [PredictorAccumulator() for _ in p_members]
            sums.smaller = sums.smaller or [PredictorAccumulator() for _ in p_members[1:]]
            for member, p_member in zip(sums.members, p_members, strict=True):
                member.add(p_member, label, valid)
            for m, ensemble in enumerate(sums.smaller, 1):
                ensemble.add(pooled_probability(p_members[:m]), label, valid)
            p_occupied = pooled_probability(p_members)
            sums.whole.add(p_occupied, label, valid)
            sums.fit.add(p_occupied, label, valid)
            if temperature is not None:
                sums.frozen.add(pooled_probability(p_members, temperature), label, valid)
            self.step(f"evaluated {image_id}")
        return sums

    def accumulate_fit(
        self, calibration: LabeledPredictions, n_members: int
    ) -> tuple[FitAccumulator, SafetyAccumulator]:
        """Read the calibration images once, at T = 1."""
        fit, safety = FitAccumulator(), SafetyAccumulator()
        checked = zip(calibration.image_ids, calibration.checked(n_members), strict=True)
        for image_id, (label, p_members, valid) in checked:
            p_occupied = pooled_probability(p_members)
            fit.add(p_occupied, label, valid)
            safety.add(p_occupied, label, valid)
            self.step(f"calibrated on {image_id}")
        return fit, safety

    def calibrated(self, fit: FitAccumulator) -> EvaluationResult:
        """Fit the temperature, and evaluate every image at a temperature fitted without it."""
        logits = stack_logit_counts(fit.logits)
        temperature = fit_temperature(logits)
        cross_fitted = cross_fitted_temperatures(logits, self.settings.n_folds)
        applied = cross_fitted if self.calibration is None else np.full(len(self.images), temperature)
        whole = EnsembleAccumulator()
        for index, image_id in enumerate(self.images.image_ids):
            whole.add(*self.images.pooled(index, applied[index]))
            self.step(f"evaluated {image_id} at T = {applied[index]:.3f}")
        if self.calibration is None:
            return self.result(whole, temperature, applied, whole.safety)
        fitted_on = SafetyAccumulator()
        for index, image_id in enumerate(self.calibration.image_ids):
            fitted_on.add(*self.calibration.pooled(index, cross_fitted[index]))
            self.step(f"evaluated {image_id} at T = {cross_fitted[index]:.3f}")
        return self.result(whole, temperature, applied, fitted_on)

    def result(
        self,
        whole: EnsembleAccumulator,
        temperature: float,
        applied: NDArray[np.float64],
        fitted_on: SafetyAccumulator,
    ) -> EvaluationResult:
        """Pool the images.

        Args:
            whole: the ensemble on the test images, at the temperatures ``applied`` (N,).
            temperature: fitted on all calibration images.
            fitted_on: sums of the images to fit delta and margin on, each at a temperature fitted without it.
        """
        level = self.settings.level
        safety, fit_counts = stack_counts(whole.safety.counts), stack_counts(fitted_on.counts)
        further = () if self.calibration is None else fitted_on.hausdorff
        n_hand = [image.n_hand_pixels for image in whole.scores]
        _, missed = cumulative_safety_counts(safety)
        return EvaluationResult(
            temperature=temperature,
            lowest_temperature=float(applied.min()),
            highest_temperature=float(applied.max()),
            predictor=whole.result(self.weights, level),
            hand=reliability_curve(stack_counts(whole.hand), self.weights, level),
            background=reliability_curve(stack_counts(whole.background), self.weights, level),
            safety=reliability_curve(safety, self.weights, level),
            support=delta_support(fit_counts, **self._bootstrap),
            held_out_delta=self._held_out_delta(safety, fit_counts),
            missed_at_delta=tuple(
                tuple((row / n).tolist()) if n else None for row, n in zip(missed, n_hand, strict=True)
            ),
            hausdorff_at_delta=tuple(row if row is None else finite_or_none(row) for row in whole.safety.hausdorff),
            calibration_hausdorff_at_delta=tuple(row if row is None else finite_or_none(row) for row in further),
        )

    @property
    def _bootstrap(self) -> dict[str, Any]:
        settings = self.settings
        return {"n_bootstrap": settings.n_bootstrap, "level": settings.level, "seed": settings.seed}

    def _held_out_delta(self, safety: BinCounts, fitted_on: BinCounts) -> HeldOutDelta | None:
        every = np.arange(len(self.images))
        if self.calibration is not None:
            return held_out_support(safety, [fitted_on], [every], **self._bootstrap)
        if len(every) == 1:
            return None
        fold = folds_of(len(every), self.settings.n_folds)
        held_out = [np.nonzero(fold == k)[0] for k in range(fold.max() + 1)]
        fits = [safety.take(np.setdiff1d(every, images)) for images in held_out]
        return held_out_support(safety, fits, held_out, **self._bootstrap)


def _risk_control(
    losses: NDArray[np.float64], held_out: NDArray[np.float64] | None, temperature: float, settings: CalibrationSettings
) -> tuple[RiskControl, ...]:
    """Fit thresholds of the uncalibrated probability, and map them through the temperature."""
    rows = [control_risk(losses, alpha, held_out) for alpha in sorted({*_ALPHAS, settings.missed_hand_alpha})]
    return tuple(
        row
        if row.threshold is None
        else dataclasses.replace(row, threshold=float(apply_temperature(np.array([row.threshold]), temperature).item()))
        for row in rows
    )
