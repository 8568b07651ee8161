"""The text of a calibration report: values and table rows for the template ``report.md.j2``."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from deltasafe.perception.calibration.conformal_margin import REFERENCE_WIDTH_PX, ConformalMargin, ConformalMargins
from deltasafe.perception.calibration.ensemble_size import ensemble_size_table
from deltasafe.perception.calibration.paper_results import AUGMENTATION_RESULTS, ENSEMBLE_SIZE_RESULTS
from deltasafe.perception.calibration.report import CalibrationReport, EvaluationResult
from deltasafe.reporting.markdown import percent, plus_minus
from deltasafe.reporting.templates import render

Rows = list[tuple[str, ...]]

_MEASURES = (
    ("Pixel accuracy (PA)", "pixel_accuracy", "fraction of correctly classified pixels"),
    ("mIoU", "miou", "overlap of predicted and true shape, mean of hand and background; 1 is perfect"),
    ("Brier score (BS)", "brier", "mean squared error of the probability; 0 is perfect"),
    ("NLL [nats]", "nll", "negative log-likelihood; confident errors cost most; 0 is perfect"),
)
_DELTAS_SHOWN = (0.001, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
_MARGIN_DELTAS_SHOWN = (0.02, 0.05, 0.1, 0.2)


def report_markdown(report: CalibrationReport, pictures: Iterable[str]) -> str:
    """Write the report as Markdown that links the ``pictures`` (file names beside it)."""
    n_shown = max(1, min(5, len(report.images) // 2))
    return render(
        "deltasafe.perception.calibration",
        "report.md.j2",
        report=report,
        pictures=set(pictures),
        grid_delta=report.grid_delta,
        score_rows=_score_rows(report),
        delta_rows=_delta_rows(report),
        missed=_missed_hands(report),
        risk_rows=_risk_rows(report),
        margin=_conformal_margins(report),
        calibration_rows=_calibration_rows(report),
        ensemble_sizes=ensemble_size_table(report),
        member_rows=_member_rows(report),
        image_head=("Image", "mIoU", "PA", "Hand missed", "False alarms", "NLL"),
        worst_rows=_image_rows(report, report.worst_first[:n_shown]),
        best_rows=_image_rows(report, report.worst_first[::-1][:n_shown]),
    )


def _score_rows(report: CalibrationReport) -> Rows:
    final, mean = report.final.predictor, report.member_mean
    paper = next(row for row in AUGMENTATION_RESULTS if row.scheme == "ours" and row.n_images == 1000)
    paper_brier, paper_nll = ENSEMBLE_SIZE_RESULTS[10]
    printed = {
        "pixel_accuracy": f"{paper.pixel_accuracy:.3f} ± {paper.pixel_accuracy_sd:.3f} *",
        "miou": f"{paper.miou:.3f} ± {paper.miou_sd:.3f} *",
        "brier": f"{paper_brier:.4f}",
        "nll": f"{paper_nll:.3f}",
    }
    rows: Rows = [
        (
            title,
            f"**{getattr(final.scores, name):.4f}**",
            f"{getattr(final.low, name):.4f} to {getattr(final.high, name):.4f}",
            plus_minus(getattr(mean.mean, name), None if mean.sd is None else getattr(mean.sd, name)),
            printed[name],
            meaning,
        )
        for title, name, meaning in _MEASURES
    ]
    ece = [member.errors.expected for member in report.members]
    members = plus_minus(float(np.mean(ece)), float(np.std(ece, ddof=1)) if len(ece) > 1 else None)
    meaning = "expected calibration error: mean gap between confidence and accuracy; 0 is perfect"
    return [*rows, ("ECE", f"**{final.errors.expected:.4f}**", "", members, "", meaning)]


def _delta_rows(report: CalibrationReport) -> Rows:
    shown = {*_DELTAS_SHOWN, report.settings.planning_delta, report.smallest_supported_delta}
    return [
        (
            f"{row.delta:g}",
            f"{row.free_fraction:.1%}",
            "" if row.occupied_fraction is None else f"{row.occupied_fraction:.3%}",
            f"{row.upper_bound:.2%}",
            percent(row.miss_rate_mean),
            percent(row.miss_rate_worst),
            "yes" if row.supported else "no",
        )
        for row in report.final.support
        if row.delta in shown
    ]


def _missed_hands(report: CalibrationReport) -> dict[str, Any] | None:
    """Summarize the missed fractions over the images with a hand; None without such images."""
    missed, at_delta = report.missed_hand_rates, report.missed_at_planning_delta
    if not missed:
        return None
    rising = sorted(missed.values())
    median, quantile_90 = (rising[min(int(q * len(rising)), len(rising) - 1)] for q in (0.5, 0.9))
    worst = next(iter(at_delta))
    return {
        "median": median,
        "quantile_90": quantile_90,
        "worst": rising[-1],
        "at_delta_worst": at_delta[worst],
        "at_delta_worst_id": report.image_ids[worst],
        "at_delta_mean": sum(at_delta.values()) / len(at_delta),
        "rows": [(f"`{report.image_ids[i]}`", percent(missed[i]), percent(at_delta[i])) for i in list(missed)[:5]],
    }


def _risk_rows(report: CalibrationReport) -> Rows:
    return [
        (
            f"**{row.alpha:.0%}**" if row.alpha == report.settings.missed_hand_alpha else f"{row.alpha:.0%}",
            "none" if row.threshold is None else f"{row.threshold:.3g}",
            "" if row.held_out_mean is None else f"{row.held_out_mean:.2%}",
            "" if row.held_out_worst is None else f"{row.held_out_worst:.2%}",
        )
        for row in report.risk
    ]


def _conformal_margins(report: CalibrationReport) -> dict[str, Any] | None:
    """Tabulate the margins; None for a stored report without them."""
    margins, worst = report.final.margins, report.farthest_missed
    if margins is None or worst is None:
        return None
    separate = bool(report.calibration_image_ids)
    return {
        "n_images": margins.n_images,
        "smallest_alpha": margins.smallest_alpha,
        "reference_width_px": REFERENCE_WIDTH_PX,
        "worst_id": report.image_ids[worst],
        "worst": _margin_px(REFERENCE_WIDTH_PX * report.final.hausdorff_at(report.grid_delta)[worst]),
        "stated": _margin_px(margins.margin(report.grid_delta, margins.stated_alpha).px),
        "stated_alpha": margins.stated_alpha,
        "head": ("delta", *(f"alpha = {_alpha(alpha)}" for alpha in margins.shown_alphas)),
        "rows": _margin_rows(margins, {*_MARGIN_DELTAS_SHOWN, report.grid_delta}),
        "coverage_head": ("alpha", "k", "Expected coverage", "95 % interval", *(["Covered test images"] * separate)),
        "coverage_rows": [
            _coverage_row(report, margins.margin(report.grid_delta, alpha)) for alpha in margins.shown_alphas
        ],
    }


def _margin_rows(margins: ConformalMargins, deltas: set[float]) -> Rows:
    return [
        (f"{delta:g}", *(_margin_px(margins.margin(delta, alpha).px) for alpha in margins.shown_alphas))
        for delta in sorted(deltas)
    ]


def _coverage_row(report: CalibrationReport, margin: ConformalMargin) -> tuple[str, ...]:
    """Format rank and coverage of one margin, and its coverage of the test images if it was not fitted on them."""
    low, high = margin.coverage_interval()
    row = (
        _alpha(margin.alpha),
        f"{margin.rank} of {margin.n_images}",
        f"{margin.expected_coverage:.1%}",
        f"{low:.1%} to {high:.1%}",
    )
    if not report.calibration_image_ids:
        return row
    contained = report.final.hausdorff_at(report.grid_delta) <= margin.fraction_of_width
    n_contained, n = int(contained.sum()), len(contained)
    interval = binomtest(n_contained, n).proportion_ci(method="exact")
    return (*row, f"{n_contained} of {n} ({interval.low:.1%} to {interval.high:.1%})")


def _alpha(alpha: float) -> str:
    return f"{100 * alpha:.3g}%"


def _margin_px(px: float) -> str:
    return "infinite" if np.isinf(px) else f"{px:.1f}"


def _calibration_rows(report: CalibrationReport) -> Rows:
    def row(name: str, result: EvaluationResult) -> tuple[str, ...]:
        scores, errors, delta = result.predictor.scores, result.predictor.errors, result.smallest_supported_delta
        return (
            name,
            f"{scores.nll:.4f}",
            f"{scores.brier:.4f}",
            f"{errors.expected:.4f}",
            f"{errors.adaptive:.4f}",
            f"{errors.signed:+.4f} ({errors.signed_low:+.4f} to {errors.signed_high:+.4f})",
            "none" if delta is None else f"{delta:g}",
        )

    uncalibrated = row("uncalibrated (T = 1)", report.uncalibrated)
    return [uncalibrated] if report.calibrated is None else [uncalibrated, row("calibrated", report.calibrated)]


def _member_rows(report: CalibrationReport) -> Rows:
    return [
        (
            f"member {m}",
            *(f"{getattr(member.scores, name):.4f}" for _, name, _ in _MEASURES),
            f"{member.errors.expected:.4f}",
        )
        for m, member in enumerate(report.members)
    ]


def _image_rows(report: CalibrationReport, indices: Sequence[int]) -> Rows:
    images = [(report.image_ids[i], report.images[i]) for i in indices]
    return [
        (
            f"`{image_id}`",
            f"{image.miou:.3f}",
            f"{image.pixel_accuracy:.4f}",
            percent(image.missed_hand_rate),
            percent(image.false_alarm_rate),
            f"{image.nll:.4f}",
        )
        for image_id, image in images
    ]
