"""Counts in all settings of a preset must be whole numbers."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import pytest

from deltasafe.errors import SettingsError
from deltasafe.presets import PRESETS


def nested(settings: Any) -> Iterator[Any]:
    yield settings
    for field in dataclasses.fields(settings):
        if dataclasses.is_dataclass(value := getattr(settings, field.name)):
            yield from nested(value)


COUNTS = [
    pytest.param(settings, field.name, id=f"{type(settings).__name__}.{field.name}")
    for settings in nested(PRESETS["default"])
    for field in dataclasses.fields(settings)
    if field.type is int
]


@pytest.mark.parametrize(("settings", "name"), COUNTS)
def test_counts_must_be_whole_numbers(settings: Any, name: str) -> None:
    for wrong in (10.5, 10.0, float("nan"), "10", None, True):
        with pytest.raises(SettingsError, match=name):
            dataclasses.replace(settings, **{name: wrong})
