"""A share of ``python -m evidence.faults.denials``, and whether it would notice what it looks for."""

import pathlib
import tempfile
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from deltasafe.errors import WriteError
from deltasafe.storage import write_json
from evidence.faults.denials import deny, no_permission, no_room
from evidence.faults.killing import Writer
from evidence.faults.sets import tiny_hands
from evidence.faults.writers import augmented_sets, executions


@pytest.fixture
def home() -> Iterator[pathlib.Path]:
    with tempfile.TemporaryDirectory() as name:  # pytest's own folders are closed to others
        pathlib.Path(name).chmod(0o755)
        yield pathlib.Path(name)


@pytest.mark.parametrize("name", ["augmented set", "execution log"])
def test_no_room_and_no_permission_are_told_and_leave_the_old(name: str, home: pathlib.Path) -> None:
    writer = executions() if name == "execution log" else augmented_sets(tiny_hands(home / "hands"))
    for limit in (1, 5_000):
        assert deny(writer, home / f"{limit}", f"room for {limit} bytes", partial(no_room, limit)) == ""
    place = home / "closed"
    assert deny(writer, place, "no permission", partial(no_permission, place)) == ""


def _writer(write: Callable[[pathlib.Path, int], None]) -> Writer:
    def writing(home: pathlib.Path, number: int, say: Callable[[int], None]) -> None:
        home.mkdir(exist_ok=True)
        write(home, number)

    return Writer("numbers", writing, lambda home: int((home / "number").read_text().split()[0]))


def test_an_old_version_that_is_lost_is_told(home: pathlib.Path) -> None:
    def in_place(home: pathlib.Path, number: int) -> None:
        try:
            (home / "number").write_text(f"{number} " * 1000)
        except OSError as error:
            raise WriteError(home / "number", f"cannot be written ({error.strerror}); free room there") from error

    assert "1 stood there, and now 2" in deny(_writer(in_place), home / "a", "no room", partial(no_room, 100))


def test_an_error_that_does_not_say_what_is_wrong_is_told(home: pathlib.Path) -> None:
    def unclear(home: pathlib.Path, number: int) -> None:
        with (home / "number").open("x" if number == 2 else "w") as file:
            file.write(f"{number} ")

    assert "FileExistsError" in deny(_writer(unclear), home / "a", "no room", partial(no_room, 100))


def test_a_denial_that_denies_nothing_is_no_failure(home: pathlib.Path) -> None:
    writer = _writer(lambda home, number: write_json(home / "number", number))
    assert deny(writer, home / "a", "room enough", partial(no_room, 10**9)) == ""
