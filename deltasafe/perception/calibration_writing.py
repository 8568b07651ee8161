"""The calibration report as a folder: `report.md` with pictures for people, `report.json` with every \
figure."""

import base64
import os
import pathlib
import re
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.perception.calibration_report import CalibrationReport
from deltasafe.perception.metrics import Scores
from deltasafe.perception.paper_results import AUGMENTATION_RESULTS, ENSEMBLE_SIZE_RESULTS
from deltasafe.storage import atomic_folder, write_json

__all__ = ["inline_pictures", "report_markdown", "write_calibration_report"]

_MEASURES = (
    ("Pixel accuracy (PA)", "pixel_accuracy", "pixels classified right"),
    ("mIoU", "miou", "overlap of predicted and true shape, hand and background alike; 1 is perfect"),
    ("Brier score (BS)", "brier", "mean squared error of the probability; 0 is perfect"),
    ("NLL [nats]", "nll", "penalty for being surprised; confident errors cost most; 0 is perfect"),
)
_TYPES = {".png": "image/png", ".jpg": "image/jpeg"}


def write_calibration_report(
    folder: str | pathlib.Path,
    report: CalibrationReport,
    *,
    labels: Sequence[NDArray[np.generic]],
    predictions: Sequence[NDArray[np.floating]],
    load_image: Callable[[str], NDArray[np.uint8]] | None = None,
    n_examples: int = 3,
    planning_delta: float = 0.05,
) -> pathlib.Path:
    """Write `report.json`, `report.md` and the pictures; the folder appears as a whole or not at all.

    Args:
        folder: destination, replaced if it exists.
        labels, predictions: what the report was computed from; only the worst and best images are read again.
        load_image: image id -> (H, W, 3) uint8 at the label's resolution; without it there are no overlays.
        n_examples: number of worst and of best images to draw.
        planning_delta: hand with p_occupied up to it is marked as what a planner would drive through.

    Returns:
        path of `report.md`.

    Raises:
        SettingsError: labels and predictions that do not belong to the report.
    """
    from deltasafe.figures.overlays import Overlay, overlay_figure
    from deltasafe.figures.ensemble_size import ensemble_size_figure
    from deltasafe.figures.reliability import reliability_figure

    if not len(labels) == len(predictions) == len(report.image_ids):
        raise SettingsError(
            f"the report is about {len(report.image_ids)} images, got {len(labels)} labels and "
            f"{len(predictions)} predictions"
        )
    n_examples = min(n_examples, len(labels))
    pictures = {
        "reliability.png": reliability_figure(report),
        "ensemble_size.png": ensemble_size_figure(report),
    }
    if load_image is not None and n_examples > 0:
        for name, chosen in (
            ("worst.jpg", report.worst_first[:n_examples]),
            ("best.jpg", report.worst_first[::-1][:n_examples]),
        ):
            overlays = [
                Overlay(
                    image_id=report.image_ids[i],
                    image=load_image(report.image_ids[i]),
                    label=labels[i],
                    p_occupied=np.mean(predictions[i], axis=0, dtype=np.float64),
                )
                for i in chosen
            ]
            pictures[name] = overlay_figure(overlays, planning_delta)
    with atomic_folder(folder) as temporary:
        write_json(temporary / "report.json", report)
        for name, figure in pictures.items():
            options: dict[str, Any] = {"pil_kwargs": {"quality": 85}} if name.endswith(".jpg") else {}
            figure.savefig(temporary / name, dpi=110, **options)
        text = report_markdown(report, pictures, planning_delta)
        (temporary / "report.md").write_text(text, encoding="utf-8")
    return pathlib.Path(folder) / "report.md"


def inline_pictures(markdown: str | os.PathLike[str], limit_bytes: int = 1_000_000) -> str:
    """The text of `report.md` with its pictures inlined as base64, for a place that shows text only.

    Args:
        markdown: path of `report.md`, pictures beside it.
        limit_bytes: of the result; a picture that does not fit is replaced by its title.

    Raises:
        DataError: the report or one of its pictures is missing.
    """
    path = pathlib.Path(markdown)
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise DataError(path, "is missing; write the calibration report first") from None
    room = limit_bytes - len(text.encode("utf-8"))

    def inline(match: re.Match[str]) -> str:
        nonlocal room
        title, name = match.groups()
        picture = path.parent / name
        if not picture.is_file():
            raise DataError(picture, "is missing; write the calibration report again")
        data = base64.b64encode(picture.read_bytes()).decode("ascii")
        if len(data) + 40 > room:
            return f"*{title}: see `{name}` in the report's folder.*"
        room -= len(data) + 40
        return f"![{title}](data:{_TYPES[picture.suffix]};base64,{data})"

    return re.sub(r"!\[([^\]]*)\]\(([^):]+)\)", inline, text)


