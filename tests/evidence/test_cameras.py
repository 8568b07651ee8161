"""``evidence.cameras``: figures are printed, refused images are counted apart, and a lost half pixel shows."""

import dataclasses

import pytest

from evidence import cameras


@pytest.fixture
def figures(monkeypatch, capsys):
    monkeypatch.setattr(cameras, "BOARDS", cameras.BOARDS[:1])
    monkeypatch.setattr(cameras, "LENSES", {"pinhole": cameras.LENSES["pinhole"]})

    def run():
        assert cameras.main(["--count", "2"]) == 0
        lines = [line.split(": ") for line in capsys.readouterr().out.splitlines()]
        return {line[0]: float(line[1]) for line in lines if len(line) == 2}

    return run


def test_errors_of_located_cameras_and_refusals_are_counted(figures, monkeypatch):
    found = figures()
    assert (found["board_images"], found["board_images_refused"]) == (2, 0)
    assert 0 < found["board_pose_error_mm"] < 3
    assert 0 < found["board_pose_error_deg"] < 0.3
    model_of = cameras.model_of

    def without_conversion(*given):
        model = model_of(*given)
        return dataclasses.replace(model, cx=model.cx - 0.5, cy=model.cy - 0.5)

    monkeypatch.setattr(cameras, "model_of", without_conversion)
    assert figures()["board_pose_error_deg"] > found["board_pose_error_deg"] + 0.01
