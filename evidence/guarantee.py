"""Measure how often the margin of the conformal calibration contains the hand, on images that it was not fitted on.

Scores are computed once per image and stored, so that a stopped run continues. Figures: the margin that the calibration
scenes give at delta = 0.05, its coverage on the test scenes with the exact 95 % interval, the margin of single members
and of the whole ensemble, and the coverage on photographs of your own. Render both sets with `make scenes`, with
different seeds.
"""

import csv
import dataclasses
import pathlib
import sys
from collections.abc import Iterator, Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.io.arrays import read_npz
from deltasafe.io.images import read_rgb
from deltasafe.io.storage import atomic_file
from deltasafe.perception.artifact.frozen_ensemble import FrozenEnsemble, load_ensemble
from deltasafe.perception.calibration.conformal_margin import ConformalMargins, hausdorff_at_delta
from deltasafe.perception.calibration.temperature import pooled_probability
from deltasafe.planning import MotionSettings
from deltasafe.scene import LoggedScene, grid_from_image, load_scenes
from deltasafe.studies.intervals import clopper_pearson
from deltasafe.studies.safety.scenarios import true_mask
from deltasafe.trials.motion_margin import motion_margin_m
from evidence.reporting import command_parser, finish

DELTA = 0.05
ALPHAS = (0.02, 0.05, 0.1)
STATED = 0.05
SAVE_EVERY = 20

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Labeled:
    """An image (H, W, 3) uint8 with the true mask (H, W) of the hand."""

    name: str
    rgb: NDArray[np.uint8]
    mask: NDArray[np.bool_]


def scene_images(scenes: Sequence[LoggedScene]) -> Iterator[Labeled]:
    """Read image and true mask of each scene."""
    for scene in scenes:
        yield Labeled(scene.id, read_rgb(scene.image_path), true_mask(scene))


def photographs(folder: pathlib.Path, tier: str) -> Iterator[Labeled]:
    """Read ``images/`` and ``masks/`` of the rows of ``manifest.csv`` (columns id and tier) that belong to a tier."""
    for row in tiers(folder)[tier]:
        file = folder / "masks" / f"{row}.png"
        mask = cv2.imdecode(np.fromfile(file, np.uint8), cv2.IMREAD_GRAYSCALE)
        if mask is None:
            raise DataError(file, "is not an image; restore it")
        yield Labeled(row, read_rgb(folder / "images" / f"{row}.jpg"), np.asarray(mask > 127))


def tiers(folder: pathlib.Path) -> dict[str, list[str]]:
    """Return the ids of the images of each tier.

    Raises:
        DataError: the folder has no ``manifest.csv`` with the columns id and tier.
    """
    file = folder / "manifest.csv"
    found: dict[str, list[str]] = {}
    try:
        with file.open(newline="", encoding="utf-8") as rows:
            for row in csv.DictReader(rows):
                found.setdefault(row["tier"], []).append(row["id"])
    except (OSError, KeyError) as error:
        raise DataError(file, f"is no table with the columns id and tier ({error!r})") from error
    return found


def scores(ensemble: FrozenEnsemble, images: Iterator[Labeled], store: pathlib.Path) -> dict[str, Array]:
    """Return (n, D) scores by predictor: ``ensemble`` at its temperature, and ``member_K`` as it is.

    Args:
        store: file that holds the scores found so far; it is continued.
    """
    found: dict[str, Array] = dict(read_npz(store)) if store.is_file() else {}
    known = len(found["ensemble"]) if found else 0
    fresh: dict[str, list[Array]] = {}

    def save() -> dict[str, Array]:
        whole = {name: np.concatenate([found[name], rows] if known else [rows]) for name, rows in fresh.items()}
        if whole:
            with atomic_file(store) as temporary:
                np.savez_compressed(temporary, **whole)  # type: ignore[arg-type]
        return whole or found

    for number, image in enumerate(images):
        if number < known:
            continue
        members = ensemble.member_p_occupied(image.rgb)
        pooled = pooled_probability(members, ensemble.temperature)
        predicted = {"ensemble": pooled, **{f"member_{k}": p for k, p in enumerate(members)}}
        for name, p_occupied in predicted.items():
            fresh.setdefault(name, []).append(hausdorff_at_delta(p_occupied, image.mask))
        if (number + 1) % SAVE_EVERY == 0:
            save()
            print(f"{number + 1} images scored, last {image.name}", flush=True)
    return save()


def coverage(margins: ConformalMargins, found: Array, alpha: float) -> tuple[int, int, float, tuple[float, float]]:
    """Return how many of n images the margin covers, n, the share, and its exact 95 % interval."""
    margin = margins.margin(DELTA, alpha)
    covered = int((found[:, margins.deltas.index(margin.delta)] <= margin.fraction_of_width).sum())
    return covered, len(found), covered / len(found), clopper_pearson(covered, len(found))


