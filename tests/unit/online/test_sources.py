"""Frame sources deliver the newest image at a time and drop the others."""

import pathlib
import time

import cv2
import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.interchange.mcap_log import open_log
from deltasafe.online.sources import Playback, Webcam, play_log, play_video


def gray(level: int) -> np.ndarray:
    return np.full((48, 64, 3), level, np.uint8)


def test_playback_drops_what_came_between_and_keeps_the_last_image() -> None:
    played = Playback(iter([(10.0 + 0.1 * n, gray(n)) for n in range(10)]), starts_s=5.0)
    assert played.newest(4.9) is None
    shown = [played.newest(now_s) for now_s in (5.0, 5.05, 5.55, 99.0, 100.0)]
    assert [int(frame.rgb[0, 0, 0]) for frame in shown if frame] == [0, 0, 5, 9, 9]
    assert [frame.captured_s for frame in shown if frame] == pytest.approx([5.0, 5.0, 5.5, 5.9, 5.9])
    assert played.has_ended


def write_video(path: pathlib.Path) -> None:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    if not writer.isOpened():
        pytest.skip("this OpenCV writes no video")
    for level in range(0, 250, 25):
        writer.write(gray(level))
    writer.release()


def test_a_video_is_played_at_its_own_rate(tmp_path: pathlib.Path) -> None:
    write_video(tmp_path / "hand.avi")
    frame = play_video(tmp_path / "hand.avi").newest(0.42)
    assert frame is not None
    assert frame.captured_s == pytest.approx(0.4)
    assert abs(int(frame.rgb.mean()) - 100) < 6


def test_what_is_no_video_is_refused_by_name(tmp_path: pathlib.Path) -> None:
    (tmp_path / "notes.mp4").write_text("no video")
    for name in ("notes.mp4", "missing.mp4"):
        with pytest.raises(DataError, match=name):
            play_video(tmp_path / name)


def test_the_images_of_a_log_are_played_at_the_times_of_recording(tmp_path: pathlib.Path) -> None:
    pytest.importorskip("mcap")
    import base64

    with open_log(tmp_path / "log.mcap") as log:
        for n, topic in enumerate(["/camera", "/camera", "/other", "/camera"]):
            data = base64.b64encode(cv2.imencode(".png", gray(10 * n))[1].tobytes()).decode()
            message = {"frame_id": "camera", "format": "png", "data": data}
            log.write_message(topic, "foxglove.CompressedImage", (7 + n) * 10**9, message)
    played = play_log(tmp_path / "log.mcap", "/camera")
    shown = [played.newest(now_s) for now_s in (0.5, 2.9, 3.0)]
    assert [int(frame.rgb[0, 0, 0]) for frame in shown if frame] == [0, 10, 30]
    with pytest.raises(DataError, match="name the topic"):
        play_log(tmp_path / "log.mcap").newest(9.0)


def test_a_webcam_keeps_the_newest_image_and_names_what_cannot_be_opened(tmp_path: pathlib.Path) -> None:
    write_video(tmp_path / "stream.avi")  # OpenCV opens a file as it opens a URL
    webcam = Webcam(str(tmp_path / "stream.avi"), lambda: 3.0, delay_s=0.2)
    for _ in range(200):
        if webcam.newest(3.0) is not None and int(webcam.newest(3.0).rgb.mean()) > 215:  # type: ignore[union-attr]
            break
        time.sleep(0.01)
    frame = webcam.newest(3.0)
    webcam.close()
    assert frame is not None
    assert frame.captured_s == pytest.approx(2.8)
    assert int(frame.rgb.mean()) > 215  # the last image of the stream
    with pytest.raises(DataError, match="no-such-camera"):
        Webcam(str(tmp_path / "no-such-camera"), lambda: 0.0)
