"""Reading `.npz` files: round trip, pickled objects, size limit."""

import pathlib

import numpy as np
import pytest

from deltasafe.errors import DataError
from deltasafe.io import arrays
from deltasafe.io.arrays import read_npz


def test_arrays_round_trip(tmp_path: pathlib.Path) -> None:
    written = {"a": np.arange(12.0).reshape(3, 4), "b": np.array(7, np.int32), "c": np.zeros((0, 2), np.uint8)}
    np.savez_compressed(tmp_path / "some.npz", **written)
    found = read_npz(tmp_path / "some.npz")
    assert set(found) == set(written)
    for name, value in written.items():
        np.testing.assert_array_equal(found[name], value)
        assert found[name].dtype == value.dtype


def test_pickled_objects_are_refused(tmp_path: pathlib.Path) -> None:
    np.savez(tmp_path / "some.npz", a=np.array([{"a": 1}], dtype=object))
    with pytest.raises(DataError, match=r"some\.npz: is not readable .*restore"):
        read_npz(tmp_path / "some.npz")


def test_arrays_above_the_size_limit_are_refused(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    np.savez_compressed(tmp_path / "some.npz", a=np.zeros(10_000))
    assert (tmp_path / "some.npz").stat().st_size < 1000
    monkeypatch.setattr(arrays, "MAX_BYTES", 50_000)
    with pytest.raises(DataError, match="bytes when decompressed, more than 50000"):
        read_npz(tmp_path / "some.npz")


def test_a_missing_file_is_named_in_the_error(tmp_path: pathlib.Path) -> None:
    with pytest.raises(DataError, match=r"none\.npz: is missing"):
        read_npz(tmp_path / "none.npz")
