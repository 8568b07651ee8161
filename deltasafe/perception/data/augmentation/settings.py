"""Settings of the augmentation, importable without OpenCV."""

import dataclasses

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_range

METHOD_NAMES = ("background", "flip", "rotation", "grid_distortion", "cropping", "color", "noise", "random_erase")
HAND_PARTS = ("skin_tones", "clothing")
"""Parts of the methods ``color`` and ``background`` that suit hands alone."""


@dataclasses.dataclass(frozen=True)
class AugmentationSettings:
    """How the augmentation makes new images from each original (section III-C of the paper; decision 8).

    Attributes:
        n_variants: new images per original; the originals themselves are not part of the augmented set.
        width: columns of the stored images, in pixels.
        height: rows of the stored images, in pixels.
        probability: probability of each of the seven methods after the background; the draws are independent.
        supersampling: images are composed at this multiple of the stored size and then downsampled by area.
        left_out: names of methods that are never applied, for ablations. The random draws of the other methods
            do not change. ``skin_tones`` (then the object keeps about its own color) and ``clothing`` (sleeves, straps
            and rings) leave out parts that suit hands alone; they are left out for every other obstacle.
        seed: of the whole set. Each image has its own seed: a hash of this one, the id of the original and the
            number of the variant.
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
        check_range(self, "[1, inf)", "n_variants", "supersampling")
        check_range(self, "[32, inf)", "width", "height")
        check_range(self, "[0, inf)", "seed")
        check_range(self, "[0, 1]", "probability")
        known = (*METHOD_NAMES, *HAND_PARTS)
        if unknown := sorted(set(self.left_out) - set(known)):
            raise SettingsError(f"left_out holds {unknown}; the methods are {', '.join(known)}")

    def without_hand_parts(self) -> "AugmentationSettings":
        """Leave out what suits hands alone."""
        return dataclasses.replace(self, left_out=tuple(dict.fromkeys((*self.left_out, *HAND_PARTS))))
