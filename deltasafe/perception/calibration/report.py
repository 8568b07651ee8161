"""The calibration report of an ensemble as plain data, its settings, and the gate before the freeze."""

import dataclasses
import itertools
import math
import pathlib
import typing

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json
from deltasafe.perception.calibration.calibration_error import CalibrationErrors
from deltasafe.perception.calibration.conformal_margin import ConformalMargins, with_infinity
from deltasafe.perception.calibration.conformal_risk import RiskControl
from deltasafe.perception.calibration.delta_support import (
    Calibration,
    DeltaSupport,
    HeldOutDelta,
    smallest_supported_delta,
)
from deltasafe.perception.calibration.metrics import ImageScores, MeanAndSd, Scores
from deltasafe.perception.calibration.reliability import DELTA_GRID, ReliabilityCurve, delta_index
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.settings import GateThresholds
from deltasafe.setting_ranges import check_range

FORMAT_VERSION = 3


@dataclasses.dataclass(frozen=True)
class CalibrationSettings:
    """How the report is computed.

    Attributes:
        n_bootstrap: bootstrap samples of the images.
        level: coverage of intervals (two-sided) and confidence of the supported delta (one-sided).
        n_folds: folds over the images; each fold is evaluated by a fit on the others. 0, or more folds than images:
            leave one image out.
        seed: of the bootstrap.
        recalibrate: freeze and use the ensemble with the fitted temperature; otherwise with T = 1.
        missed_hand_alpha: target of conformal risk control: bound on the expected fraction of a hand with p_occupied up
            to the threshold.
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
        check_range(self, "(0, 1)", "planning_delta", "missed_hand_alpha")
        check_range(self, "[100, inf)", "n_bootstrap")  # fewer give no 95 % bound
        check_range(self, "(0.5, 1)", "level")
        check_range(self, "[0, inf)", "n_folds", "seed")
        if self.n_folds == 1:
            raise SettingsError(f"n_folds must be 0 (leave one out) or at least 2, got {self.n_folds}")

    def for_images(self, n_images: int) -> "CalibrationSettings":
        """Leave one image out if there are fewer images than folds."""
        return dataclasses.replace(self, n_folds=0) if n_images < self.n_folds else self


@dataclasses.dataclass(frozen=True)
class PredictorResult:
    """Results of one predictor (a member, or the mean of the first M members) over all images.

    Attributes:
        images: (N,) scores per image.
        scores: PA, mIoU, BS, NLL over all images.
        low, high: their intervals, by bootstrap over images.
        errors: gaps between confidence and accuracy.
        reliability: the reliability diagram of the paper, with intervals.
    """

    images: tuple[ImageScores, ...]
    scores: Scores
    low: Scores
    high: Scores
    errors: CalibrationErrors
    reliability: ReliabilityCurve


@dataclasses.dataclass(frozen=True)
class EvaluationResult:
    """Results of the whole ensemble, each image at a temperature that was fitted without it.

    Attributes:
        temperature: fitted on all calibration images, to be used on further images; 1 for the uncalibrated ensemble.
        lowest_temperature, highest_temperature: range of the temperatures that the images were evaluated with.
        predictor: scores and errors.
        hand, background: reliability of the pixels predicted as hand, and as background.
        safety: fraction of occupied pixels per bin of p_occupied (bounds in ``DELTA_GRID``), with intervals.
        support: support of each delta by the calibration images.
        held_out_delta: the smallest supported delta on images that it was not fitted on; None for a single image.
        missed_at_delta: for each image, the fraction of its hand pixels with p_occupied <= delta, delta in
            ``DELTA_GRID``; None for an image without a hand.
        hausdorff_at_delta: for each image, the directed Hausdorff distance of its hand to the pixels with p_occupied >
            delta, delta in ``DELTA_GRID``, as fraction of the image's width; None for an infinite one, and for an
            image without a hand. Empty in reports that were stored before this field existed.
        calibration_hausdorff_at_delta: the same of the calibration images; empty if there are none.
    """

    temperature: float
    lowest_temperature: float
    highest_temperature: float
    predictor: PredictorResult
    hand: ReliabilityCurve
    background: ReliabilityCurve
    safety: ReliabilityCurve
    support: tuple[DeltaSupport, ...]
    held_out_delta: HeldOutDelta | None
    missed_at_delta: tuple[tuple[float, ...] | None, ...]
    hausdorff_at_delta: tuple[tuple[float | None, ...] | None, ...] = ()
    calibration_hausdorff_at_delta: tuple[tuple[float | None, ...] | None, ...] = ()

    @property
    def smallest_supported_delta(self) -> float | None:
        """The smallest delta that the calibration images support."""
        return smallest_supported_delta(self.support)

    @property
    def margins(self) -> ConformalMargins | None:
        """Conformal margins of the calibration images with a hand, or of the test images.

        None without an image of a hand, and in an older stored report.
        """
        rows = tuple(row for row in self.calibration_hausdorff_at_delta or self.hausdorff_at_delta if row is not None)
        return ConformalMargins.of_images(with_infinity(rows)) if rows else None

    def hausdorff_at(self, delta: float) -> NDArray[np.float64]:
        """Return (N,) distances of the test images, delta rounded up to the next value of ``DELTA_GRID``.

        NaN for an image without a hand.
        """
        unknown = (math.nan,) * len(DELTA_GRID)
        return with_infinity(tuple(row or unknown for row in self.hausdorff_at_delta))[:, delta_index(delta)]


@dataclasses.dataclass(frozen=True)
class FrozenFit:
    """The fit of an ensemble that was frozen before the images of the report were evaluated.

    Attributes:
        ensemble: name of its folder.
        temperature: of the ensemble.
        n_images: images that it was fitted on.
    """

    ensemble: str
    temperature: float
    n_images: int


@dataclasses.dataclass(frozen=True)
class CalibrationReport:
    """The calibration report of an ensemble of M members on N labeled images.

    Attributes:
        settings: how it was computed.
        image_ids: (N,) names of the images.
        calibration_image_ids: further images, on which temperature, delta and threshold were fitted; empty if they were
            cross-fitted on the N images.
        members: (M,) each member alone, uncalibrated.
        member_mean: mean and standard deviation over members.
        ensembles: (M,) mean of the first 1, 2, .., M members, uncalibrated.
        uncalibrated: the whole ensemble, T = 1.
        calibrated: the whole ensemble with the fitted temperature; None if it was not fitted (a single image).
        risk: thresholds by conformal risk control, for p_occupied as it is used.
        info: what the images show; stored beside the report.
        frozen: of an ensemble that was frozen before, which ``calibrated`` then has the temperature of; None if the
            temperature was fitted on these images, or on the further ones.
        format_version: of the stored form.
    """

    settings: CalibrationSettings
    image_ids: tuple[str, ...]
    calibration_image_ids: tuple[str, ...]
    members: tuple[PredictorResult, ...]
    member_mean: MeanAndSd
    ensembles: tuple[PredictorResult, ...]
    uncalibrated: EvaluationResult
    calibrated: EvaluationResult | None
    risk: tuple[RiskControl, ...]
    info: DatasetInfo = HANDS
    frozen: FrozenFit | None = None
    format_version: int = FORMAT_VERSION

    @property
    def final(self) -> EvaluationResult:
        """The whole ensemble as it is used: calibrated, unless the setting or a single image prevents it."""
        if self.settings.recalibrate and self.calibrated is not None:
            return self.calibrated
        return self.uncalibrated

    @property
    def n_calibration_images(self) -> int:
        """Number of images that temperature, delta and threshold were fitted on."""
        return len(self.calibration_image_ids or self.image_ids)

    @property
    def risk_control(self) -> RiskControl:
        """The threshold for the alpha of the settings."""
        return next(row for row in self.risk if row.alpha == self.settings.missed_hand_alpha)

    @property
    def images(self) -> tuple[ImageScores, ...]:
        """(N,) scores of the whole ensemble, as it is used, per image."""
        return self.final.predictor.images

    @property
    def n_members(self) -> int:
        """M."""
        return len(self.members)

    @property
    def n_pixels(self) -> int:
        """Number of pixels of all images."""
        return sum(image.n_pixels for image in self.images)

    @property
    def hand_fraction(self) -> float:
        """Fraction of hand pixels over all images."""
        return sum(image.n_hand_pixels for image in self.images) / self.n_pixels

    @property
    def smallest_supported_delta(self) -> float | None:
        """The smallest delta that the images support for the ensemble as it is used."""
        return self.final.smallest_supported_delta

    @property
    def grid_delta(self) -> float:
        """The planning delta, rounded up to the next value of ``DELTA_GRID``."""
        return DELTA_GRID[delta_index(self.settings.planning_delta)]

    @property
    def farthest_missed(self) -> int | None:
        """Index of the image whose hand lies farthest from the pixels with p_occupied > ``grid_delta``."""
        known = any(self.final.hausdorff_at_delta)
        return int(np.nanargmax(self.final.hausdorff_at(self.grid_delta))) if known else None

    @property
    def false_alarm_rates(self) -> dict[int, float]:
        """Fraction of the pixels predicted occupied, by index of the image, of images without a hand, largest first."""
        return self._largest_first({i: im.false_alarm_rate for i, im in enumerate(self.images) if not im.n_hand_pixels})

    @property
    def worst_first(self) -> tuple[int, ...]:
        """Indices of the images by rising mIoU, ties by name."""
        return tuple(sorted(range(len(self.images)), key=lambda i: (self.images[i].miou, self.image_ids[i])))

    @property
    def missed_hand_rates(self) -> dict[int, float]:
        """Fraction of the hand with p_occupied < 0.5, by index of the image, largest first, ties by name."""
        return self._largest_first({i: image.missed_hand_rate for i, image in enumerate(self.images)})

    @property
    def missed_at_planning_delta(self) -> dict[int, float]:
        """Fraction of the hand that is free at the planning delta, by index of the image, largest first, ties by name.

        Delta is rounded up to the next value of ``DELTA_GRID``.
        """
        column = delta_index(self.settings.planning_delta)
        rows = enumerate(self.final.missed_at_delta)
        return self._largest_first({i: None if row is None else row[column] for i, row in rows})

    def worst_examples(self, n_examples: int) -> tuple[int, ...]:
        """Select images to show: in turn the worst by mIoU, missed hand, and missed hand at the planning delta."""
        turns = itertools.zip_longest(self.worst_first, self.missed_hand_rates, self.missed_at_planning_delta)
        chosen = dict.fromkeys(i for turn in turns for i in turn if i is not None)
        return tuple(chosen)[:n_examples]

    @property
    def calibration(self) -> Calibration:
        """The calibration that is stored with the frozen ensemble and checked before planning."""
        final, risk = self.final.predictor, self.risk_control
        return Calibration(
            n_images=len(self.images),
            n_members=self.n_members,
            pixel_accuracy=final.scores.pixel_accuracy,
            miou=final.scores.miou,
            brier=final.scores.brier,
            nll=final.scores.nll,
            expected_calibration_error=final.errors.expected,
            smallest_supported_delta=self.smallest_supported_delta,
            level=self.settings.level,
            temperature=self.final.temperature,
            n_calibration_images=self.n_calibration_images,
            missed_hand_alpha=risk.alpha,
            missed_hand_threshold=risk.threshold,
            conformal_margins=self.final.margins,
        )

    def figures(self) -> dict[str, float]:
        """Figures of the whole ensemble by short name, for trackers and tables."""
        final, supported, risk = self.final.predictor, self.smallest_supported_delta, self.risk_control
        return {
            "pa": final.scores.pixel_accuracy,
            "miou": final.scores.miou,
            "nll": final.scores.nll,
            "bs": final.scores.brier,
            "ece": final.errors.expected,
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
            report = typing.cast(CalibrationReport, from_json(cls, value))
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(path, f"is not a calibration report ({error}); calibrate again") from error
        return dataclasses.replace(report, info=DatasetInfo.load(folder))

    def stored(self) -> dict[str, typing.Any]:
        """Return the content of ``report.json``: everything except ``info``, which has a file of its own."""
        left_out = ("info",) if self.frozen is not None else ("info", "frozen")
        return {
            field.name: getattr(self, field.name) for field in dataclasses.fields(self) if field.name not in left_out
        }

    def _largest_first(self, fractions: dict[int, float | None]) -> dict[int, float]:
        known = {i: fraction for i, fraction in fractions.items() if fraction is not None}
        return dict(sorted(known.items(), key=lambda item: (-item[1], self.image_ids[item[0]])))


def gate(report: CalibrationReport, thresholds: GateThresholds) -> list[str]:
    """List the reasons against freezing the ensemble, one sentence each; empty if it passes."""
    scores = report.final.predictor.scores
    failures = [
        f"{name} is {value:.4f} and must be at least {minimum:g}"
        for name, value, minimum in (
            ("pixel accuracy", scores.pixel_accuracy, thresholds.pixel_accuracy),
            ("mIoU", scores.miou, thresholds.miou),
        )
        if value < minimum
    ]
    supported, planned = report.smallest_supported_delta, report.settings.planning_delta
    if supported is None:
        failures.append(f"the images support no delta, planning needs {planned:g}")
    elif supported > planned:
        failures.append(f"the smallest supported delta is {supported:g}, planning needs {planned:g}")
    failures += [
        f"{image.missed_hand_rate:.1%} of the {report.info.singular} in {image_id} is missed, "
        f"{thresholds.missed_hand_rate:.1%} is allowed"
        for image_id, image in zip(report.image_ids, report.images, strict=True)
        if image.missed_hand_rate is not None and image.missed_hand_rate > thresholds.missed_hand_rate
    ]
    return failures
