"""Settings of the library as Dagster config: the one place where a frozen dataclass becomes a form in the UI."""

import dataclasses
import typing
from typing import Any, Generic, TypeVar

import dagster as dg
import pydantic

__all__ = ["SettingsConfig", "configurable"]

S = TypeVar("S")


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

    Nested dataclasses become nested config; unknown keys are refused by Dagster.
    """
    settings_class = type(default)
    hints = typing.get_type_hints(settings_class)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(typing.cast(Any, default)):
        value = getattr(default, field.name)
        if dataclasses.is_dataclass(value):
            nested = configurable(value)
            fields[field.name] = (nested, pydantic.Field(default_factory=nested))
        elif isinstance(value, tuple):
            item = typing.get_args(hints[field.name])[0]
            fields[field.name] = (list[item], pydantic.Field(default_factory=lambda value=value: list(value)))
        else:
            fields[field.name] = (hints[field.name], value)
    name = settings_class.__name__.removesuffix("Settings") + "Config"
    made = pydantic.create_model(name, __base__=SettingsConfig, __doc__=settings_class.__doc__, **fields)
    made._settings_class = settings_class
    return made
