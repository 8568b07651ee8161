"""Corruptions of JSON files: invalid or ambiguous syntax, and fields that are missing or of the wrong type."""

import json
import pathlib
from collections.abc import Callable, Iterator, Sequence
from random import Random
from typing import Any

from evidence.faults.malformed.files import file_changes
from evidence.faults.rejection import Change, rewrite


def document_changes() -> dict[str, Change]:
    """Return the changes that apply to any JSON object."""

    def text(edit: Callable[[str], str]) -> Change:
        return lambda path, _: rewrite(path, edit(path.read_text()).encode())

    def extra(field: str) -> Change:
        return text(lambda document: document.replace("{", f"{{{field},", 1))

    return {
        **file_changes(),
        "UTF-16": lambda path, _: rewrite(path, path.read_text().encode("utf-16")),
        "a list": text(lambda document: f"[{document}]"),
        "a number": text(lambda _: "17"),
        "null": text(lambda _: "null"),
        "an empty object": text(lambda _: "{}"),
        "a duplicate key": extra('"spare": 1, "spare": 2'),
        "NaN": extra('"spare": NaN'),
        "infinity": extra('"spare": -Infinity'),
        "a number that overflows": extra('"spare": 1e999'),
        "a number of 5000 digits": extra(f'"spare": {"9" * 5000}'),
        "nested 100000 deep": extra(f'"spare": {"[" * 100_000}{"]" * 100_000}'),
        "a trailing comma": text(lambda document: document.rstrip().removesuffix("}") + ",}"),
        "two documents": text(lambda document: document + document),
    }


def field_changes(record: Any, fields: Sequence[str]) -> Iterator[tuple[str, Change]]:
    """Yield changes that remove each field (``a.b.c``) of a record, or give it a value of another type."""
    for field in fields:
        value = record
        for key in field.split("."):
            value = value[key]
        yield f"without {field}", with_field(field, remove=True)
        others: list[Any] = [None, "sixty", True, -1.5, [], {}, [[]]]
        kind = float if isinstance(value, float) else type(value)
        for other in others:
            if type(other) is not kind and not (kind is int and other is True):
                yield f"{field} is {other!r}", with_field(field, other)


def with_field(field: str, value: Any = None, *, remove: bool = False) -> Change:
    """Set or remove one field of a document."""

    def change(path: pathlib.Path, random: Random) -> None:
        record = json.loads(path.read_text())
        set_in(record, field.split("."), value, remove=remove)
        rewrite(path, json.dumps(record).encode())

    return change


def set_in(record: Any, keys: Sequence[str], value: Any = None, *, remove: bool = False) -> None:
    """Set or remove the value at a path of keys in nested dictionaries."""
    *parents, last = keys
    for key in parents:
        record = record[key]
    if remove:
        del record[last]
    else:
        record[last] = value
