"""Settings of a whole run are looked at before its first step works: a wrong one must not fail an hour later.

The launchpad checks names and types; what is a sensible value is known to the library's settings alone.
"""

from collections.abc import Iterator, Mapping
from typing import Any

import dagster as dg

from assets.config import SettingsConfig
from assets.run_settings import conflicting_deltas
from deltasafe.errors import SettingsError

__all__ = ["wrong_settings"]


def wrong_settings(run_config: Mapping[str, Any]) -> str:
    """Try every setting in a run's configuration; names each wrong one with its step, or is empty."""
    classes, wrong = _config_classes(), []
    for step, given in run_config.get("ops", {}).items():
        if step in classes and given.get("config"):
            wrong += [f"{step}: {error}" for error in _errors(classes[step](**given["config"]))]
    wrong += filter(None, [conflicting_deltas(run_config)])
    return f"nothing was run, since settings are wrong: {'; '.join(wrong)}" if wrong else ""


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
    """The config class of each step that has one, by the name of the step."""
    import assets

    found = {}
    loaded = [*dg.load_assets_from_package_module(assets), *dg.load_asset_checks_from_package_module(assets)]
    for definition in loaded:
        op = getattr(definition, "node_def", None)
        if op is not None and op.compute_fn.has_config_arg():
            found[op.name] = op.compute_fn.get_config_arg().annotation
    return found
