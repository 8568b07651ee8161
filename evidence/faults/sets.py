"""A few embedded hands and a small augmented set of them: what small trainings are made of."""

import pathlib
import shutil

from deltasafe.perception.augmentation.settings import AugmentationSettings
from deltasafe.perception.augmented_set import AugmentedSet, write_augmented_set
from deltasafe.perception.hands import HandSet
from pipelines.home import DATASETS

__all__ = ["tiny_hands", "tiny_set"]

N_ORIGINALS = 4


def tiny_hands(folder: pathlib.Path, of: str = "train") -> pathlib.Path:
    """The first four embedded training (or "test") images, copied."""
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
        for path in sorted((DATASETS / "hands" / of / kind).iterdir())[:N_ORIGINALS]:
            shutil.copyfile(path, folder / kind / path.name)
    return folder


def tiny_set(hands: pathlib.Path, folder: pathlib.Path, seed: int = 0, n_variants: int = 4) -> AugmentedSet:
    """``n_variants`` of each, 64 x 48 pixels."""
    settings = AugmentationSettings(n_variants=n_variants, width=64, height=48, seed=seed)
    return write_augmented_set(HandSet.load(hands), DATASETS / "backgrounds", settings, folder, workers=1)
