"""Everything that the test images say about an ensemble, as plain figures; the gate before the freeze."""

import dataclasses
import itertools
import pathlib
import typing

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json
from deltasafe.perception.calibration.calibration_error import CalibrationErrors
from deltasafe.perception.calibration.conformal_risk import RiskControl
from deltasafe.perception.calibration.delta_support import (
    Calibration,
    DeltaSupport,
    HeldOutDelta,
    smallest_supported_delta,
)
from deltasafe.perception.calibration.metrics import ImageScores, MeanAndSd, Scores
from deltasafe.perception.calibration.reliability import DELTA_GRID, Curve

__all__ = [
    "CalibrationReport",
    "CalibrationSettings",
    "EvaluationResult",
    "GateThresholds",
    "Predictor",
    "gate",
]

FORMAT_VERSION = 2


@dataclasses.dataclass(frozen=True)
class CalibrationSettings:
    """How the report is computed.

    Attributes:
        n_bootstrap: bootstrap samples of the images.
        level: coverage of intervals (two-sided) and confidence of the supported delta (one-sided).
        n_folds: folds over images, of which each is judged by a fit on the others; 0 leaves one image out at a time.
        seed: of the bootstrap.
        recalibrate: the ensemble is used and frozen with the temperature; without it, as it is.
        missed_hand_alpha: largest expected share of a hand with p_occupied up to the threshold that conformal risk
            control is to find.
        planning_delta: the delta that motions are planned with. The report marks hand pixels with p_occupied up to it,
            and the gate requires that the images support it.
    """

    n_bootstrap: int = 2000
    level: float = 0.95
    n_folds: int = 0
    seed: int = 0
    recalibrate: bool = True
    missed_hand_alpha: float = 0.05
    planning_delta: float = 0.05

    def __post_init__(self) -> None:
        if not 0.0 < self.planning_delta < 1.0:
            raise SettingsError(f"planning_delta must lie in (0, 1), got {self.planning_delta}")
        if not 0.0 < self.missed_hand_alpha < 1.0:
            raise SettingsError(f"missed_hand_alpha must lie in (0, 1), got {self.missed_hand_alpha}")
        if self.n_bootstrap < 100:
            raise SettingsError(f"n_bootstrap must be at least 100 for a 95 % bound, got {self.n_bootstrap}")
        if not 0.5 < self.level < 1.0:
            raise SettingsError(f"level must lie in (0.5, 1), got {self.level}")
        if self.n_folds < 0 or self.n_folds == 1:
            raise SettingsError(f"n_folds must be 0 (leave one out) or at least 2, got {self.n_folds}")


@dataclasses.dataclass(frozen=True)
class Predictor:
    """One member, or the mean of the first M members, over all images.

    Attributes:
        images: (N,) scores per image.
        scores: PA, mIoU, BS, NLL over all images.
        low, high: their intervals, by bootstrap over images.
        errors: gaps between confidence and accuracy.
        reliability: the paper's diagram, with intervals.
    """

    images: tuple[ImageScores, ...]
    scores: Scores
    low: Scores
    high: Scores
    errors: CalibrationErrors
    reliability: Curve

    @property
    def expected_calibration_error(self) -> float:
        return self.errors.expected


@dataclasses.dataclass(frozen=True)
class EvaluationResult:
    """The whole ensemble at one temperature, on images that the temperature has not seen.

    Attributes:
        temperature: fitted on all calibration images, for use on further ones; 1 if there is none.
        lowest, highest: range of the temperatures that the images were judged with.
        predictor: scores and errors.
        hand, background: reliability of the pixels that are predicted as hand, and as background.
        safety: how often a pixel is occupied per bin of p_occupied (bounds in ``DELTA_GRID``), with intervals.
        support: what the calibration images say about each delta.
        held_out_delta: the smallest supported delta on images it was not fitted on; None for a single image.
        taken_for_free: for each image the share of its hand's pixels with p_occupied <= delta, delta in
            ``DELTA_GRID``; None for an image without a hand.
    """

    temperature: float
    lowest: float
    highest: float
    predictor: Predictor
    hand: Curve
    background: Curve
    safety: Curve
    support: tuple[DeltaSupport, ...]
    held_out_delta: HeldOutDelta | None
    taken_for_free: tuple[tuple[float, ...] | None, ...]

    @property
    def smallest_supported_delta(self) -> float | None:
        return smallest_supported_delta(self.support)


