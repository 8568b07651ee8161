"""The calibration report as a folder: `report.md` with pictures for people, `report.json` with every \
figure."""

import base64
import os
import pathlib
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError, SettingsError
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.perception.calibration.report_text import report_markdown
from deltasafe.perception.calibration.temperature import apply_temperature

__all__ = ["inline_pictures", "write_calibration_report"]

_TYPES = {".png": "image/png", ".jpg": "image/jpeg"}


def write_calibration_report(
    folder: str | pathlib.Path,
    report: CalibrationReport,
    *,
    labels: Sequence[NDArray[np.generic]],
    predictions: Sequence[NDArray[np.floating]],
    load_image: Callable[[str], NDArray[np.uint8]] | None = None,
    n_examples: int = 3,
) -> pathlib.Path:
    """Write `report.json`, `report.md` and the pictures; the folder appears as a whole or not at all.

    Args:
        folder: destination, replaced if it exists.
        labels, predictions: what the report was computed from; only the worst and best images are read again.
        load_image: image id -> (H, W, 3) uint8 at the label's resolution; without it there are no overlays.
        n_examples: number of worst and of best images to draw.

    Returns:
        path of `report.md`.

    Raises:
        SettingsError: labels and predictions that do not belong to the report.
    """
    from deltasafe.perception.calibration.ensemble_size_figure import ensemble_reliability_figure, ensemble_size_figure
    from deltasafe.perception.calibration.missed_hands_figure import missed_hands_figure
    from deltasafe.perception.calibration.overlay_figure import Overlay, overlay_figure
    from deltasafe.perception.calibration.reliability_figure import reliability_figure

    if not len(labels) == len(predictions) == len(report.image_ids):
        raise SettingsError(
            f"the report is about {len(report.image_ids)} images, got {len(labels)} labels and "
            f"{len(predictions)} predictions"
        )
    n_examples = min(n_examples, len(labels))
    pictures = {
        "reliability.png": reliability_figure(report),
        "missed_hands.png": missed_hands_figure(report),
        "ensemble_reliability.png": ensemble_reliability_figure(report),
        "ensemble_size.png": ensemble_size_figure(report),
    }
    if load_image is not None and n_examples > 0:
        for name, chosen in (
            ("worst.jpg", report.worst_examples(n_examples, report.settings.planning_delta)),
            ("best.jpg", report.worst_first[::-1][:n_examples]),
        ):
            overlays = [
                Overlay(
                    image_id=report.image_ids[i],
                    image=load_image(report.image_ids[i]),
                    label=labels[i],
                    p_occupied=apply_temperature(
                        np.mean(predictions[i], axis=0, dtype=np.float64), report.final.temperature
                    ),
                )
                for i in chosen
            ]
            pictures[name] = overlay_figure(overlays, report.settings.planning_delta)
    with atomic_folder(folder) as temporary:
        write_json(temporary / "report.json", report)
        for name, figure in pictures.items():
            options: dict[str, Any] = {"pil_kwargs": {"quality": 85}} if name.endswith(".jpg") else {}
            figure.savefig(temporary / name, dpi=96, **options)
        text = report_markdown(report, pictures)
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
