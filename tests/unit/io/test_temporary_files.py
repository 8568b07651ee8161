import os
import pathlib
import signal
import time

import pytest

from deltasafe.io import storage
from deltasafe.io import temporary_files as siblings
from deltasafe.io.storage import atomic_file, atomic_folder


def left_behind(folder):
    return sorted(path.name for path in folder.iterdir())


def killed_while(writing):
    """Run ``writing`` in a process that is killed as soon as it has reached the end of it."""
    reads, writes = os.pipe()
    pid = os.fork()
    if pid == 0:
        writing(lambda: (os.write(writes, b"x"), time.sleep(60)))
        os._exit(1)
    os.read(reads, 1)
    os.kill(pid, signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGKILL
    os.close(reads), os.close(writes)


def half_a_file(path):
    def writing(arrived):
        with atomic_file(path) as temporary:
            temporary.write_text("half")
            arrived()

    return writing


def half_a_folder(path):
    def writing(arrived):
        with atomic_folder(path) as temporary:
            (temporary / "half").write_text("half")
            arrived()

    return writing


@pytest.mark.parametrize("half", [half_a_file, half_a_folder])
def test_what_a_killed_writer_left_goes_with_the_next_writing(tmp_path, half):
    killed_while(half(tmp_path / "a.txt"))
    assert len(left_behind(tmp_path)) == 1
    with atomic_file(tmp_path / "b.txt") as temporary:
        temporary.write_text("whole")
    assert left_behind(tmp_path) == ["b.txt"]


def test_what_others_are_writing_is_left_to_them(tmp_path):
    with atomic_folder(tmp_path / "set") as mine:
        pid = os.fork()
        if pid == 0:
            siblings.sweep(tmp_path)
            os._exit(0 if mine.is_dir() else 1)
        assert os.waitpid(pid, 0)[1] == 0
    assert left_behind(tmp_path) == ["set"]


def test_another_machines_siblings_are_swept_after_a_week(tmp_path):
    recent, old = (tmp_path / f".a~new.0123abcd.{os.getpid()}.{start}.x.txt" for start in (1, 2))
    recent.touch()
    old.touch()
    os.utime(old, (time.time() - 8 * 24 * 3600,) * 2)
    siblings.sweep(tmp_path)
    assert left_behind(tmp_path) == [recent.name]


def test_hidden_files_of_other_programs_are_not_siblings(tmp_path):
    names = [".DS_Store", ".a~", ".a-1.txt", "a~new.0123abcd.1.1.x.txt"]
    for name in names:
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (0, 0))
    siblings.sweep(tmp_path)
    assert left_behind(tmp_path) == sorted(names)


def test_an_existing_folder_is_never_missing_while_it_is_replaced(tmp_path, monkeypatch):
    folder, seen = tmp_path / "set", []
    replace = pathlib.Path.replace
    monkeypatch.setattr(pathlib.Path, "replace", lambda self, other: replace(self, other) and seen.append(other))
    for name in ("one", "two"):
        with atomic_folder(folder) as temporary:
            (temporary / name).touch()
    assert left_behind(folder) == ["two"]
    assert seen == [folder], "the second time, the two names were exchanged"
    assert left_behind(tmp_path) == ["set"]


def test_where_names_cannot_be_exchanged_a_retired_folder_comes_back(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "exchange", lambda one, other: False)
    folder = tmp_path / "set"
    for name in ("one", "two"):
        with atomic_folder(folder) as temporary:
            (temporary / name).touch()
    assert (left_behind(folder), left_behind(tmp_path)) == (["two"], ["set"])

    def killed_between(arrived):
        replace = pathlib.Path.replace
        monkeypatch.setattr(
            pathlib.Path,
            "replace",
            lambda self, other: arrived() if other == folder and not folder.exists() else replace(self, other),
        )
        with atomic_folder(folder) as temporary:
            (temporary / "three").touch()

    killed_while(killed_between)
    assert not folder.exists()
    siblings._sweep_once.cache_clear()
    siblings.sweep(tmp_path)
    assert (left_behind(folder), left_behind(tmp_path)) == (["two"], ["set"])


def test_exchange_says_what_is_wrong(tmp_path):
    (tmp_path / "one").mkdir()
    with pytest.raises(FileNotFoundError):
        siblings.exchange(tmp_path / "one", tmp_path / "none")
