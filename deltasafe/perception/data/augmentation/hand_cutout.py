"""The hand cut out of its image, with the arm to be continued beyond the image border."""

import dataclasses

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.arm import Arm
from deltasafe.perception.data.labeled_pair import resize_labeled

_SECOND_HAND = 0.1
"""Fingers have 3 to 6 % of a hand's pixels."""


@dataclasses.dataclass(frozen=True)
class HandCutout:
    """A hand without its background.

    Attributes:
        rgb: ``(H, W, 3)`` float32 in [0, 1]. Pixels outside the hand have the color of the nearest pixel inside, so
            that blending at the edge leaves no rim of the old background.
        alpha: ``(H, W)`` float32 in [0, 1], the hand's coverage of each pixel.
        smooth_rgb: ``rgb`` blurred, for the continued arm: repeating one sharp line of pixels would look streaked.
        background: ``(H, W, 3)`` float32, the image with the hand filled in from the pixels around it.
        center, extent: ``(2,)`` center and size of the hand's bounding box, x and y in pixels; those of the image if it
            shows no hand.
        arm: where the arm leaves the image, or None.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    smooth_rgb: np.ndarray
    background: np.ndarray
    center: np.ndarray
    extent: np.ndarray
    arm: Arm | None

    @classmethod
    def from_image(cls, rgb: np.ndarray, mask: np.ndarray, width: int, height: int) -> "HandCutout":
        """Cut the hand out of ``rgb`` (H, W, 3) uint8 by its ``mask`` (H, W), for a canvas of the given size.

        An image larger than the canvas is first downsampled by area to the smallest size that covers the canvas.
        """
        scale = max(width / rgb.shape[1], height / rgb.shape[0])
        if scale < 1.0:
            size = (round(rgb.shape[1] * scale), round(rgb.shape[0] * scale))
            rgb, mask = resize_labeled(rgb, mask, size, cv2.INTER_AREA)
        labeled = np.ascontiguousarray(mask, np.uint8)
        mask = _without_severed_parts(labeled)
        color = rgb.astype(np.float32) / 255.0
        ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
        inner = cv2.erode(cv2.copyMakeBorder(mask, 3, 3, 3, 3, cv2.BORDER_REPLICATE), ellipse)[3:-3, 3:-3]
        # removed parts are not background either: left visible, they would be hand that is labeled free
        outer = 1 - cv2.dilate(cv2.copyMakeBorder(labeled, 3, 3, 3, 3, cv2.BORDER_REPLICATE), ellipse)[3:-3, 3:-3]
        alpha = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.6, borderType=cv2.BORDER_REPLICATE)
        ys, xs = np.nonzero(mask)
        low, high = (
            ((xs.min(), ys.min()), (xs.max(), ys.max())) if xs.size else ((0, 0), np.array(mask.shape[::-1]) - 1)
        )
        hand = _filled(color, inner if inner.any() else mask)
        filled = cv2.GaussianBlur(_filled(color, outer), (0, 0), 6.0) if outer.any() else color
        background = np.where(outer[..., None] > 0, color, filled)
        arm = Arm.from_mask(mask)
        smooth = hand if arm is None else cv2.GaussianBlur(hand, (0, 0), max(0.07 * arm.width_px, 0.5))
        return cls(hand, alpha, smooth, background, np.add(low, high) / 2, np.subtract(high, low) + 1, arm)

    def focus(self, crop_px: np.ndarray) -> np.ndarray:
        """Return the point ``(2,)`` that a crop of the image should show in its middle.

        It is the center of the bounding box. Where the box is larger than the crop, the end opposite to the arm is
        shown, because a forearm may be longer than the crop.
        """
        if self.arm is None:
            return self.center
        return self.center - np.sign(self.arm.direction) * np.maximum(self.extent - crop_px, 0) / 2


def _without_severed_parts(mask: np.ndarray) -> np.ndarray:
    """Remove small parts that the image border has cut off from the hand: a moved hand would not join them again.

    A part with at least ``_SECOND_HAND`` of the largest part's pixels is another hand, and stays.
    """
    n_labels, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if n_labels <= 2:
        return mask
    main = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    at_border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    areas = stats[:, cv2.CC_STAT_AREA]
    severed = [label for label in at_border if label > 0 and areas[label] < _SECOND_HAND * areas[main]]
    return np.where(np.isin(labels, severed), 0, mask).astype(np.uint8)


def _filled(color: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Give each pixel outside ``known`` the color of the nearest known pixel, blurred."""
    if not known.any():
        return color
    _, labels = cv2.distanceTransformWithLabels(1 - known, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    color_of_label = np.zeros((int(labels.max()) + 1, 3), np.float32)
    color_of_label[labels[known > 0]] = color[known > 0]
    return np.where(known[..., None] > 0, color, cv2.blur(color_of_label[labels], (3, 3)))
