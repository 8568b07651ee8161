"""The text of a calibration report: what the ensemble is worth, what its members add, where it fails."""

from collections.abc import Iterable, Sequence

import numpy as np

from deltasafe.perception.calibration.ensemble_size import ensemble_size_table
from deltasafe.perception.calibration.paper_results import AUGMENTATION_RESULTS, ENSEMBLE_SIZE_RESULTS
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.perception.calibration.safety_sections import calibration_section, delta_section, missed_hand_section
from deltasafe.reporting.markdown import percent, plus_minus, table

__all__ = ["report_markdown"]

_MEASURES = (
    ("Pixel accuracy (PA)", "pixel_accuracy", "pixels classified right"),
    ("mIoU", "miou", "overlap of predicted and true shape, hand and background alike; 1 is perfect"),
    ("Brier score (BS)", "brier", "mean squared error of the probability; 0 is perfect"),
    ("NLL [nats]", "nll", "penalty for being surprised; confident errors cost most; 0 is perfect"),
)


def report_markdown(report: CalibrationReport, pictures: Iterable[str]) -> str:
    """The report as Markdown that links the ``pictures`` (file names) which lie beside it."""
    sections = (
        _summary(report),
        _glance(report),
        delta_section(report),
        missed_hand_section(report),
        calibration_section(report),
        _size_section(report),
        _failures_section(report, set(pictures)),
        _method(report),
    )
    return "\n\n".join(sections) + "\n"


def _summary(report: CalibrationReport) -> str:
    scores = report.final.predictor.scores
    worst = report.worst_first[0]
    supported = report.smallest_supported_delta
    temperature = report.final.temperature
    recalibrated = "" if temperature == 1.0 else f", recalibrated by a temperature of **{temperature:.3f}**,"
    verdict = (
        f"**The smallest delta that these images support is {supported:g}**: planning with a smaller one is refused."
        if supported is not None
        else "**These images support no delta**: planning is refused."
    )
    return f"""# Calibration report

An ensemble of **{report.n_members} members**{recalibrated} was judged on **{len(report.images)} labeled images** \
({report.n_pixels / 1e6:.1f} million pixels, {report.hand_share:.1%} of them hand). \
For each pixel it states `p_occupied`, the probability that a hand is there.

It classifies {scores.pixel_accuracy:.2%} of the pixels right (mIoU {scores.miou:.3f}). {verdict} \
It does worst on `{report.image_ids[worst]}` (mIoU {report.images[worst].miou:.3f}).

{_apart(report)}"""


def _apart(report: CalibrationReport) -> str:
    n_images = len(report.image_ids)
    if report.calibration_image_ids:
        return (
            f"Temperature, delta and threshold were fitted on **{report.n_calibration_images} further images** and "
            f"judged on these {n_images}."
        )
    if report.recalibrated is None:
        return "One image is too few to fit anything and to judge it."
    n_folds = report.settings.n_folds
    folds = f"the images outside its fold ({n_folds} folds)" if n_folds else "all other images"
    return (
        f"No image is judged by what was fitted on it: its temperature comes from {folds}; delta and threshold are "
        "checked in the same way. What is stored with the ensemble was fitted on all of them."
    )


def _glance(report: CalibrationReport) -> str:
    final, mean = report.final.predictor, report.member_mean
    ours = next(row for row in AUGMENTATION_RESULTS if row.scheme == "ours" and row.n_images == 1000)
    paper = {
        "pixel_accuracy": f"{ours.pixel_accuracy:.3f} ± {ours.pixel_accuracy_sd:.3f} *",
        "miou": f"{ours.miou:.3f} ± {ours.miou_sd:.3f} *",
        "brier": f"{ENSEMBLE_SIZE_RESULTS[10][0]:.4f}",
        "nll": f"{ENSEMBLE_SIZE_RESULTS[10][1]:.3f}",
    }
    rows = [
        (
            title,
            f"**{getattr(final.scores, name):.4f}**",
            f"{getattr(final.low, name):.4f} to {getattr(final.high, name):.4f}",
            plus_minus(getattr(mean.mean, name), None if mean.sd is None else getattr(mean.sd, name)),
            paper[name],
            meaning,
        )
        for title, name, meaning in _MEASURES
    ]
    ece = [member.expected_calibration_error for member in report.members]
    sd = float(np.std(ece, ddof=1)) if len(ece) > 1 else None
    rows.append(
        (
            "ECE",
            f"**{final.expected_calibration_error:.4f}**",
            "",
            plus_minus(float(np.mean(ece)), sd),
            "",
            "mean gap between confidence and accuracy; 0 is perfect",
        )
    )
    head = (
        "Measure",
        "Ensemble",
        f"{report.settings.level:.0%} interval",
        f"Members (mean ± sd, n = {mean.n})",
        "Paper, M = 10",
        "What it says",
    )
    return f"""## At a glance

{table(head, rows)}

\\* The paper gives PA and mIoU of its members with their standard deviation, on other images. Intervals \
come from drawing whole images again (bootstrap), since neighboring pixels are no independent evidence."""


def _size_section(report: CalibrationReport) -> str:
    members = [
        (
            f"member {m}",
            *(f"{getattr(member.scores, name):.4f}" for _, name, _ in _MEASURES),
            f"{member.expected_calibration_error:.4f}",
        )
        for m, member in enumerate(report.members)
    ]
    return f"""## What the members add

Means of the first M members as they are (T = 1), beside the paper's Table III. The last columns are intervals \
of the change against M = 1 on the same drawn images: below 0, more members help.

{ensemble_size_table(report)}

![Brier score and NLL over the ensemble size](ensemble_size.png)

![Reliability of ensembles of growing size, as in Fig. 4 of the paper](ensemble_reliability.png)

Each member alone:

{table(("Member", "PA", "mIoU", "BS", "NLL", "ECE"), members)}"""


def _failures_section(report: CalibrationReport, pictures: set[str]) -> str:
    def rows(chosen: Sequence[int]) -> list[tuple[str, ...]]:
        images = [(report.image_ids[i], report.images[i]) for i in chosen]
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

    head = ("Image", "mIoU", "PA", "Hand missed", "False alarms", "NLL")
    half = max(1, min(5, len(report.images) // 2))
    parts = ["## Where it fails", "The worst images by mIoU (a pixel is missed if p_occupied < 0.5):"]
    parts.append(table(head, rows(report.worst_first[:half])))
    if "worst.jpg" in pictures:
        parts.append("By mIoU, by missed hand, and by hand that a planner takes for free:")
        parts.append("![Worst images](worst.jpg)")
    parts += ["And the best:", table(head, rows(report.worst_first[::-1][:half]))]
    if "best.jpg" in pictures:
        parts.append("![Best images](best.jpg)")
    return "\n\n".join(parts)


def _method(report: CalibrationReport) -> str:
    settings = report.settings
    return f"""## How it was computed

- All pixels, at the resolution of the labels. PA and mIoU are means over images, BS and NLL means over \
pixels; p is clipped to [1e-7, 1 - 1e-7] in the NLL; p_occupied >= 0.5 is predicted as hand. ± is one \
standard deviation over members.
- Ten equal bins of confidence on [0.5, 1], for the adaptive error 15 bins of equal mass. Intervals: percentiles of \
{settings.n_bootstrap} bootstrap samples of the images, seed {settings.seed}.
- All statements assume that future images resemble these {report.n_calibration_images} as these resemble one another.
- Every figure, and every image, is in `report.json`."""
