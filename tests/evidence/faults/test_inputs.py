"""A share of the cases of ``python -m evidence.faults.inputs``: all kinds that need no network."""

import pathlib
import shutil
import tempfile
from collections.abc import Iterator

import pytest

from evidence.faults.inputs import refused_though_sound, try_all
from evidence.faults.judging import Case, Door, judge
from evidence.faults.malformed.documents import document_spoils
from evidence.faults.malformed.files import at
from evidence.faults.malformed.pictures import hand_cases, picture_cases
from evidence.faults.malformed.scenes import copied_scene, scene_cases
from pipelines.home import DATASETS


@pytest.fixture(scope="module")
def home() -> Iterator[pathlib.Path]:
    """Below no folder that only its owner may enter, for what is read without privileges."""
    folder = pathlib.Path(tempfile.mkdtemp(prefix="deltasafe-faults-"))
    folder.chmod(0o755)
    yield folder
    shutil.rmtree(folder)


def test_pictures_and_hand_sets_are_refused_by_name(home: pathlib.Path) -> None:
    cases = [*hand_cases(home, DATASETS), *picture_cases(home, DATASETS, home / "no-ensemble")]
    assert len(cases) > 150
    assert refused_though_sound(cases, home) == []
    assert [failure.words for failure in try_all(cases, home, seed=1)] == []


def test_scenes_are_refused_by_name(home: pathlib.Path) -> None:
    cases = scene_cases(copied_scene(home, DATASETS))
    assert len(cases) > 300
    assert refused_though_sound(cases, home) == []
    assert [failure.words for failure in try_all(cases[::3], home, seed=1)] == []


def test_the_judge_finds_what_it_looks_for(tmp_path: pathlib.Path) -> None:
    sound = tmp_path / "sound.json"
    sound.write_text('{"a": 1}')
    door_of = {
        "untyped": _door(sound, KeyError("a")),
        "unnamed": _door(sound, _refusal("is wrong")),
        "left": _door(sound, _refusal("sound.json: is wrong; restore it"), leaves=True),
    }
    spoil = at("", document_spoils()["null"])
    for kind, door in door_of.items():
        assert {failure.kind for failure in judge(Case("null", door, spoil), 0, tmp_path)} == {kind}
    accepting = Door("json", sound, lambda given, out: None)
    assert "was accepted" in judge(Case("null", accepting, spoil), 0, tmp_path)[0].words
    assert sound.read_text() == '{"a": 1}'


def _refusal(words: str) -> Exception:
    from deltasafe.errors import DeltasafeError

    return DeltasafeError(words)


def _door(sound: pathlib.Path, error: Exception, leaves: bool = False) -> Door:
    def read(given: pathlib.Path, out: pathlib.Path) -> None:
        if leaves:
            (out / "half").write_text("of it")
        raise error

    return Door("json", sound, read)
