"""``evidence.faults.denials`` with two writers, and writers with defects that it must detect."""

import pathlib
from collections.abc import Callable, Iterator
from functools import partial

import pytest

from deltasafe.errors import WriteError
from deltasafe.io.storage import write_json
from evidence.faults.children import Commit, Writer
from evidence.faults.denials import deny, no_permission, no_space
from evidence.faults.writers import augmented_set_writer, execution_writer
from evidence.fixtures import temporary_home, tiny_hands


@pytest.fixture
def home() -> Iterator[pathlib.Path]:
    with temporary_home() as folder:  # pytest's own folders are closed to unprivileged users
        yield folder


@pytest.mark.parametrize("name", ["augmented set", "execution log"])
def test_denied_writer_raises_and_keeps_previous_version(name: str, home: pathlib.Path) -> None:
    writer = execution_writer() if name == "execution log" else augmented_set_writer(tiny_hands(home / "hands"))
    for limit in (1, 5_000):
        assert deny(writer, home / f"{limit}", f"at most {limit} bytes", partial(no_space, limit)) == ""
    closed = home / "closed"
    assert deny(writer, closed, "no permission", partial(no_permission, closed)) == ""


def _writer(write: Callable[[pathlib.Path, int], None]) -> Writer:
    def write_version(home: pathlib.Path, number: int, commit: Commit) -> None:
        home.mkdir(exist_ok=True)
        write(home, number)

    return Writer("numbers", write_version, lambda home: int((home / "number").read_text().split()[0]))


def test_lost_previous_version_is_detected(home: pathlib.Path) -> None:
    def in_place(home: pathlib.Path, number: int) -> None:
        try:
            (home / "number").write_text(f"{number} " * 1000)
        except OSError as error:
            raise WriteError(home / "number", f"cannot be written ({error.strerror}); free space there") from error

    assert "version 1 was stored, now 2" in deny(_writer(in_place), home / "a", "no space", partial(no_space, 100))


def test_untyped_error_is_detected(home: pathlib.Path) -> None:
    def untyped(home: pathlib.Path, number: int) -> None:
        with (home / "number").open("x" if number == 2 else "w") as file:
            file.write(f"{number} ")

    assert "FileExistsError" in deny(_writer(untyped), home / "a", "no space", partial(no_space, 100))


def test_sufficient_space_is_no_failure(home: pathlib.Path) -> None:
    writer = _writer(lambda home, number: write_json(home / "number", number))
    assert deny(writer, home / "a", "enough space", partial(no_space, 10**9)) == ""
