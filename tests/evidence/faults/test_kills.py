"""A share of ``python -m evidence.faults.kills``, and whether it would notice what it looks for."""

import pathlib
import time
from collections.abc import Callable

import pytest

from deltasafe.storage import atomic_file
from evidence.faults.killing import Writer
from evidence.faults.kills import kill_writer
from evidence.faults.sets import tiny_hands
from evidence.faults.writers import augmented_sets, executions


@pytest.mark.parametrize("name", ["augmented set", "execution log"])
def test_nothing_is_torn_or_lost_and_the_next_run_goes_on(name: str, tmp_path: pathlib.Path) -> None:
    writer = executions() if name == "execution log" else augmented_sets(tiny_hands(tmp_path / "hands"))
    kills = kill_writer(writer, tmp_path / "home", 4, seed=1)
    assert [kill.wrong for kill in kills if kill.wrong] == []
    assert sum(kill.at_work for kill in kills) == 4


def _writer(write: Callable[[pathlib.Path, int], None]) -> Writer:
    def writing(home: pathlib.Path, number: int, say: Callable[[int], None]) -> None:
        write(home, number)
        say(number)

    def read(home: pathlib.Path) -> int:
        lines = (home / "numbers").read_text().split() if (home / "numbers").exists() else ["0"] * 50
        if len(lines) != 50 or len({*lines}) != 1:
            raise ValueError("torn")
        return int(lines[0])

    return Writer("numbers", writing, read)


def test_a_writer_that_writes_in_place_is_found_out(tmp_path: pathlib.Path) -> None:
    def in_place(home: pathlib.Path, number: int) -> None:
        with (home / "numbers").open("w") as file:
            for _ in range(50):
                file.write(f"{number} ")
                file.flush()
                time.sleep(1e-4)

    kills = kill_writer(_writer(in_place), tmp_path / "home", 20, seed=0)
    assert "torn" in kills[-1].wrong


def test_a_writer_that_says_too_early_what_is_written_is_found_out(tmp_path: pathlib.Path) -> None:
    said_of_late = _writer(lambda home, number: None)

    def late(home: pathlib.Path, number: int, say: Callable[[int], None]) -> None:
        say(number)
        time.sleep(0.02)
        (home / "new").write_text(f"{number} " * 50)
        (home / "new").replace(home / "numbers")

    kills = kill_writer(Writer("late", late, said_of_late.read), tmp_path / "home", 40, seed=0)
    assert "was committed" in kills[-1].wrong


def test_what_is_left_behind_is_told(tmp_path: pathlib.Path) -> None:
    def untidy(home: pathlib.Path, number: int) -> None:
        with atomic_file(home / "numbers") as temporary:
            temporary.write_text(f"{number} " * 50)
        (home / f".a~new.00000000.1.{number}.x").touch()

    kills = kill_writer(_writer(untidy), tmp_path / "home", 3, seed=0)
    assert "left behind" in kills[-1].wrong
