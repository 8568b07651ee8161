"""Arrays in ``.npz`` files: damaged, pickled, and claiming to be larger than any memory."""

import io
import pathlib
import struct
import zipfile
from collections.abc import Callable
from random import Random
from typing import Any

import numpy as np

from evidence.faults.judging import rewrite
from evidence.faults.malformed.files import file_spoils

__all__ = ["array_spoils", "with_array"]

Change = Callable[[pathlib.Path, Random], None]


def array_spoils(sound: pathlib.Path) -> dict[str, Change]:
    """Ways of spoiling an ``.npz`` file of which every array is needed."""
    with np.load(sound) as arrays:
        names = list(arrays)
    spoils = dict(file_spoils())
    for name in names:
        spoils[f"without {name}"] = with_array(name, None)
        spoils[f"{name} pickled"] = with_array(name, np.array([{"a": 1}], dtype=object))
        spoils[f"{name} is text"] = with_array(name, np.array(["ten"]))
    first = names[0]
    spoils[f"{first} claims to be of 10^12 rows"] = _claiming(first, f"({10**12}, 3)")
    spoils[f"{first} has a header that is no header"] = _claiming(first, "__import__('os')")
    spoils["claims to unpack to 4 GB"] = _patched(b"PK\x01\x02", 24, struct.pack("<I", 2**32 - 2))
    spoils["encrypted"] = _patched(b"PK\x01\x02", 8, struct.pack("<H", 1))
    spoils["packed in an unknown way"] = _patched(b"PK\x01\x02", 10, struct.pack("<H", 77))
    spoils["a byte of its data changed"] = _flipped
    spoils["a zip of something else"] = lambda path, _: rewrite(path, _zipped({"readme.txt": b"hello"}))
    return spoils


def with_array(name: str, value: np.ndarray | None) -> Change:
    """The file with another array, or without it."""

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


def _claiming(name: str, shape: str) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        with zipfile.ZipFile(path) as parts:
            stored = {part: parts.read(part) for part in parts.namelist()}
        header = f"{{'descr': '<f4', 'fortran_order': False, 'shape': {shape}, }}"
        header += " " * (-(len(header) + 11) % 64) + "\n"
        stored[f"{name}.npy"] = b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header.encode() + bytes(100)
        rewrite(path, _zipped(stored))

    return change


def _zipped(parts: dict[str, bytes]) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as written:
        for name, data in parts.items():
            written.writestr(name, data)
    return stream.getvalue()


def _patched(signature: bytes, offset: int, value: bytes) -> Change:
    """Every entry of the directory of a zip says otherwise."""

    def change(path: pathlib.Path, random: Random) -> None:
        data = bytearray(path.read_bytes())
        place = data.find(signature)
        while place >= 0:
            data[place + offset : place + offset + len(value)] = value
            place = data.find(signature, place + 4)
        rewrite(path, bytes(data))

    return change


def _flipped(path: pathlib.Path, random: Random) -> None:
    with zipfile.ZipFile(path) as parts:
        largest = max(parts.infolist(), key=lambda part: part.compress_size)
    data = bytearray(path.read_bytes())
    names = struct.unpack_from("<HH", data, largest.header_offset + 26)
    place = largest.header_offset + 30 + sum(names) + random.randrange(largest.compress_size)
    data[place] ^= 1 << random.randrange(8)
    rewrite(path, bytes(data))
