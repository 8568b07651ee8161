"""Accumulators: sums over the pixels of each image, from which all figures of a calibration report are computed."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.calibration.calibration_error import calibration_errors, margin_counts
from deltasafe.perception.calibration.conformal_margin import hausdorff_at_delta
from deltasafe.perception.calibration.conformal_risk import THRESHOLD_GRID, missed_fractions
from deltasafe.perception.calibration.metrics import (
    ImageScores,
    bootstrap_scores,
    percentile_interval,
    pool_scores,
    score_image,
)
from deltasafe.perception.calibration.reliability import (
    BinCounts,
    class_counts,
    confidence_counts,
    reliability_curve,
    safety_counts,
    stack_counts,
)
from deltasafe.perception.calibration.report import PredictorResult
from deltasafe.perception.calibration.temperature import LogitCounts, logit_counts

Probability = NDArray[np.float64]
Mask = NDArray[np.bool_]


@dataclasses.dataclass
class PredictorAccumulator:
    """Scores and counts of one predictor; every list has one entry per image."""

    scores: list[ImageScores] = dataclasses.field(default_factory=list)
    confidence: list[BinCounts] = dataclasses.field(default_factory=list)
    margins: list[BinCounts] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: Probability, label: Mask, valid: Mask | None = None) -> None:
        """Add one image, all arguments (H, W); pixels outside ``valid`` do not count."""
        pixels = valid_pixels(p_occupied, label, valid)
        self.scores.append(score_image(*pixels))
        self.confidence.append(confidence_counts(*pixels))
        self.margins.append(margin_counts(*pixels))

    def result(self, weights: NDArray[np.int64], level: float) -> PredictorResult:
        """Pool the images; intervals of coverage ``level`` come from (R, N) bootstrap weights."""
        counts = stack_counts(self.confidence)
        low, high = percentile_interval(bootstrap_scores(self.scores, weights), level)
        return PredictorResult(
            images=tuple(self.scores),
            scores=pool_scores(self.scores),
            low=low,
            high=high,
            errors=calibration_errors(counts, stack_counts(self.margins), weights, level),
            reliability=reliability_curve(counts, weights, level),
        )


@dataclasses.dataclass
class SafetyAccumulator:
    """Counts and distances that delta and margin are fitted on; both lists have one entry per image.

    An image without a hand has no distance.
    """

    counts: list[BinCounts] = dataclasses.field(default_factory=list)
    hausdorff: list[NDArray[np.float64] | None] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: Probability, label: Mask, valid: Mask | None = None) -> None:
        """Add one image, all arguments (H, W); pixels outside ``valid`` do not count."""
        hand = label if valid is None else label & valid
        self.counts.append(safety_counts(*valid_pixels(p_occupied, label, valid)))
        self.hausdorff.append(hausdorff_at_delta(p_occupied, hand) if hand.any() else None)


@dataclasses.dataclass
class EnsembleAccumulator(PredictorAccumulator):
    """The counts of a predictor, and those that only the whole ensemble needs."""

    hand: list[BinCounts] = dataclasses.field(default_factory=list)
    background: list[BinCounts] = dataclasses.field(default_factory=list)
    safety: SafetyAccumulator = dataclasses.field(default_factory=SafetyAccumulator)

    def add(self, p_occupied: Probability, label: Mask, valid: Mask | None = None) -> None:
        """Add one image, all arguments (H, W); pixels outside ``valid`` do not count."""
        super().add(p_occupied, label, valid)
        hand, background = class_counts(*valid_pixels(p_occupied, label, valid))
        self.hand.append(hand)
        self.background.append(background)
        self.safety.add(p_occupied, label, valid)


@dataclasses.dataclass
class FitAccumulator:
    """Counts of the uncalibrated ensemble that temperature and conformal threshold are fitted on."""

    logits: list[LogitCounts] = dataclasses.field(default_factory=list)
    missed: list[NDArray[np.float64]] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: Probability, label: Mask, valid: Mask | None = None) -> None:
        """Add one image, all arguments (H, W); pixels outside ``valid`` do not count."""
        pixels = valid_pixels(p_occupied, label, valid)
        self.logits.append(logit_counts(*pixels))
        missed = missed_fractions(*pixels)
        if missed is not None:
            self.missed.append(missed)

    @property
    def losses(self) -> NDArray[np.float64]:
        """(n, K) `missed_fractions` of the n images with a hand."""
        return np.reshape(self.missed, (-1, len(THRESHOLD_GRID)))


def valid_pixels(p_occupied: Probability, label: Mask, valid: Mask | None) -> tuple[Probability, Mask]:
    """Select the pixels that count, as arrays (1, n): scores do not depend on the places of the pixels."""
    return (p_occupied, label) if valid is None else (p_occupied[valid][None], label[valid][None])
