"""Write the calibration report as a folder: `report.md` with pictures, and `report.json` with all figures."""

import pathlib
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport
from deltasafe.perception.calibration.report_text import report_markdown

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from deltasafe.perception.calibration.overlay_figure import Overlay

LoadImage = Callable[[str], NDArray[np.uint8]]


def write_calibration_report(
    folder: str | pathlib.Path,
    report: CalibrationReport,
    images: LabeledPredictions,
    load_image: LoadImage | None = None,
    n_examples: int = 3,
) -> pathlib.Path:
    """Write `report.json`, `report.md` and the pictures atomically.

    Args:
        folder: destination, replaced if it exists.
        report: of ``images``.
        images: labels and predictions that the report was computed from. Only the images shown are read again.
        load_image: image id -> (H, W, 3) uint8 at the label's resolution; without it, no images are shown.
        n_examples: number of worst and of best images to show.

    Returns:
        path of `report.md`.

    Raises:
        SettingsError: ``images`` are not the images of the report.
    """
    from deltasafe.perception.calibration.conformal_margin_figure import conformal_margin_figure
    from deltasafe.perception.calibration.overlay_figure import overlay_figure

    if tuple(images.image_ids) != report.image_ids:
        raise SettingsError(
            f"the report is about {len(report.image_ids)} images, got labels and predictions of {len(images)} others; "
            "pass the images that were evaluated"
        )
    pictures = _figures(report)

    def overlays(indices: Sequence[int]) -> "list[Overlay]":
        return [] if load_image is None else [_overlay(report, images, load_image, i) for i in indices]

    if report.farthest_missed is not None:
        shown = overlays([report.farthest_missed]) if n_examples > 0 else []
        pictures["conformal_margin.png"] = conformal_margin_figure(report, *shown)
    if load_image is not None and n_examples > 0:
        delta = report.settings.planning_delta
        thing = report.info.singular
        pictures["worst.jpg"] = overlay_figure(overlays(report.worst_examples(n_examples)), delta, thing)
        pictures["best.jpg"] = overlay_figure(overlays(report.worst_first[::-1][:n_examples]), delta, thing)
    with atomic_folder(folder) as temporary:
        write_json(temporary / "report.json", report.stored())
        report.info.save(temporary)
        for name, figure in pictures.items():
            options: dict[str, Any] = {"pil_kwargs": {"quality": 85}} if name.endswith(".jpg") else {}
            figure.savefig(temporary / name, dpi=96, **options)
        (temporary / "report.md").write_text(report_markdown(report, pictures), encoding="utf-8")
    return pathlib.Path(folder) / "report.md"


def _figures(report: CalibrationReport) -> "dict[str, Figure]":
    from deltasafe.perception.calibration.ensemble_size_figure import ensemble_reliability_figure, ensemble_size_figure
    from deltasafe.perception.calibration.missed_hands_figure import missed_hands_figure
    from deltasafe.perception.calibration.reliability_figure import reliability_figure

    return {
        "reliability.png": reliability_figure(report),
        "missed_hands.png": missed_hands_figure(report),
        "ensemble_reliability.png": ensemble_reliability_figure(report),
        "ensemble_size.png": ensemble_size_figure(report),
    }


def _overlay(report: CalibrationReport, images: LabeledPredictions, load_image: LoadImage, index: int) -> "Overlay":
    from deltasafe.perception.calibration.overlay_figure import Overlay

    p_occupied, label, valid = images.pooled(index, report.final.temperature)
    image_id = report.image_ids[index]
    return Overlay(image_id, load_image(image_id), label, p_occupied, valid)