def report_markdown(report: CalibrationReport, pictures: Iterable[str], planning_delta: float = 0.05) -> str:
    """The report as Markdown that links the ``pictures`` (file names) which lie beside it."""
    sections = (
        _summary(report),
        _glance(report),
        _delta_section(report, planning_delta),
        _size_section(report),
        _recalibration_section(report),
        _failures_section(report, set(pictures)),
        _method(report),
    )
    return "\n\n".join(sections) + "\n"


def _summary(report: CalibrationReport) -> str:
    scores = report.ensembles[-1].scores
    worst = report.worst_first[0]
    supported = report.smallest_supported_delta
    verdict = (
        f"**The smallest delta that these images support is {supported:g}**: planning with a smaller one is refused."
        if supported is not None
        else "**These images support no delta**: planning is refused."
    )
    return f"""# Calibration report

An ensemble of **{report.n_members} members** was judged on **{len(report.images)} labelled images** \
({report.n_pixels / 1e6:.1f} million pixels, {report.hand_share:.1%} of them hand). \
For each pixel it states `p_occupied`, the probability that a hand is there.

It classifies {scores.pixel_accuracy:.2%} of the pixels right (mIoU {scores.miou:.3f}). {verdict} \
It does worst on `{report.image_ids[worst]}` (mIoU {report.images[worst].miou:.3f})."""


def _glance(report: CalibrationReport) -> str:
    final, mean = report.ensembles[-1], report.member_mean
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
            _plus_minus(getattr(mean.mean, name), None if mean.sd is None else getattr(mean.sd, name)),
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
            _plus_minus(float(np.mean(ece)), sd),
            "",
            "mean gap between confidence and accuracy; 0 is perfect",
        )
    )
    table = _table(
        (
            "Measure",
            "Ensemble",
            f"{report.settings.level:.0%} interval",
            f"Members (mean ± sd, n = {mean.n})",
            "Paper, M = 10",
            "What it says",
        ),
        rows,
    )
    return f"""## At a glance

{table}

\\* The paper gives PA and mIoU of its members with their standard deviation, on other images. Intervals \
come from drawing whole images again (bootstrap), since neighbouring pixels are no independent evidence."""


def _delta_section(report: CalibrationReport, planning_delta: float) -> str:
    shown = {0.001, 0.005, 0.01, 0.02, 0.05, 0.1, 0.2, planning_delta, report.smallest_supported_delta}
    rows = [
        (
            f"{row.delta:g}",
            f"{row.clear_share:.1%}",
            "" if row.occupied_share is None else f"{row.occupied_share:.3%}",
            f"{row.upper_bound:.2%}",
            _percent(row.missed_hand_rate_mean),
            _percent(row.missed_hand_rate_worst),
            "yes" if row.supported else "no",
        )
        for row in report.support
        if row.delta in shown
    ]
    table = _table(
        (
            "delta",
            "Pixels that count as free",
            "of these occupied",
            f"{report.settings.level:.0%} upper bound",
            "Hand taken for free, mean",
            "in the worst image",
            "Supported",
        ),
        rows,
    )
    return f"""## Can the planner rely on it?

A planner takes a pixel for free when `p_occupied <= delta`. The promise is kept if such pixels are \
occupied with a probability of at most delta.

![Reliability](reliability.png)

Left, as in Fig. 4 of the paper: accuracy per confidence; below the diagonal the network is \
overconfident. Right, what matters to safety: how often a pixel is occupied per bin of `p_occupied`; \
above the diagonal more often than stated. Bars count the pixels behind each point, as shares of all.

{table}

The upper bound draws from the images and one more, whose hand is missed entirely, because \
{len(report.images)} images cannot exclude that the next one is such a case. It holds on average over all \
pixels that count as free, and for one pixel at one time: it bounds neither the collision probability of \
a whole body nor of a whole motion. More images, not a better network, are what lowers it once few pixels \
are missed."""


