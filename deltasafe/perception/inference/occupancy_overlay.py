"""Overlay of p_occupied on its image."""

import numpy as np
from numpy.typing import NDArray

_TINT = np.array([255.0, 120.0, 0.0])


def occupancy_overlay(rgb: NDArray[np.uint8], p_occupied: NDArray[np.float32], delta: float) -> NDArray[np.uint8]:
    """Tint an image by p_occupied, and draw the border of the region with p_occupied > ``delta`` in white.

    Args:
        rgb: (H, W, 3) uint8.
        p_occupied: (H, W) float32.

    Returns:
        (H, W, 3) uint8.
    """
    weight = 0.65 * p_occupied[..., None].astype(np.float64)
    tinted = rgb * (1 - weight) + _TINT * weight
    unsafe = p_occupied > delta
    inner = unsafe.copy()
    inner[1:] &= unsafe[:-1]
    inner[:-1] &= unsafe[1:]
    inner[:, 1:] &= unsafe[:, :-1]
    inner[:, :-1] &= unsafe[:, 1:]
    tinted[unsafe & ~inner] = 255.0
    return np.round(tinted).astype(np.uint8)
