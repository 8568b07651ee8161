"""Generation of all variants of one original, for every scheme; each image has its own seed."""

import functools
from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from deltasafe.perception.data.augmentation import AugmentationSettings
from deltasafe.perception.data.augmentation.augment import AugmentedImage, augment, cut_out_hand, image_seed
from deltasafe.perception.data.augmentation.background import Backgrounds
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.data.schemes.cutout import cutout
from deltasafe.perception.data.schemes.flip_rotate90 import flip_rotate90
from deltasafe.perception.data.schemes.flip_rotate_crop import flip_rotate_crop
from deltasafe.perception.data.schemes.mixup import mixup
from deltasafe.perception.data.schemes.originals import MAX_PIXELS, Originals, Variant
from deltasafe.perception.data.schemes.settings import ComparedSettings, SchemeSettings, scheme_name

VariantGenerator: TypeAlias = Callable[[int], list[AugmentedImage]]
"""Returns all variants of the original with this index, always the same bytes, in any process and any order."""

_METHODS: dict[str, Callable[[Originals, int, Any, np.random.Generator], Variant]] = {
    "cutout": cutout,
    "mixup": mixup,
    "flip_rotate90": flip_rotate90,
    "flip_rotate_crop": flip_rotate_crop,
}


def variant_generator(images: LabeledImageSet, backgrounds: Backgrounds, settings: SchemeSettings) -> VariantGenerator:
    """Create the generator of a scheme; only our scheme uses ``backgrounds``.

    Raises:
        DataError: an original is defective.
    """
    if isinstance(settings, AugmentationSettings):
        return functools.partial(_our_variants, images, backgrounds, settings)
    scale = getattr(settings, "supersampling", 1)
    originals = Originals.load(images, settings.width * scale, settings.height * scale)
    return functools.partial(_compared_variants, originals, settings)


def size_and_mask_dtype(settings: SchemeSettings) -> tuple[tuple[int, int], type[np.uint8] | type[np.uint16]]:
    """Rows and columns of the stored images, and the dtype of their masks: uint16 for soft masks."""
    side = max(settings.height, settings.width)
    size = (side, side) if scheme_name(settings) == "flip_rotate90" else (settings.height, settings.width)
    return size, np.uint16 if scheme_name(settings) == "mixup" else np.uint8


def _our_variants(
    images: LabeledImageSet, backgrounds: Backgrounds, settings: AugmentationSettings, i: int
) -> list[AugmentedImage]:
    hand, image_id = cut_out_hand(*images.read(i, MAX_PIXELS), settings), images.items[i].id
    return [augment(image_id, hand, variant, backgrounds, settings) for variant in range(settings.n_variants)]


def _compared_variants(originals: Originals, settings: ComparedSettings, i: int) -> list[AugmentedImage]:
    method, image_id, variants = _METHODS[scheme_name(settings)], originals.ids[i], []
    for variant in range(settings.n_variants):
        seed = image_seed(image_id, variant, settings.seed)
        image, mask, operations = method(originals, i, settings, np.random.default_rng(seed))
        recipe = {"source": image_id, "variant": variant, "seed": seed, "operations": operations}
        variants.append(AugmentedImage.with_digest(image, mask, recipe))
    return variants