@dataclasses.dataclass(frozen=True)
class CalibrationReport:
    """The calibration report of an ensemble of M members on N labeled images.

    Attributes:
        settings: how it was computed.
        image_ids: (N,) names of the images that it judges.
        calibration_image_ids: further images, on which temperature, delta and threshold were fitted; none if they
            were fitted and judged on the N images in turn (cross-fitting).
        members: (M,) each member alone, as it is.
        member_mean: mean and standard deviation over members.
        ensembles: (M,) mean of the first 1, 2, .., M members, as it is.
        as_it_is: the whole ensemble, T = 1.
        recalibrated: the whole ensemble with a temperature; None for a single image.
        risk: thresholds by conformal risk control, for p_occupied as it is used.
        format_version: of the stored form.
    """

    settings: CalibrationSettings
    image_ids: tuple[str, ...]
    calibration_image_ids: tuple[str, ...]
    members: tuple[Predictor, ...]
    member_mean: MeanAndSd
    ensembles: tuple[Predictor, ...]
    as_it_is: EvaluationResult
    recalibrated: EvaluationResult | None
    risk: tuple[RiskControl, ...]
    format_version: int = FORMAT_VERSION

    @property
    def final(self) -> EvaluationResult:
        """The whole ensemble as it will be used: recalibrated, if settings and images allow it."""
        if self.settings.recalibrate and self.recalibrated is not None:
            return self.recalibrated
        return self.as_it_is

    @property
    def n_calibration_images(self) -> int:
        """Images that temperature, delta and threshold were fitted on."""
        return len(self.calibration_image_ids or self.image_ids)

    @property
    def risk_control(self) -> RiskControl:
        """The threshold for the alpha of the settings."""
        return next(row for row in self.risk if row.alpha == self.settings.missed_hand_alpha)

    @property
    def images(self) -> tuple[ImageScores, ...]:
        """(N,) scores of the whole ensemble, as it will be used, per image."""
        return self.final.predictor.images

    @property
    def n_members(self) -> int:
        return len(self.members)

    @property
    def n_pixels(self) -> int:
        return sum(image.n_pixels for image in self.images)

    @property
    def hand_share(self) -> float:
        """Share of hand pixels over all images."""
        return sum(image.n_hand_pixels for image in self.images) / self.n_pixels

    @property
    def smallest_supported_delta(self) -> float | None:
        return self.final.smallest_supported_delta

    @property
    def worst_first(self) -> tuple[int, ...]:
        """Indices of the images by rising mIoU, ties by name."""
        return tuple(sorted(range(len(self.images)), key=lambda i: (self.images[i].miou, self.image_ids[i])))

    @property
    def most_missed_first(self) -> tuple[int, ...]:
        """Indices of the images with a hand by falling share that is missed (p_occupied < 0.5), ties by name."""
        missed = [(i, image.missed_hand_rate) for i, image in enumerate(self.images)]
        rates = {i: rate for i, rate in missed if rate is not None}
        return tuple(sorted(rates, key=lambda i: (-rates[i], self.image_ids[i])))

    def worst_examples(self, n_examples: int, delta: float) -> tuple[int, ...]:
        """Indices of images to look at: worst by mIoU, by missed hand, and by hand taken for free at ``delta``.

        The three rankings take turns, so that no way to fail is left out.
        """
        column = min((k for k, value in enumerate(DELTA_GRID) if value >= delta), default=len(DELTA_GRID) - 1)
        taken = {i: shares[column] for i, shares in enumerate(self.final.taken_for_free) if shares is not None}
        most_taken = sorted(taken, key=lambda i: (-taken[i], self.image_ids[i]))
        turns = itertools.zip_longest(self.worst_first, self.most_missed_first, most_taken)
        chosen = dict.fromkeys(i for turn in turns for i in turn if i is not None)
        return tuple(chosen)[:n_examples]

    @property
    def calibration(self) -> Calibration:
        """What is stored with the frozen ensemble and asked before planning."""
        final, risk = self.final.predictor, self.risk_control
        return Calibration(
            n_images=len(self.images),
            n_members=self.n_members,
            pixel_accuracy=final.scores.pixel_accuracy,
            miou=final.scores.miou,
            brier=final.scores.brier,
            nll=final.scores.nll,
            expected_calibration_error=final.expected_calibration_error,
            smallest_supported_delta=self.smallest_supported_delta,
            level=self.settings.level,
            temperature=self.final.temperature,
            n_calibration_images=self.n_calibration_images,
            missed_hand_alpha=risk.alpha,
            missed_hand_threshold=risk.threshold,
        )

    def figures(self) -> dict[str, float]:
        """The figures of the whole ensemble by short name, for trackers and tables."""
        final, supported, risk = self.final.predictor, self.smallest_supported_delta, self.risk_control
        return {
            "pa": final.scores.pixel_accuracy,
            "miou": final.scores.miou,
            "nll": final.scores.nll,
            "bs": final.scores.brier,
            "ece": final.expected_calibration_error,
            "ece_adaptive": final.errors.adaptive,
            "calibration_error_signed": final.errors.signed,
            "temperature": self.final.temperature,
            "n_members": self.n_members,
            **({} if supported is None else {"smallest_supported_delta": supported}),
            **({} if risk.threshold is None else {"missed_hand_threshold": risk.threshold}),
        }

    @classmethod
    def load(cls, folder: str | pathlib.Path) -> "CalibrationReport":
        """Read ``report.json`` of a folder written by `write_calibration_report`.

        Raises:
            DataError: the file is missing, of another version, or not a report.
        """
        path = pathlib.Path(folder) / "report.json"
        value = read_json(path)
        version = value.get("format_version") if isinstance(value, dict) else None
        if version != FORMAT_VERSION:
            raise DataError(path, f"has format version {version}, this release reads {FORMAT_VERSION}; calibrate again")
        try:
            return typing.cast(CalibrationReport, from_json(cls, value))
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(path, f"is not a calibration report ({error}); calibrate again") from error


