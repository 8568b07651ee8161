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


@dataclasses.dataclass
class PredictorAccumulator:
    """Scores and counts of one predictor; every list has one entry per image."""

    scores: list[ImageScores] = dataclasses.field(default_factory=list)
    confidence: list[BinCounts] = dataclasses.field(default_factory=list)
    margins: list[BinCounts] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.float64], label: NDArray[np.bool_]) -> None:
        """Add one image, both arguments (H, W)."""
        self.scores.append(score_image(p_occupied, label))
        self.confidence.append(confidence_counts(p_occupied, label))
        self.margins.append(margin_counts(p_occupied, label))

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
    """Counts and distances that delta and margin are fitted on; both lists have one entry per image."""

    counts: list[BinCounts] = dataclasses.field(default_factory=list)
    hausdorff: list[NDArray[np.float64]] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.float64], label: NDArray[np.bool_]) -> None:
        """Add one image, both arguments (H, W)."""
        self.counts.append(safety_counts(p_occupied, label))
        self.hausdorff.append(hausdorff_at_delta(p_occupied, label))


@dataclasses.dataclass
class EnsembleAccumulator(PredictorAccumulator):
    """The counts of a predictor, and those that only the whole ensemble needs."""

    hand: list[BinCounts] = dataclasses.field(default_factory=list)
    background: list[BinCounts] = dataclasses.field(default_factory=list)
    safety: SafetyAccumulator = dataclasses.field(default_factory=SafetyAccumulator)

    def add(self, p_occupied: NDArray[np.float64], label: NDArray[np.bool_]) -> None:
        """Add one image, both arguments (H, W)."""
        super().add(p_occupied, label)
        hand, background = class_counts(p_occupied, label)
        self.hand.append(hand)
        self.background.append(background)
        self.safety.add(p_occupied, label)


@dataclasses.dataclass
class FitAccumulator:
    """Counts of the uncalibrated ensemble that temperature and conformal threshold are fitted on."""

    logits: list[LogitCounts] = dataclasses.field(default_factory=list)
    missed: list[NDArray[np.float64]] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.float64], label: NDArray[np.bool_]) -> None:
        """Add one image, both arguments (H, W)."""
        self.logits.append(logit_counts(p_occupied, label))
        missed = missed_fractions(p_occupied, label)
        if missed is not None:
            self.missed.append(missed)

    @property
    def losses(self) -> NDArray[np.float64]:
        """(n, K) `missed_fractions` of the n images with a hand."""
        return np.reshape(self.missed, (-1, len(THRESHOLD_GRID)))
