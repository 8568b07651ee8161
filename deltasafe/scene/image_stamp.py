"""Digest and time of an image, stored with the grids and motions that were computed from it."""

import dataclasses
import hashlib
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError


@dataclasses.dataclass(frozen=True)
class ImageStamp:
    """Identity of an image.

    Attributes:
        image_sha256: of dtype, shape and pixels.
        taken_s: time by the camera's clock; 0 for the image of a logged scene.
    """

    image_sha256: str
    taken_s: float = 0.0

    def __post_init__(self) -> None:
        if len(self.image_sha256) != 64 or not set(self.image_sha256) <= set("0123456789abcdef"):
            raise SettingsError(f"image_sha256 must be 64 hexadecimal digits, got {self.image_sha256!r}")
        if not math.isfinite(self.taken_s):
            raise SettingsError(f"taken_s must be a finite time in seconds, got {self.taken_s}")

    @classmethod
    def of(cls, image: NDArray[np.uint8], taken_s: float = 0.0) -> "ImageStamp":
        """Compute the stamp of an image (H, W, channels)."""
        state = hashlib.sha256(f"{image.dtype.str}{image.shape}".encode())
        state.update(np.ascontiguousarray(image).tobytes())
        return cls(state.hexdigest(), taken_s)