@dataclasses.dataclass(frozen=True)
class GateThresholds:
    """What an ensemble must reach before it is frozen.

    Attributes:
        pixel_accuracy, miou: least values of the whole ensemble.
        missed_hand_rate: largest share of a hand that may be missed (p_occupied < 0.5) in any image; 1 asks
            nothing.
    """

    pixel_accuracy: float = 0.9
    miou: float = 0.8
    missed_hand_rate: float = 1.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not 0.0 <= value <= 1.0:
                raise SettingsError(f"{name} must lie in [0, 1], got {value}")


def gate(report: CalibrationReport, thresholds: GateThresholds) -> list[str]:
    """What keeps the ensemble from being frozen: one sentence a failure, none if it may pass."""
    scores = report.final.predictor.scores
    failures = [
        f"{name} is {value:.4f} and must be at least {least:g}"
        for name, value, least in (
            ("pixel accuracy", scores.pixel_accuracy, thresholds.pixel_accuracy),
            ("mIoU", scores.miou, thresholds.miou),
        )
        if value < least
    ]
    supported, planned = report.smallest_supported_delta, report.settings.planning_delta
    if supported is None:
        failures.append(f"the images support no delta, planning needs {planned:g}")
    elif supported > planned:
        failures.append(f"the smallest supported delta is {supported:g}, planning needs {planned:g}")
    failures += [
        f"{image.missed_hand_rate:.1%} of the hand in {image_id} is missed, "
        f"{thresholds.missed_hand_rate:.1%} is allowed"
        for image_id, image in zip(report.image_ids, report.images, strict=True)
        if image.missed_hand_rate is not None and image.missed_hand_rate > thresholds.missed_hand_rate
    ]
    return failures