def main() -> int:
    """Score the images, print the figures, and return the exit status."""
    parser = command_parser("guarantee", __doc__)
    parser.add_argument("--ensemble", type=pathlib.Path, required=True, metavar="DIR", help="a frozen ensemble")
    parser.add_argument("--calibration", type=pathlib.Path, required=True, metavar="DIR", help="scenes to fit it on")
    parser.add_argument("--test", type=pathlib.Path, required=True, metavar="DIR", help="other scenes to evaluate on")
    parser.add_argument("--photographs", type=pathlib.Path, metavar="DIR", help="images/, masks/ and manifest.csv")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("guarantee"), metavar="DIR", help="scores")
    options = parser.parse_args()
    ensemble = load_ensemble(options.ensemble)
    options.work.mkdir(parents=True, exist_ok=True)
    scenes = load_scenes(options.calibration)
    fitted_on = scores(ensemble, scene_images(scenes), options.work / "calibration.npz")
    tested_on = scores(ensemble, scene_images(load_scenes(options.test)), options.work / "test.npz")
    fits = {name: ConformalMargins.of_images(rows) for name, rows in fitted_on.items()}
    figures = margin_figures(fits) | margin_mm(ensemble, fits["ensemble"], scenes[0])
    figures |= coverage_figures(fits["ensemble"], tested_on["ensemble"], "")
    figures |= {"calibration_images": len(fitted_on["ensemble"]), "coverage_images": len(tested_on["ensemble"])}
    own = ensemble.calibration.conformal_margins
    if own is not None:  # the margins that the artifact states
        figures["margin_px_frozen"] = own.margin(DELTA, STATED).px
        figures |= coverage_figures(own, tested_on["ensemble"], "frozen_")
    if options.photographs is not None:
        figures |= photograph_figures(ensemble, fits["ensemble"], options)
    return finish(options, {name: round(float(value), 6) for name, value in figures.items()}, part="margin")


def margin_figures(fits: dict[str, ConformalMargins]) -> dict[str, float]:
    """Margins in pixels of a 384-pixel-wide image: of the ensemble, and the mean over its members."""
    px = {name: fit.margin(DELTA, STATED).px for name, fit in fits.items()}
    members = [value for name, value in px.items() if name != "ensemble"]
    stated = {f"margin_px_alpha_{round(1000 * a):03d}": fits["ensemble"].margin(DELTA, a).px for a in ALPHAS}
    return {
        "alpha": STATED,
        "margin_px": px["ensemble"],
        "margin_px_m1": float(np.mean(members)),
        f"margin_px_m{len(members)}": px["ensemble"],
        **stated,
    }


def margin_mm(ensemble: FrozenEnsemble, fit: ConformalMargins, scene: LoggedScene) -> dict[str, float]:
    """Margin in millimeters on the table of a scene."""
    calibration = dataclasses.replace(ensemble.calibration, conformal_margins=fit)
    empty = np.zeros((scene.camera.height, scene.camera.width), np.float32)
    grid = grid_from_image(empty, scene.camera, scene.table_z_m, scene.hand_height_m)
    settings = MotionSettings(delta=DELTA, motion_alpha=STATED)
    return {"margin_mm": 1000 * motion_margin_m(calibration, settings, scene.camera, grid)}


def coverage_figures(margins: ConformalMargins, found: Array, prefix: str) -> dict[str, float]:
    """Coverage at each alpha that the margins certify, with the lower end of the exact 95 % interval."""
    figures = {}
    for alpha in ALPHAS:
        if alpha >= margins.smallest_alpha:
            name = f"{prefix}coverage_alpha_{round(100 * alpha):03d}"
            _, _, figures[name], (figures[f"{name}_lower95"], _) = coverage(margins, found, alpha)
    return figures


def photograph_figures(ensemble: FrozenEnsemble, margins: ConformalMargins, options) -> dict[str, float]:  # type: ignore[no-untyped-def]
    """Coverage of the rendered margin on each tier, and the margin that one half of the tier gives for the other."""
    figures: dict[str, float] = {}
    for tier in sorted(tiers(options.photographs)):
        rows = scores(ensemble, photographs(options.photographs, tier), options.work / f"photographs_{tier}.npz")
        found, name = rows["ensemble"], f"devset_{tier.lower()}"
        figures[f"{name}_images"] = len(found)
        _, _, figures[f"{name}_coverage"], (figures[f"{name}_coverage_lower95"], _) = coverage(margins, found, STATED)
        half = ConformalMargins.of_images(found[::2])
        alpha = max(STATED, half.smallest_alpha)
        figures |= {f"{name}_half_alpha": alpha, f"{name}_half_margin_px": half.margin(DELTA, alpha).px}
    return figures


if __name__ == "__main__":
    sys.exit(main())
