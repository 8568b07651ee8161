"""Corruptions of ``.npz`` files: damaged, pickled, encrypted, or claiming more memory than any machine has."""

import io
import pathlib
import struct
import zipfile
from random import Random
from typing import Any

import numpy as np

from evidence.faults.malformed.files import file_changes
from evidence.faults.rejection import Change, rewrite

DIRECTORY_ENTRY = b"PK\x01\x02"


def array_changes(valid: pathlib.Path) -> dict[str, Change]:
    """Return the changes that apply to an ``.npz`` file of which every array is required."""
    with np.load(valid) as arrays:
        names = list(arrays)
    changes = dict(file_changes())
    for name in names:
        changes[f"without {name}"] = with_array(name, None)
        changes[f"{name} pickled"] = with_array(name, np.array([{"a": 1}], dtype=object))
        changes[f"{name} is text"] = with_array(name, np.array(["ten"]))
    return {
        **changes,
        f"{names[0]} claims 10^12 rows": _with_header(names[0], f"({10**12}, 3)"),
        f"{names[0]} has an invalid header": _with_header(names[0], "__import__('os')"),
        "claims to unpack to 4 GB": _with_entries(24, struct.pack("<I", 2**32 - 2)),
        "encrypted": _with_entries(8, struct.pack("<H", 1)),
        "unknown compression": _with_entries(10, struct.pack("<H", 77)),
        "a bit of its data flipped": _bit_flipped,
        "a zip of another file": lambda path, _: rewrite(path, _zipped({"readme.txt": b"hello"})),
    }


def with_array(name: str, value: np.ndarray | None) -> Change:
    """Replace one array of the file, or remove it."""

    def change(path: pathlib.Path, random: Random) -> None:
        with np.load(path) as stored:
            arrays: dict[str, Any] = dict(stored)
        arrays.pop(name)
        if value is not None:
            arrays[name] = value
        stream = io.BytesIO()
        np.savez(stream, **arrays)
        rewrite(path, stream.getvalue())

    return change


def _with_header(name: str, shape: str) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        with zipfile.ZipFile(path) as entries:
            stored = {entry: entries.read(entry) for entry in entries.namelist()}
        header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
        header += " " * (-(len(header) + 11) % 64) + "\n"
        stored[f"{name}.npy"] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + bytes(100)
        rewrite(path, _zipped(stored))

    return change


def _zipped(entries: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, data in entries.items():
            archive.writestr(name, data)
    return stream.getvalue()


def _with_entries(offset: int, value: bytes) -> Change:
    """Overwrite a field of every entry of the zip's central directory."""

    def change(path: pathlib.Path, random: Random) -> None:
        data = bytearray(path.read_bytes())
        position = data.find(DIRECTORY_ENTRY)
        while position >= 0:
            data[position + offset : position + offset + len(value)] = value
            position = data.find(DIRECTORY_ENTRY, position + 4)
        rewrite(path, bytes(data))

    return change


def _bit_flipped(path: pathlib.Path, random: Random) -> None:
    with zipfile.ZipFile(path) as entries:
        largest = max(entries.infolist(), key=lambda entry: entry.compress_size)
    data = bytearray(path.read_bytes())
    name_sizes = struct.unpack_from("<HH", data, largest.header_offset + 26)
    position = largest.header_offset + 30 + sum(name_sizes) + random.randrange(largest.compress_size)
    data[position] ^= 1 << random.randrange(8)
    rewrite(path, bytes(data))
