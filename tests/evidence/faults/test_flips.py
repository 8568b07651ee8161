"""``evidence.faults.flips`` with few changes, and proof that it detects parsing and missed changes."""

import pathlib

import pytest

from deltasafe.perception.artifact.frozen_ensemble import load_ensemble
from evidence.faults.flips import EnteredError, change_bytes, exchange_files, flipped, parsers_raise, resized
from evidence.fixtures import tiny_ensemble


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tiny_ensemble(tmp_path_factory.mktemp("ensemble"))


def test_every_change_is_detected_before_parsing_and_undone(frozen: pathlib.Path) -> None:
    before = {path.name: path.read_bytes() for path in frozen.iterdir()}
    with parsers_raise():
        assert change_bytes(frozen, 60, 1, flipped) == []
        assert change_bytes(frozen, 10, 1, resized) == []
        assert exchange_files(frozen) == (15, [])
    assert {path.name: path.read_bytes() for path in frozen.iterdir()} == before


def test_loading_a_valid_ensemble_calls_a_parser(frozen: pathlib.Path) -> None:
    with parsers_raise(), pytest.raises(EnteredError):
        load_ensemble(frozen)


def test_missed_change_is_reported(frozen: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("evidence.faults.flips.load_ensemble", lambda folder: None)
    assert len(change_bytes(frozen, 3, 0, flipped)) == 3
