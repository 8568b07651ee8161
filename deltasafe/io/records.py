"""Convert JSON values to frozen dataclasses. `deltasafe.io.storage.write_json` converts them back."""

import dataclasses
import types
import typing
from typing import Any


def from_json(kind: Any, value: Any) -> Any:
    """Convert a JSON value to ``kind``: a frozen dataclass, a tuple, ``X | None``, or a scalar.

    Raises:
        KeyError, TypeError, ValueError: ``value`` has another form, or unknown keys.
    """
    origin, arguments = typing.get_origin(kind), typing.get_args(kind)
    if origin is types.UnionType:
        return None if value is None else from_json(arguments[0], value)
    if origin is tuple:
        if not isinstance(value, list):
            raise ValueError(f"expected a list, got {value!r}")
        return tuple(from_json(arguments[0], item) for item in value)
    if dataclasses.is_dataclass(kind) and isinstance(kind, type):
        if not isinstance(value, dict):
            raise ValueError(f"expected an object, got {value!r:.60}")
        hints = typing.get_type_hints(kind)
        unknown = sorted(set(value) - set(hints))
        if unknown:
            raise ValueError(f"{kind.__name__} has no {', '.join(unknown)}")
        return kind(**{name: from_json(hints[name], item) for name, item in value.items()})
    accepted = (int, float) if kind is float else (kind,)
    if type(value) not in accepted:
        raise ValueError(f"expected {kind.__name__}, got {value!r}")
    return kind(value)
