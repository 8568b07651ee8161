"""Validate the settings of a whole run before its first step, so that a run does not fail after hours of work.

The launchpad checks names and types; the settings classes of the library check values.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import dagster as dg

from assets.config import SettingsConfig
from assets.run_settings import conflicting_deltas
from deltasafe.errors import SettingsError

__all__ = ["wrong_settings"]


def wrong_settings(run_config: Mapping[str, Any]) -> str:
    """Validate all settings of a run configuration; return one message with all errors, or an empty string."""
    classes, errors = _config_classes(), []
    for step, given in run_config.get("ops", {}).items():
        if step in classes and given.get("config"):
            errors += [f"{step}: {error}" for error in _errors(classes[step](**given["config"]))]
    errors += filter(None, [conflicting_deltas(run_config)])
    return f"nothing was run, since settings are wrong: {'; '.join(errors)}" if errors else ""


def _errors(config: dg.Config) -> Iterator[str]:
    if isinstance(config, SettingsConfig):
        try:
            config.settings()
        except SettingsError as error:
            yield str(error)
        return
    for name in type(config).model_fields:
        value = getattr(config, name)
        if isinstance(value, dg.Config):
            yield from (f"{name}: {error}" for error in _errors(value))


def _config_classes() -> dict[str, type[dg.Config]]:
    """Return the config class of each step that has one, by step name."""
    import assets

    classes = {}
    definitions = [*dg.load_assets_from_package_module(assets), *dg.load_asset_checks_from_package_module(assets)]
    for definition in definitions:
        op = getattr(definition, "node_def", None)
        if op is not None and op.compute_fn.has_config_arg():
            classes[op.name] = op.compute_fn.get_config_arg().annotation
    return classes
