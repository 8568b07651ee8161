"""Masks between no and yes: 16-bit fixed point, 65535 = certainly hand."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["CERTAIN", "hand_share"]

CERTAIN = np.uint16(65535)


def hand_share(masks: NDArray[np.generic]) -> NDArray[np.float32]:
    """float32 in [0, 1]: how much of each pixel is hand, of masks that are hard (uint8, 0 or 1) or soft (uint16)."""
    share = masks.astype(np.float32)
    return share / np.float32(CERTAIN) if masks.dtype == np.uint16 else share
