"""Corruptions of safetensors files: false headers, tensors that do not fit, and values that are not finite."""

import json
import pathlib
import struct
from collections.abc import Callable
from random import Random
from typing import Any

from evidence.faults.malformed.files import filled, truncated
from evidence.faults.rejection import Change, rewrite

HeaderEdit = Callable[[dict[str, Any], str, str], Any]
"""Edits the header, given two tensor names."""


def weight_changes() -> dict[str, Change]:
    """Return the changes that apply to the weights of a member."""

    def pickled(path: pathlib.Path, random: Random) -> None:
        import torch

        path.unlink()
        torch.save({"weight": torch.zeros(3)}, path)

    def header_length(length: int) -> Change:
        return lambda path, _: rewrite(path, struct.pack("<Q", length) + path.read_bytes()[8:])

    edits: dict[str, HeaderEdit] = {
        "overlapping tensors": lambda header, a, b: header[b].update(data_offsets=header[a]["data_offsets"]),
        "offsets beyond the file": lambda header, a, b: header[b].update(data_offsets=[10**9, 2 * 10**9]),
        "reversed offsets": lambda header, a, b: header[a]["data_offsets"].reverse(),
        "negative offsets": lambda header, a, b: header[a].update(data_offsets=[-4, 0]),
        "an unknown dtype": lambda header, a, b: header[a].update(dtype="PICKLE"),
        "a dtype of another size": lambda header, a, b: header[a].update(dtype="F64"),
        "a shape that does not fit": lambda header, a, b: header[a].update(shape=[10**6, 10**6]),
        "a shape that overflows": lambda header, a, b: header[a].update(shape=[2**62, 2**62]),
        "a renamed tensor": lambda header, a, b: header.update({f"{a}.other": header.pop(a)}),
        "a missing tensor": lambda header, a, b: header.pop(a),
        "a transposed tensor": lambda header, a, b: header[a].update(shape=header[a]["shape"][::-1]),
    }
    values = {"NaN": 0x7FC00000, "a signaling NaN": 0x7F800001, "infinity": 0x7F800000}
    return {
        "empty": filled(b""),
        "text": filled(b"weights"),
        "truncated": truncated,
        "one byte missing": lambda path, _: rewrite(path, path.read_bytes()[:-1]),
        "one byte added": lambda path, _: rewrite(path, path.read_bytes() + b"\0"),
        "a pickle": pickled,
        "header of 2^63 bytes": header_length(2**63),
        "header of 2^64 - 1 bytes": header_length(2**64 - 1),
        "header of 200 MB": header_length(200_000_000),
        "header of 0 bytes": header_length(0),
        "truncated header": header_length(100),
        "header that is not JSON": filled(struct.pack("<Q", 8) + b"{nothing" + bytes(100)),
        "header that is a list": filled(struct.pack("<Q", 8) + b"[1,2,3] " + bytes(100)),
        **{name: _with_header(edit) for name, edit in edits.items()},
        **{name: _with_value(bits) for name, bits in values.items()},
    }


def _read(path: pathlib.Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def _write(path: pathlib.Path, header: dict[str, Any], values: bytes) -> None:
    text = json.dumps(header).encode()
    rewrite(path, struct.pack("<Q", len(text)) + text + values)


def _asymmetric(header: dict[str, Any]) -> list[str]:
    """Return the names of float tensors whose first and last dimension differ, in file order."""
    tensors = {name: about for name, about in header.items() if name != "__metadata__" and about["dtype"] == "F32"}
    names = [name for name, about in tensors.items() if about["shape"] and about["shape"][0] != about["shape"][-1]]
    return sorted(names, key=lambda name: header[name]["data_offsets"])


def _with_header(edit: HeaderEdit) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        header, values = _read(path)
        edit(header, *random.sample(_asymmetric(header), 2))
        _write(path, header, values)

    return change


def _with_value(bits: int) -> Change:
    def change(path: pathlib.Path, random: Random) -> None:
        header, values = _read(path)
        low, high = header[random.choice(_asymmetric(header))]["data_offsets"]
        position = random.randrange(low, high, 4)
        _write(path, header, values[:position] + struct.pack("<I", bits) + values[position + 4 :])

    return change
