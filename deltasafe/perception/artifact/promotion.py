"""May a new ensemble replace the one in use? Non-inferiority on the same test images, by paired bootstrap.

The new one is *not worse* if, for each of NLL, Brier score and mIoU, the one-sided upper bound of what is lost
(the new one's score against the old one's, both on the same drawn images) stays below a margin. All three must hold, so
no correction for three tests is needed (intersection-union). A margin of zero would ask for proof of gain, and refuse
nineteen out of twenty retrainings that are just as good; a mere "no significant loss" would pass whatever few
images cannot tell apart.
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
from deltasafe.perception.settings import PromotionSettings

__all__ = ["Loss", "PromotionDecision", "compare_ensembles", "decide_promotion", "scores_on"]


@dataclasses.dataclass(frozen=True)
class Loss:
    """What the new ensemble loses by one measure; negative if it gains.

    Attributes:
        measure: ``NLL`` or ``BS`` (as a share of the old ensemble's), ``mIoU`` (as a difference).
        old, new: the scores over all test images.
        loss: point estimate.
        bound: its one-sided upper bound.
        margin: the most that the bound may be.
    """

    measure: str
    old: float
    new: float
    loss: float
    bound: float
    margin: float

    @property
    def tolerable(self) -> bool:
        return self.bound <= self.margin

    def __str__(self) -> str:
        kept = "within" if self.tolerable else "beyond"
        return (
            f"{self.measure} {self.old:.4f} -> {self.new:.4f}, loss {self.loss:+.2%} with an upper bound of "
            f"{self.bound:+.2%}, {kept} the margin of {self.margin:.2%}"
        )


@dataclasses.dataclass(frozen=True)
class PromotionDecision:
    """Which ensemble is to be used.

    Attributes:
        champion: name of the folder of the ensemble to be used from now on.
        challenger: name of the folder of the new one.
        promoted: the new one is the one to be used.
        reason: one sentence.
        losses: the measures compared; none where there was nothing to compare with.
        n_images: test images.
    """

    champion: str
    challenger: str
    promoted: bool
    reason: str
    losses: tuple[Loss, ...] = ()
    n_images: int = 0


def compare_ensembles(
    old: tuple[ImageScores, ...], new: tuple[ImageScores, ...], settings: PromotionSettings
) -> tuple[Loss, ...]:
    """Losses of ``new`` against ``old``, scores of the same N images in the same order.

    Raises:
        SettingsError: the scores are not of the same images.
    """
    sizes = [[(image.n_pixels, image.n_hand_pixels) for image in images] for images in (old, new)]
    if sizes[0] != sizes[1] or not old:
        raise SettingsError("two ensembles are compared on the same images; score both on one test set")
    weights = bootstrap_weights(len(old), settings.n_bootstrap, settings.seed)
    # row 0: every image once
    weights = np.vstack([np.ones(len(old), dtype=weights.dtype), weights])
    (_, old_miou, old_bs, old_nll), (_, new_miou, new_bs, new_nll) = (
        bootstrap_scores(images, weights).T for images in (old, new)
    )
    drawn = {
        "NLL": (old_nll, new_nll, new_nll / old_nll - 1.0, settings.nll_margin),
        "BS": (old_bs, new_bs, new_bs / old_bs - 1.0, settings.brier_margin),
        "mIoU": (old_miou, new_miou, old_miou - new_miou, settings.miou_margin),
    }
    return tuple(
        Loss(name, float(a[0]), float(b[0]), float(loss[0]), float(np.quantile(loss[1:], settings.level)), margin)
        for name, (a, b, loss, margin) in drawn.items()
    )


def scores_on(
    folder: pathlib.Path, test: LabeledImageSet, kept: pathlib.Path, progress: Progress = silent
) -> tuple[ImageScores, ...]:
    """Scores of a frozen ensemble, as its users run it, on every image of ``test``; asked once for each test set.

    Args:
        kept: folder of scores, by ensemble and digest of the test set.

    Raises:
        ArtifactError: the ensemble is not intact.
    """
    folder = folder.resolve()
    file = kept / folder.name / f"{test.digest[:16]}.json"
    if file.is_file():
        verify_artifact(folder)
        return tuple(from_json(ImageScores, entry) for entry in read_json(file))
    ensemble, scores = load_ensemble(folder), []
    for index in range(len(test)):
        rgb, mask = test.read(index)
        scores.append(score_image(ensemble.p_occupied(rgb), mask))
        progress(index + 1, len(test), f"{folder.name} on {test.items[index].id}")
    write_json(file, scores)
    return tuple(scores)


def decide_promotion(
    challenger: pathlib.Path,
    champion: pathlib.Path | None,
    test: LabeledImageSet,
    kept: pathlib.Path,
    settings: PromotionSettings,
    demotion_reason: str = "",
    progress: Progress = silent,
) -> PromotionDecision:
    """Whether ``challenger`` takes the place of ``champion`` (None if there is none yet); see the module for the rule.

    Args:
        kept: folder of scores, by ensemble and digest of the test set.
        demotion_reason: why a person took the challenger out of use; what a person decided is not overruled by figures.

    Raises:
        ArtifactError: one of the two is not intact.
    """
    if champion is not None and demotion_reason and champion.name != challenger.name:
        return PromotionDecision(champion.name, challenger.name, False, f"taken out of use by hand: {demotion_reason}")
    if champion is None or champion.name == challenger.name:
        reason = "the first of its kind" if champion is None else "the very ensemble that is in use"
        return PromotionDecision(challenger.name, challenger.name, True, reason)
    old, new = (scores_on(folder, test, kept, progress) for folder in (champion, challenger))
    losses = compare_ensembles(old, new, settings)
    beyond = [str(loss) for loss in losses if not loss.tolerable]
    if beyond:
        return PromotionDecision(
            champion.name,
            challenger.name,
            False,
            f"worse than {champion.name} on {len(test)} test images: {'; '.join(beyond)}",
            losses,
            len(test),
        )
    held = "; ".join(str(loss) for loss in losses)
    reason = f"not worse than {champion.name} on {len(test)} test images: {held}"
    return PromotionDecision(challenger.name, challenger.name, True, reason, losses, len(test))