def _size_section(report: CalibrationReport) -> str:
    def row(name: str, scores: Scores, ece: float, paper: tuple[float, float] | None) -> tuple[str, ...]:
        return (
            name,
            f"{scores.pixel_accuracy:.4f}",
            f"{scores.miou:.4f}",
            f"{scores.brier:.4f}",
            f"{scores.nll:.4f}",
            f"{ece:.4f}",
            f"{paper[0]:.4f} / {paper[1]:.3f}" if paper else "",
        )

    head = ("PA", "mIoU", "BS", "NLL", "ECE")
    ensembles = [
        row(f"M = {m}", e.scores, e.expected_calibration_error, ENSEMBLE_SIZE_RESULTS.get(m))
        for m, e in enumerate(report.ensembles, 1)
    ]
    members = [
        row(f"member {m}", e.scores, e.expected_calibration_error, None)[:-1] for m, e in enumerate(report.members)
    ]
    return f"""## What the members add

Means of the first M members, beside the paper's Table III:

{_table(("Ensemble", *head, "Paper: BS / NLL"), ensembles)}

![Brier score and NLL over the ensemble size](ensemble_size.png)

Each member alone:

{_table(("Member", *head), members)}"""


def _recalibration_section(report: CalibrationReport) -> str:
    result = report.recalibration
    if result is None:
        return "## Would a temperature help?\n\nOne image is too few to fit a temperature and to judge it."
    before = report.ensembles[-1]
    folds = f"{report.settings.n_folds} folds" if report.settings.n_folds else "leaving one image out"
    rows = [
        (
            name,
            f"{scores.brier:.4f}",
            f"{scores.nll:.4f}",
            f"{ece:.4f}",
            "none" if delta is None else f"{delta:g}",
        )
        for name, scores, ece, delta in (
            (
                "as it is (T = 1)",
                before.scores,
                before.expected_calibration_error,
                report.smallest_supported_delta,
            ),
            (
                "recalibrated",
                result.scores,
                result.expected_calibration_error,
                result.smallest_supported_delta,
            ),
        )
    ]
    return f"""## Would a temperature help?

`logit(p_occupied) / T` of the pooled probability, fitted by NLL: **T = {result.temperature:.3f}** on all \
images (above 1: the ensemble is overconfident). The figures below judge every image with a T that was \
fitted without it ({folds}; T from {result.lowest:.3f} to {result.highest:.3f}).

{_table(("Probability", "BS", "NLL", "ECE", "Smallest supported delta"), rows)}

The ensemble is used and certified as it is, with T = 1."""


def _failures_section(report: CalibrationReport, pictures: set[str]) -> str:
    def rows(chosen: Sequence[int]) -> list[tuple[str, ...]]:
        images = [(report.image_ids[i], report.images[i]) for i in chosen]
        return [
            (
                f"`{image_id}`",
                f"{image.miou:.3f}",
                f"{image.pixel_accuracy:.4f}",
                _percent(image.missed_hand_rate),
                _percent(image.false_alarm_rate),
                f"{image.nll:.4f}",
            )
            for image_id, image in images
        ]

    head = ("Image", "mIoU", "PA", "Hand missed", "False alarms", "NLL")
    half = max(1, min(5, len(report.images) // 2))
    parts = ["## Where it fails", "The worst images by mIoU (a pixel is missed if p_occupied < 0.5):"]
    parts.append(_table(head, rows(report.worst_first[:half])))
    if "worst.jpg" in pictures:
        parts.append("![Worst images](worst.jpg)")
    parts += ["And the best:", _table(head, rows(report.worst_first[::-1][:half]))]
    if "best.jpg" in pictures:
        parts.append("![Best images](best.jpg)")
    return "\n\n".join(parts)


def _method(report: CalibrationReport) -> str:
    settings = report.settings
    return f"""## How it was computed

- All pixels, at the resolution of the labels. PA and mIoU are means over images, BS and NLL means over \
pixels; p is clipped to [1e-7, 1 - 1e-7] in the NLL; p_occupied >= 0.5 is predicted as hand. ± is one \
standard deviation over members.
- Ten equal bins of confidence on [0.5, 1]. Intervals: percentiles of {settings.n_bootstrap} bootstrap \
samples of the images, seed {settings.seed}.
- All statements assume that future images resemble these {len(report.images)} as these resemble one another.
- Every figure, and every image, is in `report.json`."""


def _table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def _plus_minus(mean: float, sd: float | None) -> str:
    return f"{mean:.4f}" if sd is None else f"{mean:.4f} ± {sd:.4f}"


def _percent(value: float | None) -> str:
    return "no hand" if value is None else f"{value:.2%}"
