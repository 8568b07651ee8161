"""Settings of the conversion of labels."""

import dataclasses

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_choice, check_range

FORMATS = ("auto", "coco", "labelme", "cvat", "cvat-masks", "label-studio", "voc", "roboflow", "folder")
RECTANGLES = ("refuse", "fill", "ignore")


@dataclasses.dataclass(frozen=True)
class ImportSettings:
    """What the labels of a source mean.

    Attributes:
        format: of the source; ``auto`` recognizes it by its files.
        classes: that are the obstacle: names, or gray values (255) and colors (#ff0000) of masks without names; * takes
            all. Empty: the only class that the source has.
        obstacle: identifier of what the classes are, for ``dataset.json``. Empty: ``hand`` if the masks have no class
            names or the names say so, else the names of the classes.
        threshold: of soft masks, a fraction of full scale; pixels at or above it are obstacle. 0 refuses soft masks.
        alpha: the alpha channel of the mask files is the mask.
        inverted: the mask files mark the background.
        large_masks: accept masks that cover most of the image or nearly its whole border.
        rectangles: boxes around an object: ``refuse`` skips images that have one of the obstacle, ``fill`` takes them
            as outlines, ``ignore`` uses the other outlines.
        keep_unlabeled: take images without any annotation as images without the obstacle, instead of skipping them.
        images: folder of the images, absolute or relative to the source; empty: they are searched below the source.
        masks: the same for the masks, in the format ``folder``.
        masks_drawn_on: for photographs with an EXIF orientation: ``upright`` if the labels fit the picture as viewers
            show it, ``stored`` if they fit the stored pixels. Empty: ``upright`` for outlines, which tools draw on the
            upright picture; for mask files, what their size says.
    """

    format: str = "auto"
    classes: tuple[str, ...] = ()
    obstacle: str = ""
    threshold: float = 0.0
    alpha: bool = False
    inverted: bool = False
    large_masks: bool = False
    rectangles: str = "refuse"
    keep_unlabeled: bool = False
    images: str = ""
    masks: str = ""
    masks_drawn_on: str = ""

    def __post_init__(self) -> None:
        check_choice(self, FORMATS, "format")
        check_choice(self, RECTANGLES, "rectangles")
        check_choice(self, ("", "upright", "stored"), "masks_drawn_on")
        check_range(self, "[0, 1]", "threshold")
        if self.threshold and self.classes:
            raise SettingsError("give either threshold or classes: a soft mask has a single class")
