"""Weights in safetensors files whose headers lie, that do not fit, or that are not finite."""

import json
import pathlib
import struct
from collections.abc import Callable
from random import Random
from typing import Any

from evidence.faults.judging import rewrite
from evidence.faults.malformed.files import filled

__all__ = ["weight_spoils"]

Change = Callable[[pathlib.Path, Random], None]


def weight_spoils() -> dict[str, Change]:
    """Ways of spoiling the weights of a member."""

    def pickled(path: pathlib.Path, random: Random) -> None:
        import torch

        path.unlink()
        torch.save({"weight": torch.zeros(3)}, path)

    def as_header(length: int) -> Change:
        return lambda path, _: rewrite(path, struct.pack("<Q", length) + path.read_bytes()[8:])

    spoils: dict[str, Change] = {
        "empty": filled(b""),
        "text": filled(b"weights"),
        "cut in half": lambda path, _: rewrite(path, path.read_bytes()[: path.stat().st_size // 2]),
        "one byte short": lambda path, _: rewrite(path, path.read_bytes()[:-1]),
        "a byte more": lambda path, _: rewrite(path, path.read_bytes() + b"\0"),
        "a pickle": pickled,
        "header of 2^63 bytes": as_header(2**63),
        "header of 2^64 - 1 bytes": as_header(2**64 - 1),
        "header of 200 MB": as_header(200_000_000),
        "header of no bytes": as_header(0),
        "header that ends early": as_header(100),
        "header that is no JSON": filled(struct.pack("<Q", 8) + b"{nothing" + bytes(100)),
        "header that is a list": filled(struct.pack("<Q", 8) + b"[1,2,3] " + bytes(100)),
    }
    spoils["overlapping tensors"] = _header(
        lambda header, a, b: header[b].update(data_offsets=header[a]["data_offsets"])
    )
    spoils["offsets beyond the file"] = _header(lambda header, a, b: header[b].update(data_offsets=[10**9, 2 * 10**9]))
    spoils["offsets backwards"] = _header(
        lambda header, a, b: header[a].update(data_offsets=header[a]["data_offsets"][::-1])
    )
    spoils["negative offsets"] = _header(lambda header, a, b: header[a].update(data_offsets=[-4, 0]))
    spoils["an unknown type"] = _header(lambda header, a, b: header[a].update(dtype="PICKLE"))
    spoils["a type of another size"] = _header(lambda header, a, b: header[a].update(dtype="F64"))
    spoils["a shape that does not fit"] = _header(lambda header, a, b: header[a].update(shape=[10**6, 10**6]))
    spoils["a shape beyond counting"] = _header(lambda header, a, b: header[a].update(shape=[2**62, 2**62]))
    spoils["a tensor of another name"] = _header(lambda header, a, b: header.update({f"{a}.other": header.pop(a)}))
    spoils["a tensor less"] = _header(lambda header, a, b: header.pop(a))
    spoils["a tensor turned round"] = _header(lambda header, a, b: header[a].update(shape=header[a]["shape"][::-1]))
    for word, bits in (("NaN", 0x7FC00000), ("a signalling NaN", 0x7F800001), ("infinity", 0x7F800000)):
        spoils[word] = _value(bits)
    return spoils


def _opened(path: pathlib.Path) -> tuple[dict[str, Any], bytes]:
    data = path.read_bytes()
    (length,) = struct.unpack("<Q", data[:8])
    return json.loads(data[8 : 8 + length]), data[8 + length :]


def _wide(header: dict[str, Any]) -> list[str]:
    """Names of float tensors of different extents, in the order of the file."""
    named = (name for name, about in header.items() if name != "__metadata__" and about["dtype"] == "F32")
    return sorted(
        (
            name
            for name in named
            if len(header[name]["shape"]) > 1 and header[name]["shape"][0] != header[name]["shape"][-1]
        ),
        key=lambda name: header[name]["data_offsets"],
    )


def _header(change: Callable[[dict[str, Any], str, str], Any]) -> Change:
    def spoil(path: pathlib.Path, random: Random) -> None:
        header, values = _opened(path)
        change(header, *random.sample(_wide(header), 2))
        text = json.dumps(header).encode()
        rewrite(path, struct.pack("<Q", len(text)) + text + values)

    return spoil


def _value(bits: int) -> Change:
    def spoil(path: pathlib.Path, random: Random) -> None:
        header, values = _opened(path)
        low, high = header[random.choice(_wide(header))]["data_offsets"]
        place = random.randrange(low, high, 4)
        text = json.dumps(header).encode()
        values = values[:place] + struct.pack("<I", bits) + values[place + 4 :]
        rewrite(path, struct.pack("<Q", len(text)) + text + values)

    return spoil
