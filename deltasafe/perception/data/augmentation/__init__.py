"""Massive augmentation (section III-C of the paper): eight methods that transform image and mask together.

`augment.augment` makes one new image; `deltasafe.perception.data.augmented_set` makes and stores all of them.
"""

from deltasafe.perception.data.augmentation.settings import METHOD_NAMES, AugmentationSettings

__all__ = ["METHOD_NAMES", "AugmentationSettings"]
