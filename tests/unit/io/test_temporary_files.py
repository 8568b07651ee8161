"""Leftovers of killed writers are removed, files in use are kept, and folders are replaced atomically."""

import os
import pathlib
import signal
import time

import pytest

from deltasafe.io import storage, temporary_files
from deltasafe.io.storage import atomic_file, atomic_folder


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def killed_while(writing):
    """Run ``writing`` in a child process that is killed when it calls its argument."""
    reads, writes = os.pipe()
    pid = os.fork()
    if pid == 0:
        writing(lambda: (os.write(writes, b"x"), time.sleep(60)))
        os._exit(1)
    os.read(reads, 1)
    os.kill(pid, signal.SIGKILL)
    assert os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1]) == -signal.SIGKILL
    os.close(reads), os.close(writes)


def partial_file(path):
    def writing(arrived):
        with atomic_file(path) as temporary:
            temporary.write_text("half")
            arrived()

    return writing


def partial_folder(path):
    def writing(arrived):
        with atomic_folder(path) as temporary:
            (temporary / "half").write_text("half")
            arrived()

    return writing


@pytest.mark.parametrize("partial", [partial_file, partial_folder])
def test_the_next_write_removes_leftovers_of_a_killed_process(tmp_path, partial):
    killed_while(partial(tmp_path / "a.txt"))
    assert len(names_in(tmp_path)) == 1
    with atomic_file(tmp_path / "b.txt") as temporary:
        temporary.write_text("whole")
    assert names_in(tmp_path) == ["b.txt"]


def test_files_of_running_processes_are_kept(tmp_path):
    with atomic_folder(tmp_path / "set") as mine:
        pid = os.fork()
        if pid == 0:
            temporary_files.remove_leftovers(tmp_path)
            os._exit(0 if mine.is_dir() else 1)
        assert os.waitpid(pid, 0)[1] == 0
    assert names_in(tmp_path) == ["set"]


def test_leftovers_of_another_machine_are_removed_after_a_week(tmp_path):
    recent, old = (tmp_path / f".a~new.0123abcd.{os.getpid()}.{start}.x.txt" for start in (1, 2))
    recent.touch()
    old.touch()
    os.utime(old, (time.time() - 8 * 24 * 3600,) * 2)
    temporary_files.remove_leftovers(tmp_path)
    assert names_in(tmp_path) == [recent.name]


def test_hidden_files_of_other_programs_are_kept(tmp_path):
    names = [".DS_Store", ".a~", ".a-1.txt", "a~new.0123abcd.1.1.x.txt"]
    for name in names:
        (tmp_path / name).touch()
        os.utime(tmp_path / name, (0, 0))
    temporary_files.remove_leftovers(tmp_path)
    assert names_in(tmp_path) == sorted(names)


def test_a_folder_is_replaced_without_being_missing_in_between(tmp_path, monkeypatch):
    folder, seen = tmp_path / "set", []
    replace = pathlib.Path.replace
    monkeypatch.setattr(pathlib.Path, "replace", lambda self, other: replace(self, other) and seen.append(other))
    for name in ("one", "two"):
        with atomic_folder(folder) as temporary:
            (temporary / name).touch()
    assert names_in(folder) == ["two"]
    assert seen == [folder], "the second write exchanges the two names"
    assert names_in(tmp_path) == ["set"]


def test_a_backup_is_restored_after_a_kill_where_names_cannot_be_exchanged(tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "swap_names", lambda one, other: False)
    folder = tmp_path / "set"
    for name in ("one", "two"):
        with atomic_folder(folder) as temporary:
            (temporary / name).touch()
    assert (names_in(folder), names_in(tmp_path)) == (["two"], ["set"])

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
    temporary_files._remove_once.cache_clear()
    temporary_files.remove_leftovers(tmp_path)
    assert (names_in(folder), names_in(tmp_path)) == (["two"], ["set"])


def test_swap_names_raises_if_a_folder_is_missing(tmp_path):
    (tmp_path / "one").mkdir()
    with pytest.raises(FileNotFoundError):
        temporary_files.swap_names(tmp_path / "one", tmp_path / "none")
