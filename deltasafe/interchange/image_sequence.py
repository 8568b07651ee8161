"""All images of a topic of an MCAP log, one after the other: what a live camera would have delivered."""

import pathlib
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError
from deltasafe.interchange.log_content import NS_PER_S
from deltasafe.interchange.mcap_log import image_messages
from deltasafe.interchange.raw_images import compressed_image, raw_image
from deltasafe.io.arrays import READ_ERRORS


def image_sequence(path: str | pathlib.Path, topic: str = "") -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Yield the time of recording in seconds and the image (H, W, 3) uint8 in RGB, in the order of the file.

    Args:
        topic: of the images; may be omitted if the log has images on one topic only.

    Raises:
        DataError: the log is damaged, has no images, or several topics of images and none was named.
        SettingsError: the package mcap is not installed.
    """
    import cv2

    path, chosen = pathlib.Path(path), topic
    if not path.is_file():
        raise DataError(path, "is not a file; give an MCAP log")
    try:
        for on_topic, time_ns, message in image_messages(path, topic):
            chosen = chosen or on_topic
            if on_topic != chosen:
                raise DataError(path, f"has images on {chosen} and {on_topic}; name the topic")
            compressed = compressed_image(path, on_topic, message)
            if compressed is None:
                yield time_ns / NS_PER_S, raw_image(path, on_topic, message)
                continue
            bgr = cv2.imdecode(np.frombuffer(compressed[0], np.uint8), cv2.IMREAD_COLOR)
            if bgr is None:
                raise DataError(path, f"{on_topic} holds an image that cannot be decoded; record it again")
            yield time_ns / NS_PER_S, np.ascontiguousarray(bgr[:, :, ::-1])
    except DataError:
        raise
    except READ_ERRORS as error:
        raise DataError(path, f"is not a readable log ({error!r:.300}); record or export it again") from error
    if not chosen:
        raise DataError(path, "has no images")
