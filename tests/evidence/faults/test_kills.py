"""``evidence.faults.kills`` with two writers, and writers with defects that it must detect."""

import pathlib
import time
from collections.abc import Callable

import pytest

from deltasafe.io.storage import atomic_file
from evidence.faults.children import Commit, Writer
from evidence.faults.kills import kill_writer
from evidence.faults.races import race
from evidence.faults.writers import augmented_set_writer, execution_writer
from evidence.fixtures import tiny_hands


@pytest.mark.parametrize("name", ["augmented set", "execution log"])
def test_nothing_is_torn_or_lost_and_next_run_succeeds(name: str, tmp_path: pathlib.Path) -> None:
    writer = execution_writer() if name == "execution log" else augmented_set_writer(tiny_hands(tmp_path / "hands"))
    kills = kill_writer(writer, tmp_path / "home", 4, seed=1)
    assert [kill.failure for kill in kills if kill.failure] == []
    assert sum(kill.interrupted for kill in kills) == 4


def _writer(write: Callable[[pathlib.Path, int, Commit], None]) -> Writer:
    """Create a writer of a file that holds its version number 50 times."""

    def read(home: pathlib.Path) -> int:
        numbers = (home / "numbers").read_text().split() if (home / "numbers").exists() else ["0"] * 50
        if len(numbers) != 50 or len({*numbers}) != 1:
            raise ValueError("torn")
        return int(numbers[0])

    return Writer("numbers", write, read)


def _write_in_place(home: pathlib.Path, number: int, commit: Commit) -> None:
    with (home / "numbers").open("w") as file:
        for _ in range(50):
            file.write(f"{number} ")
            file.flush()
            time.sleep(1e-4)
    commit(number)


def test_writing_in_place_is_detected(tmp_path: pathlib.Path) -> None:
    kills = kill_writer(_writer(_write_in_place), tmp_path / "home", 20, seed=0)
    assert "torn" in kills[-1].failure


def test_mixed_versions_of_a_race_are_detected(tmp_path: pathlib.Path) -> None:
    def opposite_order(home: pathlib.Path, number: int, commit: Commit) -> None:
        for name in ("a", "b") if number % 2 else ("b", "a"):
            (home / name).write_text(f"{number}")
            time.sleep(0.5)

    def read(home: pathlib.Path) -> int:
        (number,) = {(home / name).read_text() for name in ("a", "b")}
        return int(number)

    assert "0 ValueError" in race(Writer("pair", opposite_order, read), tmp_path, 1, delay_s=0.0)


def test_commit_before_the_write_is_detected(tmp_path: pathlib.Path) -> None:
    def early(home: pathlib.Path, number: int, commit: Commit) -> None:
        commit(number)
        time.sleep(0.02)
        (home / "new").write_text(f"{number} " * 50)
        (home / "new").replace(home / "numbers")

    kills = kill_writer(_writer(early), tmp_path / "home", 40, seed=0)
    assert "was committed" in kills[-1].failure


def test_temporary_file_left_behind_is_detected(tmp_path: pathlib.Path) -> None:
    def untidy(home: pathlib.Path, number: int, commit: Commit) -> None:
        with atomic_file(home / "numbers") as temporary:
            temporary.write_text(f"{number} " * 50)
        (home / f".a~new.00000000.1.{number}.x").touch()
        commit(number)

    kills = kill_writer(_writer(untidy), tmp_path / "home", 3, seed=0)
    assert "left behind" in kills[-1].failure
