"""What can be chosen about the augmentation."""

import dataclasses

from deltasafe.errors import SettingsError

__all__ = ["METHOD_NAMES", "AugmentationSettings"]

METHOD_NAMES = (
    "background",
    "flip",
    "rotation",
    "grid_distortion",
    "cropping",
    "color",
    "noise",
    "random_erase",
)


@dataclasses.dataclass(frozen=True)
class AugmentationSettings:
    """How each original becomes many images (section III-C of the paper; decision 8).

    Attributes:
        n_variants: new images for each original; the originals themselves are not among them.
        width: columns of the stored images, in pixels.
        height: rows of the stored images, in pixels.
        probability: chance of each of the seven methods that follow the background, independently.
        supersampling: geometry and composition happen at this multiple of the stored size, and are reduced by
            area.
        left_out: names of methods that are never applied, for ablations; leaving one out changes nothing in
            the draws
            of the others.
        seed: of the whole set; each image's own seed is a hash of it, the original's id and the variant's
            number.
    """

    n_variants: int = 20
    width: int = 192
    height: int = 144
    probability: float = 0.5
    supersampling: int = 2
    left_out: tuple[str, ...] = ()
    seed: int = 0

    def __post_init__(self) -> None:
        object.__setattr__(self, "left_out", tuple(self.left_out))
        for name, least in (
            ("n_variants", 1),
            ("width", 32),
            ("height", 32),
            ("supersampling", 1),
            ("seed", 0),
        ):
            value = getattr(self, name)
            if value < least:
                raise SettingsError(f"{name} is {value}; choose at least {least}")
        if not 0.0 <= self.probability <= 1.0:
            raise SettingsError(f"probability is {self.probability}; choose a number from 0 to 1 (the paper: 0.5)")
        unknown = sorted(set(self.left_out) - set(METHOD_NAMES))
        if unknown:
            raise SettingsError(f"left_out holds {unknown}; the methods are {', '.join(METHOD_NAMES)}")
