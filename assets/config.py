"""Settings of the library as Dagster config: the one place where a frozen dataclass becomes a form in the UI."""

import dataclasses
import inspect
import re
import typing
from typing import Any, Generic, TypeVar

import dagster as dg
import pydantic

__all__ = ["SettingsConfig", "configurable"]

S = TypeVar("S")

# an entry of the section "Attributes:" of a docstring; its further lines are indented deeper
_ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): (.+(?:\n {8}.+)*)", re.MULTILINE)


class SettingsConfig(dg.Config, Generic[S]):
    """Base of the classes that `configurable` makes; `settings` gives the library's own object back."""

    _settings_class: typing.ClassVar[type]

    def settings(self) -> S:
        """The frozen dataclass, validated by its own rules."""
        values = {}
        for name in type(self).model_fields:
            value = getattr(self, name)
            values[name] = value.settings() if isinstance(value, SettingsConfig) else value
            if isinstance(value, list):
                values[name] = tuple(value)
        return typing.cast(S, self._settings_class(**values))


def configurable(default: S) -> type[SettingsConfig[S]]:
    """A config class with the fields of the dataclass ``default`` and its values as defaults.

    Nested dataclasses become nested config; unknown keys are refused by Dagster. What the docstring says of a field is
    shown beside it in the launchpad.
    """
    settings_class = type(default)
    hints, said = typing.get_type_hints(settings_class), _attributes(settings_class)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(typing.cast(Any, default)):
        value, description = getattr(default, field.name), said.get(field.name)
        if dataclasses.is_dataclass(value):
            nested = configurable(value)
            fields[field.name] = (nested, pydantic.Field(default_factory=nested, description=description))
        elif isinstance(value, tuple):
            item = typing.get_args(hints[field.name])[0]
            listed = pydantic.Field(default_factory=lambda value=value: list(value), description=description)
            fields[field.name] = (list[item], listed)
        else:
            fields[field.name] = (hints[field.name], pydantic.Field(value, description=description))
    name = settings_class.__name__.removesuffix("Settings") + "Config"
    made = pydantic.create_model(name, __base__=SettingsConfig, __doc__=settings_class.__doc__, **fields)
    made._settings_class = settings_class
    return made


def _attributes(settings_class: type) -> dict[str, str]:
    """What the docstrings of a class and of its bases say of each attribute."""
    said: dict[str, str] = {}
    for base in reversed(settings_class.__mro__):
        section = inspect.cleandoc(base.__dict__.get("__doc__") or "").partition("\nAttributes:\n")[2]
        for names, text in _ENTRY.findall(section):
            said |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return said
