"""Failed writes become a `WriteError` that names the destination."""

import errno
import os
import pathlib
import pickle
import resource
import signal
import tempfile

import numpy as np
import pytest
import torch
from safetensors.torch import save_file

from deltasafe.errors import DataError, WriteError
from deltasafe.io.storage import atomic_file, atomic_folder, write_json


@pytest.fixture
def small_files():
    """Limit the size of files to 1000 bytes."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1000, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)
    signal.signal(signal.SIGXFSZ, handler)


WRITERS = {
    "bytes": lambda path: path.write_bytes(bytes(5000)),
    "array": lambda path: np.zeros(5000).tofile(path),
    "arrays": lambda path: np.savez(path, a=np.random.default_rng(0).random(5000)),
    "safetensors": lambda path: save_file({"a": torch.zeros(5000)}, path),
}


@pytest.mark.parametrize("writer", WRITERS)
def test_a_full_disk_is_reported_with_the_name_of_the_destination(tmp_path, small_files, writer):
    file = tmp_path / "a.npz"
    with (
        pytest.raises(WriteError, match=r"a\.npz: cannot be written \(.*; free space there") as raised,
        atomic_file(file) as new,
    ):
        WRITERS[writer](new)
    assert raised.value.path == file
    assert list(tmp_path.iterdir()) == []


def test_a_failed_file_in_an_atomic_folder_names_the_folder(tmp_path, small_files):
    with pytest.raises(WriteError) as raised, atomic_folder(tmp_path / "set") as new:
        write_json(new / "large.json", ["x" * 5000])
    assert raised.value.path == tmp_path / "set"


def test_other_errors_are_not_translated(tmp_path):
    for error in (
        DataError(tmp_path / "input.json", "is missing; restore it"),
        FileNotFoundError(errno.ENOENT, "none", str(tmp_path / "input")),
        PermissionError(errno.EACCES, "not this one", "/somewhere/else"),
        WriteError("/somewhere/else", "cannot be written"),
        ValueError("5 requested"),
    ):
        with pytest.raises(type(error)) as raised, atomic_file(tmp_path / "a.json"):
            raise error
        assert raised.value is error


def test_a_missing_permission_is_reported():
    with tempfile.TemporaryDirectory() as name:  # the temporary folders of pytest are not accessible to other users
        folder = pathlib.Path(name)
        folder.chmod(0o555)
        privileged = os.geteuid() == 0
        if privileged:
            os.seteuid(65534)
        try:
            with pytest.raises(WriteError, match=r"Permission denied\); make its folder writable"):
                write_json(folder / "a.json", {})
        finally:
            if privileged:
                os.seteuid(0)
            folder.chmod(0o755)


def test_the_error_survives_pickling():
    error = pickle.loads(pickle.dumps(WriteError("a", "b")))
    assert (str(error), error.path.name, error.reason) == ("a: b", "a", "b")
