"""The text of a calibration report: values for the template ``report.md.j2``."""

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from scipy.stats import binomtest

from deltasafe.perception.calibration.conformal_margin import REFERENCE_WIDTH_PX, ConformalMargin, ConformalMargins
from deltasafe.perception.calibration.ensemble_size import ensemble_size_table
from deltasafe.perception.calibration.paper_results import AUGMENTATION_RESULTS, ENSEMBLE_SIZE_RESULTS
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.reporting.templates import render

Rows = list[tuple[str, ...]]

_DELTAS_SHOWN = (0.001, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2)
_MARGIN_DELTAS_SHOWN = (0.02, 0.05, 0.1, 0.2)


def report_markdown(report: CalibrationReport, pictures: Iterable[str]) -> str:
    """Write the report as Markdown that links the ``pictures`` (file names beside it)."""
    n_shown = max(1, min(5, len(report.images) // 2))
    shown = {*_DELTAS_SHOWN, report.settings.planning_delta, report.smallest_supported_delta}
    return render(
        "deltasafe.perception.calibration",
        "report.md.j2",
        report=report,
        pictures=set(pictures),
        grid_delta=report.grid_delta,
        paper=next(row for row in AUGMENTATION_RESULTS if row.scheme == "ours" and row.n_images == 1000),
        paper_brier_and_nll=ENSEMBLE_SIZE_RESULTS[10],
        member_ece=_mean_and_sd([member.errors.expected for member in report.members]),
        deltas=[row for row in report.final.support if row.delta in shown],
        missed=_missed_hands(report),
        margin=_conformal_margins(report),
        ensemble_sizes=ensemble_size_table(report),
        worst=report.worst_first[:n_shown],
        best=report.worst_first[::-1][:n_shown],
    )


def _mean_and_sd(values: Sequence[float]) -> tuple[float, float | None]:
    return float(np.mean(values)), float(np.std(values, ddof=1)) if len(values) > 1 else None


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
        "images": [(report.image_ids[i], missed[i], at_delta[i]) for i in list(missed)[:5]],
    }


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
    scores = report.final.hausdorff_at(report.grid_delta)
    contained = scores[~np.isnan(scores)] <= margin.fraction_of_width
    n_contained, n = int(contained.sum()), len(contained)
    interval = binomtest(n_contained, n).proportion_ci(method="exact")
    return (*row, f"{n_contained} of {n} ({interval.low:.1%} to {interval.high:.1%})")


def _alpha(alpha: float) -> str:
    return f"{100 * alpha:.3g}%"


def _margin_px(px: float) -> str:
    return "infinite" if np.isinf(px) else f"{px:.1f}"
