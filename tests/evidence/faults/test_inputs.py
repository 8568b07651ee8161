"""``evidence.faults.inputs`` with the kinds that need no network, and proof that it detects wrong rejections."""

import pathlib
from collections.abc import Iterator

import numpy as np
import pytest

from deltasafe.errors import DeltasafeError
from evidence.faults import welcome
from evidence.faults.inputs import check_all, named_hands, rejected_valid_inputs
from evidence.faults.malformed.documents import document_changes
from evidence.faults.malformed.files import at
from evidence.faults.malformed.labels import label_cases
from evidence.faults.malformed.pictures import hand_cases, picture_cases
from evidence.faults.malformed.scenes import copied_scene, scene_cases
from evidence.faults.rejection import Case, InputKind, check_rejection
from evidence.faults.welcome import wrong_welcomes
from evidence.fixtures import temporary_home


@pytest.fixture(scope="module")
def home() -> Iterator[pathlib.Path]:
    with temporary_home() as folder:  # pytest's own folders are closed to unprivileged users
        yield folder


def test_malformed_images_and_hand_sets_are_rejected(home: pathlib.Path) -> None:
    cases = [*hand_cases(home), *picture_cases(home, home / "no-ensemble")]
    assert len(cases) > 150
    assert rejected_valid_inputs(cases, home) == []
    assert [failure.text for failure in check_all(cases, home, seed=1)] == []


def test_malformed_labels_of_other_tools_are_rejected(home: pathlib.Path) -> None:
    cases = label_cases(home)
    assert len(cases) > 120
    assert rejected_valid_inputs(cases, home) == []
    assert [failure.text for failure in check_all(cases[::4], home, seed=1)] == []


def test_inputs_as_people_have_them_are_accepted(home: pathlib.Path) -> None:
    n_welcome, wrong = wrong_welcomes(home, named_hands(home))
    assert n_welcome > 40
    assert wrong == []


def test_welcome_inputs_with_other_pixels_are_detected(home: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(welcome, "read_rgb", lambda path: np.zeros((288, 384, 3), np.uint8))
    hands = named_hands(home / "again")
    wrong = wrong_welcomes(home / "again", hands)[1]
    assert [text for text in wrong if "image: PNG: gives other pixels" in text]


def test_malformed_scenes_are_rejected(home: pathlib.Path) -> None:
    cases = scene_cases(copied_scene(home))
    assert len(cases) > 300
    assert rejected_valid_inputs(cases, home) == []
    assert [failure.text for failure in check_all(cases[::3], home, seed=1)] == []


def test_malformed_calibrations_and_bags_are_rejected(home: pathlib.Path) -> None:
    pytest.importorskip("rosbags")
    from evidence.faults.malformed.cameras import bag_cases, camera_cases

    cases = [*camera_cases(home), *bag_cases(home)]
    assert len(cases) > 150
    assert rejected_valid_inputs(cases, home) == []
    assert [failure.text for failure in check_all(cases[::3], home, seed=1)] == []


def test_wrong_rejections_are_detected(tmp_path: pathlib.Path) -> None:
    valid = tmp_path / "valid.json"
    valid.write_text('{"a": 1}')

    def failures(error: Exception | None, leaves: bool = False) -> list[str]:
        def read(given: pathlib.Path, out: pathlib.Path) -> None:
            if leaves:
                (out / "half").write_text("of it")
            if error is not None:
                raise error

        case = Case("null", InputKind("json", valid, read), at("", document_changes()["null"]))
        return sorted({failure.kind for failure in check_rejection(case, 0, tmp_path)})

    named = DeltasafeError("valid.json: is wrong; restore it")
    assert failures(named) == []
    assert failures(None) == ["untyped"]
    assert failures(KeyError("a")) == ["untyped"]
    assert failures(DeltasafeError("is wrong; restore it")) == ["unnamed"]
    assert failures(DeltasafeError("valid.json: is wrong")) == ["unnamed"]
    assert failures(named, leaves=True) == ["left"]
    assert valid.read_text() == '{"a": 1}', "only copies are corrupted"
