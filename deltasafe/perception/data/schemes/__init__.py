"""The augmentation schemes of Tables I and II: ours and the four that the paper compares it with.

Each scheme makes exactly ``n_variants`` new images of every original; `deltasafe.perception.data.augmented_set` stores
them. This package exports the settings, which do not need OpenCV. `generation` makes the images.
"""

from deltasafe.perception.data.schemes.settings import (
    SCHEMES,
    ComparedSettings,
    CutoutSettings,
    FlipRotate90Settings,
    FlipRotateCropSettings,
    MixupSettings,
    SchemeSettings,
    scheme_name,
)

__all__ = [
    "SCHEMES",
    "ComparedSettings",
    "CutoutSettings",
    "FlipRotate90Settings",
    "FlipRotateCropSettings",
    "MixupSettings",
    "SchemeSettings",
    "scheme_name",
]
