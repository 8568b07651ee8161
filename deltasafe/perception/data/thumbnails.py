"""Thumbnails of labeled images, which `near_copies` compares."""

import cv2
import numpy as np
from numpy.typing import NDArray

SIDE_PX = 16


def thumbnail(rgb: NDArray[np.uint8], mask: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return (2, 16, 16): the mean gray value and the mean mask of each block of an image (H, W, 3) and mask (H, W)."""
    parts = (cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY), mask * np.uint8(255))
    return np.stack(
        [cv2.resize(part, (SIDE_PX, SIDE_PX), interpolation=cv2.INTER_AREA) for part in parts], dtype=np.float32
    )
