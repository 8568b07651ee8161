"""The augmentation schemes of Tables I and II: ours and the four that the paper compares it with.

Each makes exactly ``n_variants`` new images of every original; `deltasafe.perception.data.augmented_set` stores
them. Settings are at hand without OpenCV; what makes the images lies in `deltasafe.perception.data.schemes.generation`.
"""

from deltasafe.perception.data.schemes.settings import (
    SCHEMES,
    ComparedSettings,
    CutoutSettings,
    FlipRotate90Settings,
    FlipRotateCropSettings,
    MixupSettings,
    SchemeSettings,
    scheme_of,
)

__all__ = [
    "SCHEMES",
    "ComparedSettings",
    "CutoutSettings",
    "FlipRotate90Settings",
    "FlipRotateCropSettings",
    "MixupSettings",
    "SchemeSettings",
    "scheme_of",
]
