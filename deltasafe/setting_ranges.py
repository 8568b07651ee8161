"""Ranges of settings, written as in mathematics: ``check_range(self, "(0, 1]", "small_scale")``."""

import math
from collections.abc import Collection

from deltasafe.errors import SettingsError


def check_range(settings: object, interval: str, *names: str) -> None:
    """Require that fields are numbers of an interval, or tuples of such numbers that are not empty.

    Args:
        settings: the object that has the fields.
        interval: with round and square brackets, for example ``[0, 1)`` or ``[1, inf)``.
        names: of the fields.

    Raises:
        SettingsError: names the first field outside of the interval, the interval and the value.
    """
    low, high = map(float, interval[1:-1].split(","))
    for name in names:
        value = getattr(settings, name)
        numbers = value if isinstance(value, tuple) else (value,)
        above = all(low <= number if interval[0] == "[" else low < number for number in numbers)
        below = all(number <= high if interval[-1] == "]" else number < high for number in numbers)
        if not (numbers and above and below):  # NaN is in no interval
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
