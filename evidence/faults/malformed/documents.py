"""JSON: what is none, what readers understand differently, and fields that are missing or of another kind."""

import copy
import json
import pathlib
from collections.abc import Callable, Iterator, Sequence
from random import Random
from typing import Any

from evidence.faults.judging import rewrite
from evidence.faults.malformed.files import file_spoils

__all__ = ["changed", "document_spoils", "field_spoils"]

Change = Callable[[pathlib.Path, Random], None]


def document_spoils() -> dict[str, Change]:
    """Ways of spoiling whatever JSON file of an object."""

    def text(make: Callable[[str], str]) -> Change:
        return lambda path, _: rewrite(path, make(path.read_text()).encode())

    def first(key: str) -> Callable[[str], str]:
        return lambda whole: whole.replace("{", f"{{{key},", 1)

    return {
        **file_spoils(),
        "in UTF-16": lambda path, _: rewrite(path, path.read_text().encode("utf-16")),
        "a list": text(lambda whole: f"[{whole}]"),
        "a number": text(lambda _: "17"),
        "null": text(lambda _: "null"),
        "an empty object": text(lambda _: "{}"),
        "a key twice": text(first('"spare": 1, "spare": 2')),
        "NaN": text(first('"spare": NaN')),
        "infinity": text(first('"spare": -Infinity')),
        "a number beyond all": text(first('"spare": 1e999')),
        "a number of 5000 digits": text(first(f'"spare": {"9" * 5000}')),
        "nested 100000 deep": text(first(f'"spare": {"[" * 100_000}{"]" * 100_000}')),
        "a trailing comma": text(lambda whole: whole.rstrip().removesuffix("}") + ",}"),
        "two documents": text(lambda whole: whole + whole),
    }


def field_spoils(record: Any, fields: Sequence[str]) -> Iterator[tuple[str, Change]]:
    """Each of some fields (``a.b.c``) removed, null, and of other kinds than it is."""
    for field in fields:
        value = record
        for part in field.split("."):
            value = value[part]
        yield f"without {field}", changed(field, remove=True)
        others: list[Any] = [None, "sixty", True, -1.5, [], {}, [[]]]
        kind = float if isinstance(value, float) else type(value)
        for other in others:
            plausible = kind is float and isinstance(other, float)
            if type(other) is not kind and not plausible and not (kind is int and other is True):
                yield f"{field} is {other!r}", changed(field, other)


def changed(field: str, value: Any = None, *, remove: bool = False) -> Change:
    """The document with another value for a field."""

    def change(path: pathlib.Path, random: Random) -> None:
        record = copy.deepcopy(json.loads(path.read_text()))
        *parents, last = field.split(".")
        holder = record
        for part in parents:
            holder = holder[part]
        if remove:
            del holder[last]
        else:
            holder[last] = value
        rewrite(path, json.dumps(record).encode())

    return change
