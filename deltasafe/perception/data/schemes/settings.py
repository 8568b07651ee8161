"""Settings of the compared augmentation schemes, importable without OpenCV."""

import dataclasses
from typing import TypeAlias

from deltasafe.perception.data.augmentation.settings import AugmentationSettings
from deltasafe.setting_ranges import check_range


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
        check_range(self, "[1, inf)", "n_variants")
        check_range(self, "[32, inf)", "width", "height")
        check_range(self, "[0, inf)", "seed")


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
        check_range(self, "(0, 1]", "side")


@dataclasses.dataclass(frozen=True)
class MixupSettings(ComparedSettings):
    """Mixup (Zhang et al. 2018).

    Attributes:
        alpha: lambda is drawn from Beta(alpha, alpha). The authors use 0.1 to 0.4 on ImageNet and 1 on CIFAR.
    """

    alpha: float = 0.4

    def __post_init__(self) -> None:
        super().__post_init__()
        check_range(self, "(0, inf)", "alpha")


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
        check_range(self, "[1, inf)", "supersampling")
        check_range(self, "[0, 180]", "largest_angle_deg")
        check_range(self, "(0, 1]", "smallest_crop")


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
