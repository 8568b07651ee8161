"""Frame sources: a webcam by index or URL, a video file, and the images of an MCAP log."""

import pathlib
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.interchange.image_sequence import image_sequence
from deltasafe.online.frames import Frame


class Playback:
    """Images of a recording, at the times of the recording counted from its first image.

    Args:
        frames: time in seconds and image (H, W, 3) uint8 in RGB, in the order of the recording.
        starts_s: control's clock at the first image.
    """

    def __init__(self, frames: Iterator[tuple[float, NDArray[np.uint8]]], starts_s: float = 0.0) -> None:
        self._frames, self._starts_s = frames, starts_s
        self._first_s: float | None = None
        self._shown: Frame | None = None
        self._next: Frame | None = None
        self.has_ended = False

    def newest(self, now_s: float) -> Frame | None:
        """Return the newest image that was recorded by a time; at the end it stays the last one, and grows old."""
        while not self.has_ended and (self._next is None or self._next.captured_s <= now_s):
            self._shown = self._next or self._shown
            try:
                time_s, rgb = next(self._frames)
            except StopIteration:
                self.has_ended = True
                self._next = None
                break
            self._first_s = time_s if self._first_s is None else self._first_s
            self._next = Frame(self._starts_s + time_s - self._first_s, rgb)
        return self._shown


def play_video(path: str | pathlib.Path, starts_s: float = 0.0) -> Playback:
    """Play a video file at its own rate.

    Raises:
        DataError: the file is missing or no video that OpenCV reads.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise DataError(path, "is not a file; give a video file")
    capture = _opened(str(path))
    if capture is None:
        raise DataError(path, "is not a video that OpenCV can read; convert it, for example to MP4 with H.264")
    return Playback(_video_frames(capture), starts_s)


def play_log(path: str | pathlib.Path, topic: str = "", starts_s: float = 0.0) -> Playback:
    """Play the images of an MCAP log at the times of their recording.

    Args:
        topic: of the images; may be omitted if there is only one.

    Raises:
        DataError: the log cannot be read, or the topic is not clear.
        SettingsError: the package mcap is not installed.
    """
    return Playback(image_sequence(path, topic), starts_s)


class Webcam:
    """The newest image of a live camera; a thread reads and drops what the loop does not take.

    The time of an image is that of its arrival, less ``delay_s``: cameras do not say when they exposed it.

    Args:
        camera: index, or URL of a stream.
        clock: control's clock.
        delay_s: from exposure to arrival, measured with a clock in the picture; round up.

    Raises:
        DataError: the camera cannot be opened.
    """

    def __init__(self, camera: int | str, clock: Callable[[], float], delay_s: float = 0.1) -> None:
        self._capture = _opened(camera)
        if self._capture is None:
            raise DataError(str(camera), "cannot be opened as a camera; check index or URL, and who else uses it")
        self._clock, self._delay_s = clock, delay_s
        self._newest: Frame | None = None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._read, daemon=True)
        self._thread.start()

    def newest(self, now_s: float) -> Frame | None:
        """Return the newest image."""
        return self._newest

    def close(self) -> None:
        """Stop reading and release the camera."""
        self._closing.set()
        self._thread.join(timeout=2.0)
        self._capture.release()

    def _read(self) -> None:
        while not self._closing.is_set():
            read, bgr = self._capture.read()
            if not read:  # unplugged: the last image grows old, which brakes the arm
                self._closing.wait(0.05)
                continue
            self._newest = Frame(self._clock() - self._delay_s, _rgb(bgr))


def _opened(source: int | str) -> Any:
    import cv2

    capture = cv2.VideoCapture(source)
    if capture.isOpened():
        return capture
    capture.release()
    return None


def _video_frames(capture: Any) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    import cv2

    rate_hz = capture.get(cv2.CAP_PROP_FPS) or 30.0
    number = 0
    try:
        while True:
            read, bgr = capture.read()
            if not read:
                return
            yield number / rate_hz, _rgb(bgr)
            number += 1
    finally:
        capture.release()


def _rgb(bgr: NDArray[np.uint8]) -> NDArray[np.uint8]:
    return np.ascontiguousarray(bgr[:, :, ::-1])
