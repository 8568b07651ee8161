"""Evaluate a frozen ensemble on a folder of labeled images that it has never seen (`deltasafe evaluate`).

The ensemble keeps its temperature: nothing is fitted that changes a probability. One image is in memory at a time, and
predictions are not stored. Images of more than ``EVALUATION_PIXELS`` pixels are scaled down with their masks.
"""

import dataclasses
import functools
import pathlib
import unicodedata
from collections.abc import Callable, Sequence
from typing import Any, Generic, TypeVar, overload

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import DataError
from deltasafe.io.folder_entries import is_clutter
from deltasafe.io.images import fitting_size, read_header
from deltasafe.io.storage import write_json
from deltasafe.perception.artifact.frozen_ensemble import FrozenEnsemble
from deltasafe.perception.calibration.evaluation import evaluate
from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
from deltasafe.perception.calibration.report import CalibrationReport, CalibrationSettings, FrozenFit
from deltasafe.perception.calibration.write_report import write_calibration_report
from deltasafe.perception.data.labeled_images import LabeledImageSet, check_distinct, read_or_none
from deltasafe.perception.data.labeled_pair import aligned_mask, scaled_mask
from deltasafe.perception.data.masks import read_mask_plane
from deltasafe.perception.settings import EVALUATION_PIXELS

T = TypeVar("T")

METRICS_FILE = "metrics.json"
_MAX_LEFT_OUT_ONE_BY_ONE = 200
_FOLDS_OF_MANY_IMAGES = 10


def evaluate_folder(
    ensemble: FrozenEnsemble,
    folder: str | pathlib.Path,
    destination: str | pathlib.Path,
    *,
    planning_delta: float = 0.05,
    progress: Progress = silent,
) -> CalibrationReport:
    """Evaluate ``ensemble`` on the labeled images of ``folder``, and write the report to ``destination``.

    The report is that of `deltasafe.perception.evaluate_ensemble`, and ``metrics.json`` with the figures of the whole
    set and of each image.

    Args:
        ensemble: evaluated as it is used, with its temperature.
        folder: a set for `LabeledImageSet.load`, each image once. Pixels that are 255 in ``ignore/NAME.png`` do not
            count; an image without such a file counts whole. Images of more than ``EVALUATION_PIXELS`` pixels are
            scaled down.
        destination: replaced if it is an earlier report.
        planning_delta: of the hand that is missed at delta, and of its plots.
        progress: called after each image.

    Raises:
        DataError: lists the defective files; or the set shows another obstacle than the ensemble; or ``destination``
            is no earlier report; or lists images with the same pixels.
    """
    folder, destination = pathlib.Path(folder), pathlib.Path(destination)
    if destination.exists() and not (destination / METRICS_FILE).is_file():
        raise DataError(destination, "exists and is no earlier evaluation; give another folder")
    images = LabeledImageSet.load(folder)
    check_distinct(images, "test")
    info = images.info
    if info.is_default:  # a set without dataset.json shows what the ensemble was trained on
        info = dataclasses.replace(ensemble.info, images="")
    info.require_same_obstacle(ensemble.info, folder, "training")
    ignored = _ignored_masks(images, folder / "ignore")
    n_folds = _FOLDS_OF_MANY_IMAGES if len(images) > _MAX_LEFT_OUT_ONE_BY_ONE else 0
    settings = CalibrationSettings(n_folds=n_folds, planning_delta=planning_delta)

    def load_image(image_id: str) -> NDArray[np.uint8]:
        return images.read(ids.index(image_id), EVALUATION_PIXELS)[0]

    ids = [item.id for item in images.items]
    evaluated = LabeledPredictions(
        ids,
        _OnDemand(len(ids), lambda index: images.read(index, EVALUATION_PIXELS)[1]),
        _OnDemand(len(ids), lambda index: ensemble.member_p_occupied(load_image(ids[index]))),
        ignored,
    )
    calibration = ensemble.calibration
    frozen = FrozenFit(
        ensemble.folder.name, ensemble.temperature, calibration.n_calibration_images or calibration.n_images
    )
    report = evaluate(evaluated, settings, None, progress, info, frozen)
    write_calibration_report(destination, report, evaluated, load_image)
    write_json(destination / METRICS_FILE, metrics(report))
    return report


def metrics(report: CalibrationReport) -> dict[str, Any]:
    """Return the figures of the whole set with their intervals, and of each image, as JSON values."""
    predictor = report.final.predictor
    rates = report.missed_at_planning_delta
    return {
        "figures": report.figures(),
        "interval": {"level": report.settings.level, "low": predictor.low, "high": predictor.high},
        "missed_at_delta": {
            "delta": report.grid_delta,
            "mean": sum(rates.values()) / len(rates) if rates else None,
            "worst": max(rates.values(), default=None),
        },
        "images": {
            image_id: {**dataclasses.asdict(scores), "missed_at_delta": rates.get(index)}
            for index, (image_id, scores) in enumerate(zip(report.image_ids, report.images, strict=True))
        },
    }


def _ignored_masks(images: LabeledImageSet, folder: pathlib.Path) -> "_OnDemand[NDArray[np.bool_] | None] | None":
    """Read the masks of ignored pixels once to check them; return them to be read again on demand."""
    if not folder.is_dir():
        return None
    paths = sorted(path for path in folder.iterdir() if not is_clutter(path.name))
    files = {unicodedata.normalize("NFC", path.stem): path for path in paths}
    defects = [
        DataError(files[stem], "has no counterpart in images/; give both files the same stem, or remove it")
        for stem in sorted(files.keys() - {item.id for item in images.items})
    ]
    for index, item in enumerate(images.items):
        if item.id in files:
            mask = read_or_none(functools.partial(_read_ignored, images, index), files[item.id], defects)
            if mask is not None and mask.all():
                defects.append(DataError(files[item.id], "ignores the whole image; remove the image from the set"))
    if defects:
        raise DataError.combined(folder, defects)

    def read(index: int) -> NDArray[np.bool_] | None:
        file = files.get(images.items[index].id)
        return None if file is None else _read_ignored(images, index, file)

    return _OnDemand(len(images), read)


def _read_ignored(images: LabeledImageSet, index: int, path: pathlib.Path) -> NDArray[np.bool_]:
    """Read the mask of ignored pixels, upright and scaled down as its image."""
    image = images.items[index].image
    header, mask = read_header(image), read_mask_plane(path).above(0.5).astype(np.uint8)
    mask = aligned_mask(header, mask, images.options, (image, path))
    size = fitting_size(header.size, EVALUATION_PIXELS)
    return (mask if size == header.size else scaled_mask(mask, size)) > 0


@dataclasses.dataclass(frozen=True)
class _OnDemand(Sequence[T], Generic[T]):
    """A sequence of ``n`` items that are made when they are indexed."""

    n: int
    make: Callable[[int], T]

    def __len__(self) -> int:
        return self.n

    @overload
    def __getitem__(self, index: int) -> T: ...
    @overload
    def __getitem__(self, index: slice) -> list[T]: ...
    def __getitem__(self, index: int | slice) -> T | list[T]:
        places = range(self.n)[index]
        return [self.make(i) for i in places] if isinstance(places, range) else self.make(places)
