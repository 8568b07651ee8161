"""The part of a calibration report that safety leans on: delta, missed hands, and whether it is sure enough."""

from deltasafe.perception.calibration.reliability import DELTA_GRID
from deltasafe.perception.calibration.report import CalibrationReport, EvaluationResult
from deltasafe.reporting.markdown import percent, table

__all__ = ["calibration_section", "delta_section", "missed_hand_section"]


def delta_section(report: CalibrationReport) -> str:
    """Which delta do the images support, and does it hold on images that it was not fitted on?"""
    shown = {0.001, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, report.settings.planning_delta, report.smallest_supported_delta}
    rows = [
        (
            f"{row.delta:g}",
            f"{row.clear_share:.1%}",
            "" if row.occupied_share is None else f"{row.occupied_share:.3%}",
            f"{row.upper_bound:.2%}",
            percent(row.missed_hand_rate_mean),
            percent(row.missed_hand_rate_worst),
            "yes" if row.supported else "no",
        )
        for row in report.final.support
        if row.delta in shown
    ]
    head = (
        "delta",
        "Pixels that count as free",
        "of these occupied",
        f"{report.settings.level:.0%} upper bound",
        "Hand taken for free, mean",
        "in the worst image",
        "Supported",
    )
    return f"""## Can the planner rely on it?

A planner takes a pixel for free when `p_occupied <= delta`. The promise is kept if such pixels are \
occupied with a probability of at most delta.

![Reliability](reliability.png)

Left, as in Fig. 4 of the paper: accuracy per confidence; below the diagonal the network is \
overconfident. Right, what matters to safety: how often a pixel is occupied per bin of `p_occupied`; \
above the diagonal more often than stated. Bars count the pixels behind each point, as shares of all.

{table(head, rows)}

The upper bound draws from the images and one more, whose hand is missed entirely, because \
{report.n_calibration_images} images cannot exclude that the next one is such a case. It holds on average over all \
pixels that count as free, and for one pixel at one time: it bounds neither the collision probability of \
a whole body nor of a whole motion. More images, not a better network, are what lowers it once few pixels \
are missed.

{_held_out_delta(report)}"""


def _held_out_delta(report: CalibrationReport) -> str:
    result = report.final.held_out_delta
    if result is None:
        return "One image cannot be held out."
    if result.lowest is None or result.highest is None:
        return "**Held out:** no part of the images supports a delta, so that there is none to check on the others."
    same = result.lowest == result.highest
    delta = f"{result.lowest:g}" if same else f"{result.lowest:g} to {result.highest:g}"
    fits = "Fitted once, on the calibration images" if report.calibration_image_ids else f"Fitted {result.n_fits} times"
    lost = f" ({result.n_without_delta} fits supported none)" if result.n_without_delta else ""
    return (
        f"**Held out:** {fits}, the smallest supported delta is {delta}{lost}. On images that the fit has not seen, "
        f"{result.clear_share:.1%} of the pixels count as free at it, and **{result.occupied_share or 0.0:.3%}** of "
        f"those are occupied; the promise is at most {result.lowest:.1%}."
    )


def missed_hand_section(report: CalibrationReport) -> str:
    """How much of a hand is missed: image by image, and bounded by conformal risk control."""
    column = min(
        (k for k, delta in enumerate(DELTA_GRID) if delta >= report.settings.planning_delta),
        default=len(DELTA_GRID) - 1,
    )
    chosen = report.most_missed_first[:5]
    taken = {i: report.final.taken_for_free[i] for i in chosen}
    rows = [
        (
            f"`{report.image_ids[i]}`",
            percent(report.images[i].missed_hand_rate),
            percent(None if values is None else values[column]),
        )
        for i, values in taken.items()
    ]
    head = ("Image", "Hand missed (p < 0.5)", f"taken for free (p <= {DELTA_GRID[column]:g})")
    rates = [report.images[i].missed_hand_rate or 0.0 for i in report.most_missed_first]
    spread = "No image shows a hand."
    if rates:
        ordered = sorted(rates)
        at = [ordered[min(int(q * len(ordered)), len(ordered) - 1)] for q in (0.5, 0.9)]
        spread = (
            f"Half of the images miss at most {at[0]:.2%} of their hand, nine of ten at most {at[1]:.2%}, the worst "
            f"{ordered[-1]:.2%}."
        )
    shares = {i: values[column] for i, values in enumerate(report.final.taken_for_free) if values is not None}
    if shares:
        most = max(shares, key=lambda i: shares[i])
        spread += (
            f" Most of a hand is taken for free, p_occupied <= {DELTA_GRID[column]:g}, in `{report.image_ids[most]}`: "
            f"{shares[most]:.2%}; the mean is {sum(shares.values()) / len(shares):.2%}."
        )
    parts = [
        "## How much of a hand is missed?",
        "![Reliability by predicted class, and missed hands image by image](missed_hands.png)",
        spread,
        table(head, rows),
    ]
    return "\n\n".join([*parts, _risk_control(report)])


