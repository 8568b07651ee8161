"""What can be chosen about the compared augmentation schemes; free of OpenCV, so that a pipeline can name them."""

import dataclasses
import math
from typing import TypeAlias

from deltasafe.errors import SettingsError
from deltasafe.perception.data.augmentation.settings import AugmentationSettings

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


@dataclasses.dataclass(frozen=True)
class ComparedSettings:
    """What the compared schemes have in common.

    Attributes:
        n_variants: new images for each original.
        width: columns of the size that originals are reduced to, in pixels.
        height: rows of that size.
        seed: of the whole set; each image's own seed is a hash of it, the original's id and the variant's number.
    """

    n_variants: int = 20
    width: int = 192
    height: int = 144
    seed: int = 0

    def __post_init__(self) -> None:
        for name, least in (("n_variants", 1), ("width", 32), ("height", 32), ("seed", 0)):
            if getattr(self, name) < least:
                raise SettingsError(f"{name} is {getattr(self, name)}; choose at least {least}")


@dataclasses.dataclass(frozen=True)
class CutoutSettings(ComparedSettings):
    """Cutout (DeVries and Taylor 2017).

    Attributes:
        side: of the square, as a share of the shorter side of the image: 0.5 is the 16 of 32 pixels that the
            authors use on CIFAR-10, 0.25 their 8 of 32 on CIFAR-100.
    """

    side: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.side <= 1.0:
            raise SettingsError(f"side is {self.side}; choose a share of the shorter side in (0, 1]")


@dataclasses.dataclass(frozen=True)
class MixupSettings(ComparedSettings):
    """Mixup (Zhang et al. 2018).

    Attributes:
        alpha: lambda is drawn from Beta(alpha, alpha). The authors use 0.1 to 0.4 on photographs (ImageNet) and 1
            on CIFAR.
    """

    alpha: float = 0.4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.alpha) and self.alpha > 0):
            raise SettingsError(f"alpha is {self.alpha}; choose a positive number (the authors: 0.1 to 1)")


@dataclasses.dataclass(frozen=True)
class FlipRotate90Settings(ComparedSettings):
    """Flip and 90 degree rotation (Nanni et al. 2021): nothing to choose, at most 8 variants an original."""


@dataclasses.dataclass(frozen=True)
class FlipRotateCropSettings(ComparedSettings):
    """Flip, rotation and crop (Uzun et al. 2021, whose ranges are not known; decision 9).

    Attributes:
        largest_angle_deg: the angle is uniform between minus and plus this.
        smallest_crop: the cropped share of each side is uniform between this and 1.
        supersampling: originals are transformed at this multiple of the stored size and reduced by area.
    """

    largest_angle_deg: float = 30.0
    smallest_crop: float = 0.7
    supersampling: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 <= self.largest_angle_deg <= 180.0:
            raise SettingsError(f"largest_angle_deg is {self.largest_angle_deg}; choose 0 to 180")
        if not 0.0 < self.smallest_crop <= 1.0:
            raise SettingsError(f"smallest_crop is {self.smallest_crop}; choose a share of the side in (0, 1]")
        if self.supersampling < 1:
            raise SettingsError(f"supersampling is {self.supersampling}; choose at least 1")


SchemeSettings: TypeAlias = AugmentationSettings | ComparedSettings

SCHEMES: dict[str, type[AugmentationSettings] | type[ComparedSettings]] = {
    "cutout": CutoutSettings,
    "mixup": MixupSettings,
    "flip_rotate90": FlipRotate90Settings,
    "flip_rotate_crop": FlipRotateCropSettings,
    "ours": AugmentationSettings,
}
"""Settings by the name of the scheme, in the order of the paper's tables."""


def scheme_of(settings: SchemeSettings) -> str:
    """Name of the scheme that ``settings`` are of."""
    return next(name for name, kind in SCHEMES.items() if type(settings) is kind)
