"""A share of ``python -m evidence.faults.flips``."""

import pathlib

import pytest

from deltasafe.perception.artifact import load_ensemble
from evidence.faults.ensemble import tiny_ensemble
from evidence.faults.flips import EnteredError, exchange_files, flip_bytes, nothing_is_made, resize_files


@pytest.fixture(scope="module")
def frozen(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return tiny_ensemble(tmp_path_factory.mktemp("ensemble"))


def test_no_changed_byte_is_missed_and_nothing_is_made_of_any(frozen: pathlib.Path) -> None:
    before = {path.name: path.read_bytes() for path in frozen.iterdir()}
    with nothing_is_made():
        assert flip_bytes(frozen, 60, seed=1) == []
        assert resize_files(frozen, 10, seed=1) == []
        count, missed = exchange_files(frozen)
    assert (count, missed) == (15, [])
    assert {path.name: path.read_bytes() for path in frozen.iterdir()} == before


def test_whoever_reads_weights_is_noticed(frozen: pathlib.Path) -> None:
    with nothing_is_made(), pytest.raises(EnteredError):
        load_ensemble(frozen)


def test_a_change_that_is_not_noticed_is_told(frozen: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("evidence.faults.flips.load_ensemble", lambda folder: None)
    assert len(flip_bytes(frozen, 3, seed=0)) == 3
