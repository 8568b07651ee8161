"""Everything that the test images say about an ensemble, as plain figures; the gate before the freeze."""

import dataclasses
import pathlib
import types
import typing
from typing import Any

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.calibration import Calibration, DeltaSupport, smallest_supported_delta
from deltasafe.perception.metrics import ImageScores, MeanAndSd, Scores
from deltasafe.perception.reliability import Curve
from deltasafe.storage import read_json

__all__ = [
    "CalibrationReport",
    "CalibrationSettings",
    "GateThresholds",
    "Predictor",
    "RecalibrationResult",
    "gate",
]

FORMAT_VERSION = 2


@dataclasses.dataclass(frozen=True)
class CalibrationSettings:
    """How the report is computed.

    Attributes:
        n_bootstrap: bootstrap samples of the images.
        level: coverage of intervals (two-sided) and confidence of the supported delta (one-sided).
        n_folds: folds over images for the temperature; 0 leaves one image out at a time.
        seed: of the bootstrap.
    """

    n_bootstrap: int = 2000
    level: float = 0.95
    n_folds: int = 0
    seed: int = 0

    def __post_init__(self) -> None:
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
        expected_calibration_error: over ten bins on [0.5, 1].
        reliability: the paper's diagram, with intervals.
    """

    images: tuple[ImageScores, ...]
    scores: Scores
    low: Scores
    high: Scores
    expected_calibration_error: float
    reliability: Curve


@dataclasses.dataclass(frozen=True)
class RecalibrationResult:
    """What a temperature would change.

    Attributes:
        temperature: fitted on all images, for use on further ones.
        lowest, highest: range of the temperatures fitted without the image (or fold) that they are judged on.
        scores, expected_calibration_error, smallest_supported_delta: with those temperatures, each image
            judged with the one that has not seen it.
    """

    temperature: float
    lowest: float
    highest: float
    scores: Scores
    expected_calibration_error: float
    smallest_supported_delta: float | None


@dataclasses.dataclass(frozen=True)
class CalibrationReport:
    """The calibration report of an ensemble of M members on N labelled images.

    Attributes:
        settings: how it was computed.
        image_ids: (N,) names of the images.
        members: (M,) each member alone.
        member_mean: mean and standard deviation over members.
        ensembles: (M,) mean of the first 1, 2, .., M members.
        safety: how often a pixel is occupied per bin of p_occupied (bounds in ``DELTA_GRID``), with
            intervals.
        support: what the data says about each delta.
        recalibration: effect of a temperature; None for a single image.
        format_version: of the stored form.
    """

    settings: CalibrationSettings
    image_ids: tuple[str, ...]
    members: tuple[Predictor, ...]
    member_mean: MeanAndSd
    ensembles: tuple[Predictor, ...]
    safety: Curve
    support: tuple[DeltaSupport, ...]
    recalibration: RecalibrationResult | None
    format_version: int = FORMAT_VERSION

    @property
    def images(self) -> tuple[ImageScores, ...]:
        """(N,) scores of the whole ensemble per image."""
        return self.ensembles[-1].images

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
        return smallest_supported_delta(self.support)

    @property
    def worst_first(self) -> tuple[int, ...]:
        """Indices of the images by rising mIoU, ties by name."""
        return tuple(sorted(range(len(self.images)), key=lambda i: (self.images[i].miou, self.image_ids[i])))

    @property
    def calibration(self) -> Calibration:
        """What is stored with the frozen ensemble and asked before planning; temperature 1, as certified."""
        final = self.ensembles[-1]
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
        )

    def figures(self) -> dict[str, float]:
        """The figures of the whole ensemble by short name, for trackers and tables."""
        final, supported = self.ensembles[-1], self.smallest_supported_delta
        return {
            "pa": final.scores.pixel_accuracy,
            "miou": final.scores.miou,
            "nll": final.scores.nll,
            "bs": final.scores.brier,
            "ece": final.expected_calibration_error,
            "n_members": self.n_members,
            **({} if supported is None else {"smallest_supported_delta": supported}),
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
            return typing.cast(CalibrationReport, _from_json(cls, value))
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(path, f"is not a calibration report ({error}); calibrate again") from error


@dataclasses.dataclass(frozen=True)
class GateThresholds:
    """What an ensemble must reach before it is frozen.

    Attributes:
        pixel_accuracy, miou: least values of the whole ensemble.
        planning_delta: the delta that planning will use; the data must support it.
        missed_hand_rate: largest share of a hand that may be missed (p_occupied < 0.5) in any image; 1 asks
            nothing.
    """

    pixel_accuracy: float = 0.9
    miou: float = 0.8
    planning_delta: float = 0.05
    missed_hand_rate: float = 1.0

    def __post_init__(self) -> None:
        for name, value in dataclasses.asdict(self).items():
            if not 0.0 <= value <= 1.0:
                raise SettingsError(f"{name} must lie in [0, 1], got {value}")


def gate(report: CalibrationReport, thresholds: GateThresholds) -> list[str]:
    """What keeps the ensemble from being frozen: one sentence a failure, none if it may pass."""
    scores = report.ensembles[-1].scores
    failures = [
        f"{name} is {value:.4f} and must be at least {least:g}"
        for name, value, least in (
            ("pixel accuracy", scores.pixel_accuracy, thresholds.pixel_accuracy),
            ("mIoU", scores.miou, thresholds.miou),
        )
        if value < least
    ]
    supported = report.smallest_supported_delta
    if supported is None:
        failures.append(f"the images support no delta, planning needs {thresholds.planning_delta:g}")
    elif supported > thresholds.planning_delta:
        failures.append(f"the smallest supported delta is {supported:g}, planning needs {thresholds.planning_delta:g}")
    failures += [
        f"{image.missed_hand_rate:.1%} of the hand in {image_id} is missed, "
        f"{thresholds.missed_hand_rate:.1%} is allowed"
        for image_id, image in zip(report.image_ids, report.images, strict=True)
        if image.missed_hand_rate is not None and image.missed_hand_rate > thresholds.missed_hand_rate
    ]
    return failures


def _from_json(kind: Any, value: Any) -> Any:
    """Rebuild the frozen dataclass, tuple or scalar ``kind`` from its JSON form; unknown keys are refused."""
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is types.UnionType:
        return None if value is None else _from_json(arguments[0], value)
    if origin is tuple:
        return tuple(_from_json(arguments[0], item) for item in value)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        hints = typing.get_type_hints(kind)
        unknown = sorted(set(value) - set(hints))
        if unknown:
            raise ValueError(f"{kind.__name__} has no {', '.join(unknown)}")
        return kind(**{name: _from_json(hints[name], item) for name, item in value.items()})
    accepted = (int, float) if kind is float else (kind,)
    if type(value) not in accepted:
        raise ValueError(f"expected {kind.__name__}, got {value!r}")
    return kind(value)
