"""Sums over the pixels of each image, from which every figure of a calibration report follows."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.calibration.calibration_error import calibration_errors, margin_counts
from deltasafe.perception.calibration.conformal_risk import THRESHOLD_GRID, missed_hand_shares
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
    curve,
    safety_counts,
    stack_counts,
)
from deltasafe.perception.calibration.report import Predictor
from deltasafe.perception.calibration.temperature import LogitCounts, logit_counts

__all__ = ["FitTally", "Tally", "WholeTally"]


@dataclasses.dataclass
class Tally:
    """Sums of one predictor, image by image."""

    scores: list[ImageScores] = dataclasses.field(default_factory=list)
    confidence: list[BinCounts] = dataclasses.field(default_factory=list)
    margins: list[BinCounts] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.floating], label: NDArray[np.bool_]) -> None:
        self.scores.append(score_image(p_occupied, label))
        self.confidence.append(confidence_counts(p_occupied, label))
        self.margins.append(margin_counts(p_occupied, label))

    def result(self, weights: NDArray[np.int64], level: float) -> Predictor:
        counts = stack_counts(self.confidence)
        low, high = percentile_interval(bootstrap_scores(self.scores, weights), level)
        return Predictor(
            images=tuple(self.scores),
            scores=pool_scores(self.scores),
            low=low,
            high=high,
            errors=calibration_errors(counts, stack_counts(self.margins), weights, level),
            reliability=curve(counts, weights, level),
        )


@dataclasses.dataclass
class WholeTally:
    """Sums of the whole ensemble, image by image."""

    tally: Tally = dataclasses.field(default_factory=Tally)
    hand: list[BinCounts] = dataclasses.field(default_factory=list)
    background: list[BinCounts] = dataclasses.field(default_factory=list)
    safety: list[BinCounts] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.float64], label: NDArray[np.bool_]) -> None:
        self.tally.add(p_occupied, label)
        hand, background = class_counts(p_occupied, label)
        self.hand.append(hand)
        self.background.append(background)
        self.safety.append(safety_counts(p_occupied, label))


@dataclasses.dataclass
class FitTally:
    """What is fitted on, image by image: the mean of the members as it is."""

    logits: list[LogitCounts] = dataclasses.field(default_factory=list)
    safety: list[BinCounts] = dataclasses.field(default_factory=list)
    shares: list[NDArray[np.float64]] = dataclasses.field(default_factory=list)

    def add(self, p_occupied: NDArray[np.float64], label: NDArray[np.bool_]) -> None:
        self.logits.append(logit_counts(p_occupied, label))
        self.safety.append(safety_counts(p_occupied, label))
        shares = missed_hand_shares(p_occupied, label)
        if shares is not None:
            self.shares.append(shares)

    @property
    def missed_shares(self) -> NDArray[np.float64]:
        """(n, K) of the images with a hand."""
        return np.reshape(self.shares, (-1, len(THRESHOLD_GRID)))
