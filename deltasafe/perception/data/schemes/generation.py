"""From a scheme's settings to what makes its images, original by original; each image has a seed of its own."""

import dataclasses
import hashlib
from typing import Protocol

import numpy as np

from deltasafe.perception.data.augmentation import (
    AugmentationSettings,
    Augmented,
    Backgrounds,
    augment,
    cut_out,
    image_seed,
)
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes.cutout import Cutout
from deltasafe.perception.data.schemes.flip_rotate90 import FlipRotate90
from deltasafe.perception.data.schemes.flip_rotate_crop import FlipRotateCrop
from deltasafe.perception.data.schemes.mixup import Mixup
from deltasafe.perception.data.schemes.originals import Originals
from deltasafe.perception.data.schemes.settings import (
    ComparedSettings,
    CutoutSettings,
    FlipRotate90Settings,
    FlipRotateCropSettings,
    MixupSettings,
    SchemeSettings,
)

__all__ = ["Maker", "maker_of", "stored_form"]


class Maker(Protocol):
    """Makes all variants of one original: anywhere, in any order, always the same bytes."""

    def variants(self, i: int) -> list[Augmented]:
        """Of the ``i``-th original."""


def maker_of(hands: LabeledImageSet, backgrounds: Backgrounds, settings: SchemeSettings) -> Maker:
    """What makes the images of a scheme from the originals; only our scheme looks at ``backgrounds``.

    Raises:
        DataError: an original is defective.
    """
    if isinstance(settings, AugmentationSettings):
        return _Massive(hands, backgrounds, settings)
    return _Compared(_method(hands, settings), settings)


def stored_form(settings: SchemeSettings) -> tuple[tuple[int, int], type[np.uint8] | type[np.uint16]]:
    """Rows and columns of the stored images, and the type of their masks: uint16 is soft."""
    side = max(settings.height, settings.width)
    square = isinstance(settings, FlipRotate90Settings)
    shape = (side, side) if square else (settings.height, settings.width)
    return shape, np.uint16 if isinstance(settings, MixupSettings) else np.uint8


@dataclasses.dataclass(frozen=True)
class _Massive:
    """The paper's scheme."""

    hands: LabeledImageSet
    backgrounds: Backgrounds
    settings: AugmentationSettings

    def variants(self, i: int) -> list[Augmented]:
        hand = cut_out(*self.hands.read(i), self.settings)
        image_id = self.hands.items[i].id
        return [
            augment(image_id, hand, variant, self.backgrounds, self.settings)
            for variant in range(self.settings.n_variants)
        ]


class _Method(Protocol):
    @property
    def originals(self) -> Originals: ...

    def make(self, i: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[dict[str, object]]]: ...


@dataclasses.dataclass(frozen=True)
class _Compared:
    """One of the schemes that the paper compares with."""

    method: _Method
    settings: ComparedSettings

    def variants(self, i: int) -> list[Augmented]:
        image_id = self.method.originals.ids[i]
        made = []
        for variant in range(self.settings.n_variants):
            seed = image_seed(image_id, variant, self.settings.seed)
            image, mask, done = self.method.make(i, np.random.default_rng(seed))
            recipe = {
                "source": image_id,
                "variant": variant,
                "seed": seed,
                "operations": done,
                "digest": hashlib.sha256(image.tobytes() + mask.tobytes()).hexdigest(),
            }
            made.append(Augmented(image, mask, recipe))
        return made


def _method(hands: LabeledImageSet, settings: ComparedSettings) -> _Method:
    if isinstance(settings, FlipRotateCropSettings):
        factor = settings.supersampling
        return FlipRotateCrop(Originals.of(hands, settings.width * factor, settings.height * factor), settings)
    originals = Originals.of(hands, settings.width, settings.height)
    if isinstance(settings, CutoutSettings):
        return Cutout(originals, settings)
    if isinstance(settings, MixupSettings):
        return Mixup(originals, settings)
    assert isinstance(settings, FlipRotate90Settings)
    return FlipRotate90(originals, settings)
