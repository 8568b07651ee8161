"""Images of a camera as the loop takes them, and the reasons to refuse one."""

import dataclasses
import hashlib
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

LEAST_CONTRAST = 8
"""Gray levels between the darkest and the brightest value of an image: a covered lens shows less."""


@dataclasses.dataclass(frozen=True)
class Frame:
    """An image (H, W, 3) uint8 and the time of its capture on the control's clock."""

    captured_s: float
    rgb: NDArray[np.uint8]


class FrameSource(Protocol):
    """A camera, or what stands in for one."""

    def newest(self, now_s: float) -> Frame | None:
        """Return the newest image that has arrived by a time; None: there is none yet. Older ones are dropped."""
        ...


class FrameCheck:
    """Decides whether an image may be used: a new one, of this camera, that shows something."""

    def __init__(self, height: int, width: int, max_ahead_s: float) -> None:
        self._shape, self._max_ahead_s = (height, width, 3), max_ahead_s
        self._captured_s, self._digest = -np.inf, b""

    def is_new(self, frame: Frame) -> bool:
        """Whether the image is another one than the last that was checked."""
        return frame.captured_s != self._captured_s

    def defect(self, frame: Frame, now_s: float) -> str:
        """Return why the image must not be used, or an empty string."""
        if not abs(frame.captured_s) < np.inf:
            return f"the image's time is {frame.captured_s}"
        if frame.captured_s > now_s + self._max_ahead_s:
            return f"the image is {frame.captured_s - now_s:.2f} s ahead of the clock"
        if frame.captured_s < self._captured_s:
            return f"the image is {self._captured_s - frame.captured_s:.2f} s older than the one before it"
        if frame.rgb.shape != self._shape or frame.rgb.dtype != np.uint8:
            return f"the image has the shape {frame.rgb.shape} of {frame.rgb.dtype}, not {self._shape} of uint8"
        if int(frame.rgb.max()) - int(frame.rgb.min()) < LEAST_CONTRAST:
            return "the image shows nothing: all its pixels are alike"
        digest = hashlib.sha256(frame.rgb.tobytes()).digest()
        repeats, self._captured_s, self._digest = digest == self._digest, frame.captured_s, digest
        return "the image repeats the one before it to the last bit: the camera is frozen" if repeats else ""
