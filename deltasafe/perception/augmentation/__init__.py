"""Massive augmentation (section III-C of the paper): eight methods on image and mask together.

`augment` makes one new image; `deltasafe.perception.augmented_set` makes and stores them all.
"""

from deltasafe.perception.augmentation.background import Backgrounds, draw_background
from deltasafe.perception.augmentation.cutout import Arm, CutOut
from deltasafe.perception.augmentation.scheme import Augmented, augment, chosen_methods, cut_out, image_seed
from deltasafe.perception.augmentation.settings import METHOD_NAMES, AugmentationSettings

__all__ = [
    "METHOD_NAMES",
    "Arm",
    "AugmentationSettings",
    "Augmented",
    "Backgrounds",
    "CutOut",
    "augment",
    "chosen_methods",
    "cut_out",
    "draw_background",
    "image_seed",
]
