"""Measure how often the margin of the conformal calibration contains the hand, on images that it was not fitted on.

Scores of scenes are stored by scene, ensemble and code, so that a stopped run continues. Figures: the margin that the
calibration scenes give at delta = 0.05, its coverage on the test scenes with the exact 95 % interval, the margin of
single members and of the whole ensemble, and the coverage on photographs of your own. Render both sets with
`make scenes`, with different seeds.
"""

import dataclasses
import os
import pathlib
import sys

import numpy as np
from numpy.typing import NDArray

from deltasafe.io.images import read_rgb
from deltasafe.perception.calibration.conformal_margin import ConformalMargins, hausdorff_at_delta
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.planning import MotionSettings
from deltasafe.scene import LoggedScene, grid_from_image
from deltasafe.studies.intervals import clopper_pearson
from deltasafe.studies.resumable_jobs import Batch, run_batches
from deltasafe.studies.safety import StudyInputs
from deltasafe.studies.safety.predictors import Predictor
from deltasafe.studies.safety.runs import SceneRef
from deltasafe.studies.safety.scenarios import true_mask
from deltasafe.trials.motion_margin import motion_margin_m
from evidence.reporting import command_parser, finish, named_folder, print_progress
from pipelines.command_line import run_command

DELTA = 0.05
ALPHAS = (0.02, 0.05, 0.1)
STATED = 0.05
SAID_EVERY = 20

Array = NDArray[np.float64]


def score_scene(scene: SceneRef, predictor: Predictor) -> Batch:
    """Return the scores (D,) of a scene: ``ensemble`` at its temperature, and ``member_K`` as it is."""
    loaded = LoggedScene.load(scene.folder)
    return score_image(read_rgb(loaded.image_path), true_mask(loaded), predictor)


def score_image(rgb: NDArray[np.uint8], mask: NDArray[np.generic], predictor: Predictor) -> Batch:
    """Return the scores (D,) of a labeled image by predictor."""
    prediction = predictor.predict(rgb)
    members = {f"member_{k}": p for k, p in enumerate(prediction.members)}
    return {name: hausdorff_at_delta(p, mask) for name, p in {"ensemble": prediction.ensemble, **members}.items()}


def scores(inputs: StudyInputs, folder: pathlib.Path, workers: int) -> dict[str, Array]:
    """Return (n, D) scores of the scenes by predictor; finished scenes in ``folder`` are reused."""
    jobs = [(f"scene-{number:05d}", (scene, inputs.predictor)) for number, scene in enumerate(inputs.scenes)]
    batches, _ = run_batches(score_scene, jobs, folder, workers, print_progress(SAID_EVERY))
    names = [name for name in batches[0] if name == "ensemble" or name.startswith("member_")]
    return {name: np.array([batch[name] for batch in batches]) for name in names}


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
    parser.add_argument("--set", action="append", default=[], metavar="NAME=FOLDER", help="labeled photographs")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path("guarantee"), metavar="DIR", help="scores")
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1, help="number of processes")
    options = parser.parse_args()
    sets = dict(named_folder(entry) for entry in options.set)
    fit, test = (StudyInputs.gather([folder], options.ensemble) for folder in (options.calibration, options.test))
    assert fit.predictor is not None
    calibration = fit.predictor.calibration()
    fitted_on, tested_on = (scores(inputs, options.work, options.workers) for inputs in (fit, test))
    fits = {name: ConformalMargins.of_images(rows) for name, rows in fitted_on.items()}
    margins = fits["ensemble"]
    figures = margin_figures(fits) | margin_mm(calibration, margins, LoggedScene.load(fit.scenes[0].folder))
    figures |= coverage_figures(margins, tested_on["ensemble"], "")
    figures |= {"calibration_images": len(fitted_on["ensemble"]), "coverage_images": len(tested_on["ensemble"])}
    own = calibration.conformal_margins
    if own is not None:  # the margins that the artifact states
        figures["margin_px_frozen"] = own.margin(DELTA, STATED).px
        figures |= coverage_figures(own, tested_on["ensemble"], "frozen_")
    for name, folder in sets.items():
        images = LabeledImageSet.load(folder)
        found = [score_image(*images.read(n), fit.predictor)["ensemble"] for n in range(len(images))]
        figures |= photograph_figures(name, margins, np.array(found))
    return finish(options, {name: round(float(value), 6) for name, value in figures.items()}, part="margin")


def certified(margins: ConformalMargins) -> list[float]:
    """Return the alphas that the number of images allows."""
    return [alpha for alpha in ALPHAS if alpha >= margins.smallest_alpha]


def margin_figures(fits: dict[str, ConformalMargins]) -> dict[str, float]:
    """Margins in pixels of a 384-pixel-wide image: of the ensemble, and the mean over its members."""
    px = {name: fit.margin(DELTA, STATED).px for name, fit in fits.items()}
    members = [value for name, value in px.items() if name != "ensemble"]
    whole = fits["ensemble"]
    stated = {f"margin_px_alpha_{round(1000 * a):03d}": whole.margin(DELTA, a).px for a in certified(whole)}
    return {
        "alpha": STATED,
        "margin_px": px["ensemble"],
        "margin_px_m1": float(np.mean(members)),
        f"margin_px_m{len(members)}": px["ensemble"],
        **stated,
    }


def margin_mm(calibration: Calibration, fit: ConformalMargins, scene: LoggedScene) -> dict[str, float]:
    """Margin in millimeters on the table of a scene."""
    calibration = dataclasses.replace(calibration, conformal_margins=fit)
    empty = np.zeros((scene.camera.height, scene.camera.width), np.float32)
    grid = grid_from_image(empty, scene.camera, scene.table_z_m, scene.hand_height_m)
    settings = MotionSettings(delta=DELTA, motion_alpha=STATED)
    return {"margin_mm": 1000 * motion_margin_m(calibration, settings, scene.camera, grid)}


def coverage_figures(margins: ConformalMargins, found: Array, prefix: str) -> dict[str, float]:
    """Coverage at each alpha that the margins certify, with the lower end of the exact 95 % interval."""
    figures = {}
    for alpha in certified(margins):
        name = f"{prefix}coverage_alpha_{round(100 * alpha):03d}"
        _, _, figures[name], (figures[f"{name}_lower95"], _) = coverage(margins, found, alpha)
    return figures


def photograph_figures(name: str, margins: ConformalMargins, found: Array) -> dict[str, float]:
    """Coverage of the rendered margin on a set of photographs, and the margin that one half of the set gives."""
    _, _, share, (low, _) = coverage(margins, found, STATED)
    half = ConformalMargins.of_images(found[::2])
    alpha = max(STATED, half.smallest_alpha)
    return {
        f"{name}_images": len(found),
        f"{name}_coverage": share,
        f"{name}_coverage_lower95": low,
        f"{name}_half_alpha": alpha,
        f"{name}_half_margin_px": half.margin(DELTA, alpha).px,
    }


if __name__ == "__main__":
    sys.exit(run_command(main))
