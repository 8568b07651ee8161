"""Atomic writes, strict JSON and digests."""

import dataclasses
import os
import pathlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file, atomic_folder, digest_of, read_json, sha256_of_file, write_json

json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats(allow_nan=False, allow_infinity=False) | st.text(),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(), inner, max_size=3),
    max_leaves=8,
)


def names_in(folder):
    return sorted(path.name for path in folder.iterdir())


def test_a_failed_write_keeps_the_old_file(tmp_path):
    file = tmp_path / "a.txt"
    file.write_text("old")
    with pytest.raises(RuntimeError), atomic_file(file) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert file.read_text() == "old"
    assert names_in(tmp_path) == ["a.txt"]


def test_a_failed_write_keeps_the_old_folder(tmp_path):
    folder = tmp_path / "set"
    with atomic_folder(folder) as temporary:
        (temporary / "one").write_text("1")
    with pytest.raises(RuntimeError), atomic_folder(folder) as temporary:
        (temporary / "two").write_text("2")
        raise RuntimeError
    assert names_in(folder) == ["one"]
    assert names_in(tmp_path) == ["set"]


def test_a_new_folder_replaces_all_files_of_the_old_one(tmp_path):
    folder = tmp_path / "set"
    for name in ("one", "two"):
        with atomic_folder(folder) as temporary:
            (temporary / name).write_text(name)
    assert names_in(folder) == ["two"]
    assert names_in(tmp_path) == ["set"]


def test_write_json_refuses_nan(tmp_path):
    with pytest.raises(ValueError, match="not JSON compliant"):
        write_json(tmp_path / "a.json", {"value": float("nan")})
    assert names_in(tmp_path) == []


def test_a_missing_or_invalid_json_file_is_named_with_the_reason(tmp_path):
    with pytest.raises(DataError, match="is missing") as raised:
        read_json(tmp_path / "none.json")
    assert raised.value.path == tmp_path / "none.json"
    (tmp_path / "bad.json").write_text("{")
    with pytest.raises(DataError, match="is not valid JSON"):
        read_json(tmp_path / "bad.json")


@given(value=st.dictionaries(st.text(), json_values, max_size=5))
def test_digest_is_independent_of_key_order(value):
    assert digest_of(value) == digest_of(dict(reversed(list(value.items()))))


def test_digest_compares_dataclasses_arrays_and_paths_by_value():
    @dataclasses.dataclass
    class Point:
        x: float

    assert digest_of(Point(1.0)) == digest_of({"x": 1.0})
    assert digest_of(np.arange(3)) == digest_of([0, 1, 2])
    assert digest_of(pathlib.PurePosixPath("a/b")) == digest_of("a/b")
    assert digest_of(Point(1.0)) != digest_of(Point(2.0))


def test_sha256_matches_the_published_test_vector(tmp_path):
    (tmp_path / "abc").write_bytes(b"abc")
    assert sha256_of_file(tmp_path / "abc") == ("ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ('{"a": 1, "a": 2}', "key 'a' occurs twice"),
        ('{"a": NaN}', "NaN is not a finite number"),
        ('{"a": -1e999}', "-1e999 is not a finite number"),
        ('{"a": ' + "9" * 5000 + "}", "not valid JSON"),
        ("[" * 100_000 + "]" * 100_000, "nested too deeply"),
    ],
    ids=["duplicate key", "nan", "infinite", "digits", "deep"],
)
def test_ambiguous_or_non_finite_json_is_refused(tmp_path, text, message):
    (tmp_path / "a.json").write_text(text)
    with pytest.raises(DataError, match=message):
        read_json(tmp_path / "a.json")


def test_a_named_pipe_is_refused_without_blocking(tmp_path):
    os.mkfifo(tmp_path / "a.json")
    with pytest.raises(DataError, match="is not a file"):
        read_json(tmp_path / "a.json")


@pytest.mark.parametrize("mask", [0o002, 0o022, 0o077], ids=oct)
def test_files_and_folders_have_the_mode_that_the_umask_gives(tmp_path, mask):
    before = os.umask(mask)
    try:
        write_json(tmp_path / "a.json", {})
        with atomic_folder(tmp_path / "folder") as temporary:
            (temporary / "inside").touch()
    finally:
        os.umask(before)
    modes = {path.name: path.stat().st_mode & 0o777 for path in tmp_path.rglob("*")}
    assert modes == {"a.json": 0o666 & ~mask, "folder": 0o777 & ~mask, "inside": 0o666 & ~mask}
