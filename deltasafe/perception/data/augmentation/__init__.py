"""Massive augmentation (section III-C of the paper): eight methods on image and mask together.

`augment` makes one new image; `deltasafe.perception.data.augmented_set` makes and stores them all. The settings are
at hand without OpenCV, so that a pipeline can name them; all else is imported when first asked for.
"""

import importlib
from typing import TYPE_CHECKING, Any

from deltasafe.perception.data.augmentation.settings import METHOD_NAMES, AugmentationSettings

if TYPE_CHECKING:
    from deltasafe.perception.data.augmentation.background import Backgrounds, draw_background
    from deltasafe.perception.data.augmentation.cutout import Arm, CutOut
    from deltasafe.perception.data.augmentation.scheme import (
        Augmented,
        augment,
        chosen_methods,
        cut_out,
        image_seed,
    )

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

_HOMES = {"Backgrounds": "background", "draw_background": "background", "Arm": "cutout", "CutOut": "cutout"}


def __getattr__(name: str) -> Any:
    if name in __all__:
        return getattr(importlib.import_module(f"{__name__}.{_HOMES.get(name, 'scheme')}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
