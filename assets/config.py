"""Convert the settings dataclasses of the library to Dagster config, which the UI shows as a form."""

import dataclasses
import inspect
import re
import typing
from typing import Any, Generic, TypeVar

import dagster as dg
import pydantic

S = TypeVar("S")

# an entry of the section "Attributes:" of a docstring, and its continuation lines
_ENTRY = re.compile(r"^ {4}(\w+(?:, \w+)*): (.+(?:\n {8}.+)*)", re.MULTILINE)


class SettingsConfig(dg.Config, Generic[S]):
    """Base class of the config classes that `configurable` creates."""

    _settings_class: typing.ClassVar[type]

    def settings(self) -> S:
        """Return the settings dataclass, which validates its values.

        Raises:
            SettingsError: a value is invalid.
        """
        values = {}
        for name in type(self).model_fields:
            value = getattr(self, name)
            values[name] = value.settings() if isinstance(value, SettingsConfig) else value
            if isinstance(value, list):
                values[name] = tuple(one.settings() if isinstance(one, SettingsConfig) else one for one in value)
        return typing.cast(S, self._settings_class(**values))


def configurable(default: S) -> type[SettingsConfig[S]]:
    """Create a config class with the fields of the dataclass ``default`` and its values as defaults.

    Nested dataclasses become nested config classes. Dagster refuses unknown keys. The launchpad shows the description
    of a field from the docstring of the dataclass.
    """
    settings_class = type(default)
    hints, descriptions = typing.get_type_hints(settings_class), _attribute_descriptions(settings_class)
    fields: dict[str, Any] = {}
    for field in dataclasses.fields(typing.cast(Any, default)):
        value, description = getattr(default, field.name), descriptions.get(field.name)
        if dataclasses.is_dataclass(value):
            nested = configurable(value)
            fields[field.name] = (nested, pydantic.Field(default_factory=nested, description=description))
        elif isinstance(value, tuple):
            item = typing.get_args(hints[field.name])[0]
            if dataclasses.is_dataclass(item) and isinstance(item, type):
                item = configurable(item())
            listed = pydantic.Field(default_factory=lambda value=value: list(value), description=description)
            fields[field.name] = (list[item], listed)
        else:
            fields[field.name] = (hints[field.name], pydantic.Field(value, description=description))
    name = settings_class.__name__.removesuffix("Settings") + "Config"
    config_class = pydantic.create_model(name, __base__=SettingsConfig, __doc__=settings_class.__doc__, **fields)
    config_class._settings_class = settings_class
    return config_class


def _attribute_descriptions(settings_class: type) -> dict[str, str]:
    """Read the descriptions of attributes from the docstrings of a class and its bases."""
    descriptions: dict[str, str] = {}
    for base in reversed(settings_class.__mro__):
        section = inspect.cleandoc(base.__dict__.get("__doc__") or "").partition("\nAttributes:\n")[2]
        for names, text in _ENTRY.findall(section):
            descriptions |= dict.fromkeys(names.split(", "), " ".join(text.split()))
    return descriptions
