"""Settings of the conversion of labels."""

import dataclasses

from deltasafe.errors import SettingsError

FORMATS = ("auto", "coco", "labelme", "cvat", "cvat-masks", "label-studio", "voc", "roboflow", "folder")


@dataclasses.dataclass(frozen=True)
class ImportSettings:
    """What the labels of a source mean.

    Attributes:
        format: of the source; ``auto`` recognizes it by its files.
        classes: that are the obstacle: names, or gray values (255) and colors (#ff0000) of masks without names; * takes
            all. Empty: the only class that the source has.
        threshold: of soft masks, a fraction of full scale; pixels at or above it are obstacle. 0 refuses soft masks.
        alpha: the alpha channel of the mask files is the mask.
        inverted: the mask files mark the background.
        large_masks: accept masks that cover most of the image or nearly its whole border.
        keep_unlabeled: take images without any annotation as images without the obstacle, instead of skipping them.
        images, masks: folders of images and masks below the source, for the format ``folder``; empty searches them.
    """

    format: str = "auto"
    classes: tuple[str, ...] = ()
    threshold: float = 0.0
    alpha: bool = False
    inverted: bool = False
    large_masks: bool = False
    keep_unlabeled: bool = False
    images: str = ""
    masks: str = ""

    def __post_init__(self) -> None:
        if self.format not in FORMATS:
            raise SettingsError(f"format must be one of {', '.join(FORMATS)}, got {self.format!r}")
        if not 0 <= self.threshold <= 1:
            raise SettingsError(f"threshold must lie in [0, 1], got {self.threshold}")
        if self.threshold and self.classes:
            raise SettingsError("give either threshold or classes: a soft mask has a single class")
