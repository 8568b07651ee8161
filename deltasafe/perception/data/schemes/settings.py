"""Settings of the compared augmentation schemes, importable without OpenCV."""

import dataclasses
import math
from typing import TypeAlias

from deltasafe.errors import SettingsError
from deltasafe.perception.data.augmentation.settings import AugmentationSettings, check_minimum


@dataclasses.dataclass(frozen=True)
class ComparedSettings:
    """Settings that all compared schemes have.

    Attributes:
        n_variants: new images per original.
        width: columns of the size to which originals are reduced, in pixels.
        height: rows of that size.
        seed: of the whole set. Each image has its own seed: a hash of this one, the id of the original and the
            number of the variant.
    """

    n_variants: int = 20
    width: int = 192
    height: int = 144
    seed: int = 0

    def __post_init__(self) -> None:
        check_minimum(self, n_variants=1, width=32, height=32, seed=0)


@dataclasses.dataclass(frozen=True)
class CutoutSettings(ComparedSettings):
    """Cutout (DeVries and Taylor 2017).

    Attributes:
        side: of the square, as a fraction of the shorter side of the image. 0.5 is the authors' 16 of 32 pixels on
            CIFAR-10, 0.25 their 8 of 32 pixels on CIFAR-100.
    """

    side: float = 0.5

    def __post_init__(self) -> None:
        super().__post_init__()
        if not 0.0 < self.side <= 1.0:
            raise SettingsError(f"side is {self.side}; choose a fraction of the shorter side in (0, 1]")


@dataclasses.dataclass(frozen=True)
class MixupSettings(ComparedSettings):
    """Mixup (Zhang et al. 2018).

    Attributes:
        alpha: lambda is drawn from Beta(alpha, alpha). The authors use 0.1 to 0.4 on ImageNet and 1 on CIFAR.
    """

    alpha: float = 0.4

    def __post_init__(self) -> None:
        super().__post_init__()
        if not (math.isfinite(self.alpha) and self.alpha > 0):
            raise SettingsError(f"alpha is {self.alpha}; choose a positive number (the authors: 0.1 to 1)")


@dataclasses.dataclass(frozen=True)
class FlipRotate90Settings(ComparedSettings):
    """Flip and 90 degree rotation (Nanni et al. 2021): no parameters, at most 8 different variants per original."""


@dataclasses.dataclass(frozen=True)
class FlipRotateCropSettings(ComparedSettings):
    """Flip, rotation and crop (Uzun et al. 2021; their ranges are not published, see decision 9).

    Attributes:
        largest_angle_deg: the angle is uniform between minus and plus this value.
        smallest_crop: the crop's side, as a fraction of the image's, is uniform between this value and 1.
        supersampling: originals are transformed at this multiple of the stored size and downsampled by area.
    """

    largest_angle_deg: float = 30.0
    smallest_crop: float = 0.7
    supersampling: int = 2

    def __post_init__(self) -> None:
        super().__post_init__()
        check_minimum(self, supersampling=1)
        if not 0.0 <= self.largest_angle_deg <= 180.0:
            raise SettingsError(f"largest_angle_deg is {self.largest_angle_deg}; choose 0 to 180")
        if not 0.0 < self.smallest_crop <= 1.0:
            raise SettingsError(f"smallest_crop is {self.smallest_crop}; choose a fraction of the side in (0, 1]")


SchemeSettings: TypeAlias = AugmentationSettings | ComparedSettings

SCHEMES: dict[str, type[AugmentationSettings] | type[ComparedSettings]] = {
    "cutout": CutoutSettings,
    "mixup": MixupSettings,
    "flip_rotate90": FlipRotate90Settings,
    "flip_rotate_crop": FlipRotateCropSettings,
    "ours": AugmentationSettings,
}
"""Settings class by name of the scheme, in the order of the paper's tables."""


def scheme_name(settings: SchemeSettings) -> str:
    """Name of the scheme to which ``settings`` belong."""
    return next(name for name, kind in SCHEMES.items() if type(settings) is kind)