def _risk_control(report: CalibrationReport) -> str:
    rows = [
        (
            f"**{row.alpha:.0%}**" if row.alpha == report.settings.missed_hand_alpha else f"{row.alpha:.0%}",
            "none" if row.threshold is None else f"{row.threshold:.3g}",
            "" if row.held_out_mean is None else f"{row.held_out_mean:.2%}",
            "" if row.held_out_worst is None else f"{row.held_out_worst:.2%}",
        )
        for row in report.risk
    ]
    n_images = report.risk[0].n_images
    head = (
        "Expected share at most",
        "p_occupied up to",
        "Share on images not fitted on, mean",
        "in the worst image",
    )
    return f"""A bound that needs nothing but exchangeable images (conformal risk control, Angelopoulos et al. 2022): \
in a new image the share of the hand with `p_occupied` up to the threshold is at most alpha in expectation.

{table(head, rows)}

The target of alpha = {report.settings.missed_hand_alpha:.0%} was set beforehand and its threshold is stored with the \
ensemble. It is a mean over images and repetitions, no bound for each image. From {n_images} images with a hand \
nothing below 1 / ({n_images} + 1) = {1 / (n_images + 1):.2%} can be certified, however good the network is. The \
temperature does not touch it: it moves the threshold, not the pixels below it."""


def calibration_section(report: CalibrationReport) -> str:
    """Over- or under-confident, and what a temperature changes."""
    before, after = report.as_it_is, report.recalibrated
    errors = before.predictor.errors
    level = f"{report.settings.level:.0%}"
    if errors.signed_high < 0.0:
        verdict = "As it is, the ensemble is **under-confident**"
    elif errors.signed_low > 0.0:
        verdict = "As it is, the ensemble is **overconfident**"
    else:
        verdict = "As it is, the ensemble is neither clearly over- nor under-confident"
    verdict += (
        f": its mean confidence minus its accuracy is {100 * errors.signed:+.2f} points "
        f"({level} interval {100 * errors.signed_low:+.2f} to {100 * errors.signed_high:+.2f})."
    )
    head = ("Probability", "NLL", "BS", "ECE", "Adaptive ECE", "Confidence - accuracy", "Smallest supported delta")
    rows = [_row("as it is (T = 1)", before)]
    if after is None:
        told = "One image is too few to fit a temperature and to judge it."
    else:
        rows.append(_row("recalibrated", after))
        used = "with this temperature" if report.final is after else "as it is, with T = 1 (`recalibrate` is off)"
        told = (
            f"`logit(p_occupied) / T` of the pooled probability, fitted by NLL: **T = {after.temperature:.3f}** (above "
            "1 it takes confidence away, below 1 it adds some). Every image is judged with a T that was fitted without "
            f"it (from {after.lowest:.3f} to {after.highest:.3f}). The ensemble is used and certified {used}. Where "
            "images come that are unlike these, fit it again on some of them."
        )
    return f"""## Is it as sure as it should be?

{verdict}

{table(head, rows)}

{told}"""


def _row(name: str, judgment: EvaluationResult) -> tuple[str, ...]:
    scores, errors = judgment.predictor.scores, judgment.predictor.errors
    delta = judgment.smallest_supported_delta
    return (
        name,
        f"{scores.nll:.4f}",
        f"{scores.brier:.4f}",
        f"{errors.expected:.4f}",
        f"{errors.adaptive:.4f}",
        f"{errors.signed:+.4f} ({errors.signed_low:+.4f} to {errors.signed_high:+.4f})",
        "none" if delta is None else f"{delta:g}",
    )
