"""Ranges of settings, written as in mathematics: ``check_range(self, "(0, 1]", "small_scale")``."""

import dataclasses
import math
import numbers
from collections.abc import Collection

from deltasafe.errors import SettingsError


def check_range(settings: object, interval: str, *names: str) -> None:
    """Require that fields are numbers of an interval, or tuples of such numbers that are not empty.

    Fields of the type ``int`` must be whole numbers: a count of 10.5 would run forever or be rounded silently.

    Args:
        settings: the object that has the fields.
        interval: with round and square brackets, for example ``[0, 1)`` or ``[1, inf)``.
        names: of the fields.

    Raises:
        SettingsError: names the first field outside of the interval, the interval and the value.
    """
    low, high = map(float, interval[1:-1].split(","))
    types = {field.name: field.type for field in dataclasses.fields(settings)}  # type: ignore[arg-type]
    for name in names:
        value = getattr(settings, name)
        values = value if isinstance(value, tuple) else (value,)
        kind = numbers.Integral if types.get(name) in (int, tuple[int, ...]) else numbers.Real
        if not values or not all(isinstance(one, kind) and not isinstance(one, bool) for one in values):
            words = "whole numbers" if kind is numbers.Integral else "numbers"
            raise SettingsError(f"{name} must be {words} in {interval}, got {value!r}")
        above = all(low <= number if interval[0] == "[" else low < number for number in values)
        below = all(number <= high if interval[-1] == "]" else number < high for number in values)
        if not (above and below):  # NaN is in no interval
            raise SettingsError(f"{name} must be {_in_words(interval, low, high)}, got {value}")


def check_choice(settings: object, choices: Collection[str], name: str) -> None:
    """Require that a field is one of the choices.

    Raises:
        SettingsError: names the field, the choices and the value.
    """
    if getattr(settings, name) not in choices:
        raise SettingsError(f"{name} must be one of {', '.join(choices)}, got {getattr(settings, name)!r}")


def _in_words(interval: str, low: float, high: float) -> str:
    if high < math.inf:
        return f"in {interval}"
    return f"at least {low:g}" if interval[0] == "[" else "positive" if low == 0 else f"above {low:g}"
