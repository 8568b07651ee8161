"""Promotion: a new ensemble (challenger) replaces the one in use (champion) if it is non-inferior (decision 36).

For each of NLL, Brier score and mIoU, the one-sided upper bound of the challenger's loss against the champion must not
exceed a margin. The bound comes from a paired bootstrap over the same test images. All three tests must pass, so no
correction for multiple tests is needed (intersection-union test).
"""

import dataclasses
import pathlib

import numpy as np

from deltasafe.compute.progress import Progress, silent
from deltasafe.errors import SettingsError
from deltasafe.io.records import from_json
from deltasafe.io.storage import read_json, write_json
from deltasafe.perception.artifact.frozen_ensemble import load_ensemble, verify_artifact
from deltasafe.perception.calibration.metrics import ImageScores, bootstrap_scores, score_image
from deltasafe.perception.calibration.reliability import bootstrap_weights
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.settings import EVALUATION_PIXELS, PromotionSettings


@dataclasses.dataclass(frozen=True)
class NonInferiorityTest:
    """Result of the test of one metric. A loss is positive where the challenger is worse.

    Attributes:
        measure: ``NLL`` or ``BS`` (loss as a fraction of the champion's value) or ``mIoU`` (loss as a difference).
        old, new: values of champion and challenger over all test images.
        loss: point estimate.
        bound: its one-sided upper confidence bound.
        margin: largest bound that passes.
    """

    measure: str
    old: float
    new: float
    loss: float
    bound: float
    margin: float

    @property
    def passed(self) -> bool:
        return self.bound <= self.margin

    def __str__(self) -> str:
        within = "within" if self.passed else "beyond"
        return (
            f"{self.measure} {self.old:.4f} -> {self.new:.4f}, loss {self.loss:+.2%} with an upper bound of "
            f"{self.bound:+.2%}, {within} the margin of {self.margin:.2%}"
        )


@dataclasses.dataclass(frozen=True)
class PromotionDecision:
    """Which ensemble to use.

    Attributes:
        champion: folder name of the ensemble to use from now on.
        challenger: folder name of the new ensemble.
        promoted: whether the two are the same.
        reason: one sentence.
        losses: the non-inferiority tests; empty if none were needed.
    """

    champion: str
    challenger: str
    promoted: bool
    reason: str
    losses: tuple[NonInferiorityTest, ...] = ()


def non_inferiority_tests(
    old: tuple[ImageScores, ...], new: tuple[ImageScores, ...], settings: PromotionSettings
) -> tuple[NonInferiorityTest, ...]:
    """Test ``new`` against ``old``: scores of the same N images in the same order.

    Raises:
        SettingsError: the scores are of different images.
    """
    sizes = [[(image.n_pixels, image.n_hand_pixels) for image in images] for images in (old, new)]
    if sizes[0] != sizes[1] or not old:
        raise SettingsError("two ensembles are compared on the same images; score both on one test set")
    weights = bootstrap_weights(len(old), settings.n_bootstrap, settings.seed)
    # row 0: every image once, for the point estimate
    weights = np.vstack([np.ones(len(old), dtype=weights.dtype), weights])
    (_, old_miou, old_bs, old_nll), (_, new_miou, new_bs, new_nll) = (
        bootstrap_scores(images, weights).T for images in (old, new)
    )
    samples = {
        "NLL": (old_nll, new_nll, new_nll / old_nll - 1.0, settings.nll_margin),
        "BS": (old_bs, new_bs, new_bs / old_bs - 1.0, settings.brier_margin),
        "mIoU": (old_miou, new_miou, old_miou - new_miou, settings.miou_margin),
    }
    return tuple(
        NonInferiorityTest(
            name, float(a[0]), float(b[0]), float(loss[0]), float(np.quantile(loss[1:], settings.level)), margin
        )
        for name, (a, b, loss, margin) in samples.items()
    )


def score_ensemble(
    folder: pathlib.Path, test: LabeledImageSet, cache: pathlib.Path, progress: Progress = silent
) -> tuple[ImageScores, ...]:
    """Score a frozen ensemble, with its temperature, on every image of ``test``.

    Args:
        cache: folder of scores, by ensemble and digest of the test set.

    Raises:
        ArtifactError: the ensemble is not intact.
    """
    folder = folder.resolve()
    file = cache / folder.name / f"{test.digest[:16]}.json"
    if file.is_file():
        verify_artifact(folder)
        return tuple(from_json(ImageScores, entry) for entry in read_json(file))
    ensemble, scores = load_ensemble(folder), []
    for index in range(len(test)):
        rgb, mask = test.read(index, EVALUATION_PIXELS)
        scores.append(score_image(ensemble.p_occupied(rgb), mask))
        progress(index + 1, len(test), f"{folder.name} on {test.items[index].id}")
    write_json(file, scores)
    return tuple(scores)


def decide_promotion(
    challenger: pathlib.Path,
    champion: pathlib.Path | None,
    test: LabeledImageSet,
    cache: pathlib.Path,
    settings: PromotionSettings,
    objection: str = "",
    progress: Progress = silent,
) -> PromotionDecision:
    """Decide whether ``challenger`` replaces ``champion`` (None if there is none yet).

    Args:
        cache: folder of scores, by ensemble and digest of the test set.
        objection: decision of a person because of which the challenger is not promoted; empty if there is none.

    Raises:
        ArtifactError: an ensemble is not intact.
    """
    if champion is None or champion.name == challenger.name:
        reason = "the first ensemble" if champion is None else "already in use"
        return PromotionDecision(challenger.name, challenger.name, True, reason)
    if objection:
        return PromotionDecision(champion.name, challenger.name, False, objection)
    old, new = (score_ensemble(folder, test, cache, progress) for folder in (champion, challenger))
    tests = non_inferiority_tests(old, new, settings)
    failed = [each for each in tests if not each.passed]
    compared = f"{champion.name} on {len(test)} test images: {'; '.join(str(each) for each in failed or tests)}"
    if failed:
        return PromotionDecision(champion.name, challenger.name, False, f"worse than {compared}", tests)
    return PromotionDecision(challenger.name, challenger.name, True, f"not worse than {compared}", tests)
