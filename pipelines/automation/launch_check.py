"""Validate settings and inputs of a whole run before its first step, so that a run does not fail after hours of work.

The launchpad checks names and types; the settings classes of the library check values, and its readers the files.
"""

import dataclasses
from collections.abc import Collection, Iterator, Mapping
from typing import Any

import dagster as dg

from assets.config import SettingsConfig
from assets.interfaces import Store
from assets.run_settings import conflicting_deltas
from deltasafe.errors import DataError, DeltasafeError, SettingsError
from deltasafe.perception.data.dataset_info import DatasetInfo
from pipelines.home import require_obstacle


def launch_error(run_config: Mapping[str, Any], steps: Collection[str], store: Store) -> str:
    """Return why a run of ``steps`` must not start, with all errors; empty if it may."""
    return wrong_settings(run_config) or defective_inputs(run_config, steps, store)


_ASKED_FOR = {
    "logged_scene": "single_scene",
    "study_cell": "perception_study",
    "planner_costs": "planner_study",
    "safety_trials": "safety_study",
    "tracking_bound": "tracking_study",
}
"""First asset and job of what is made only if it is asked for."""
_MAX_ASKED_FOR = 2


def lineage_error(selected: Collection[str]) -> str:
    """Return why the chain and (nearly) everything else must not be made together; empty if that was not selected.

    *Materialize all* in the unfiltered lineage selects it, and Dagster cannot exclude assets from that button.
    """
    jobs = sorted(job for asset, job in _ASKED_FOR.items() if asset in selected)
    if "ensemble_member" not in selected or len(jobs) <= _MAX_ASKED_FOR:
        return ""
    return (
        "nothing was run, since all assets were selected, with studies that take hours: for the chain use the job "
        f"everything; the others have the jobs {', '.join(jobs)}"
    )


def wrong_settings(run_config: Mapping[str, Any]) -> str:
    """Validate all settings of a run configuration; return one message with all errors, or an empty string."""
    classes, errors = _config_classes(), []
    for step, given in run_config.get("ops", {}).items():
        if step in classes and given.get("config"):
            errors += [f"{step}: {error}" for error in _errors(classes[step](**given["config"]))]
    errors += filter(None, [conflicting_deltas(run_config)])
    return f"nothing was run, since settings are wrong: {'; '.join(errors)}" if errors else ""


def defective_inputs(run_config: Mapping[str, Any], steps: Collection[str], store: Store) -> str:
    """Read every folder that ``steps`` of a run read; return one message with all defects, or an empty string.

    Args:
        run_config: its settings must be valid.
        steps: names of the steps of the run.
        store: finds the packaged inputs.
    """
    from deltasafe.trials.run_inputs import InputFolder, RunInputs

    classes = _config_classes()

    def config(step: str) -> Any:
        return classes[step](**run_config.get("ops", {}).get(step, {}).get("config", {}))

    unconverted: list[str] = []

    def folder(step: str, field: str, packaged: str = "") -> InputFolder | None:
        if step not in steps or not ((chosen := getattr(config(step), field)) or packaged):
            return None
        return InputFolder(*store.dataset(chosen, packaged))

    def hands(step: str, packaged: str) -> InputFolder | None:
        if step not in steps:
            return None
        try:
            return InputFolder(*config(step).input(store, step, packaged))
        except DeltasafeError as error:
            unconverted.append(f"{step}: {error}")
            return None

    inputs = RunInputs(
        training=hands("raw_hands", "hands/train"),
        test=hands("test_hands", "hands/test"),
        calibration=folder("calibration_report", "calibration_folder"),
        backgrounds=folder("augmented_hands", "backgrounds", "backgrounds"),
        scenes=folder("logged_scenes", "folder", "scenes"),
    )
    if inputs.scenes is not None:
        inputs = dataclasses.replace(inputs, n_scenes=config("logged_scenes").n_scenes)
    defects = unconverted + inputs.defects()
    if inputs.training is not None and not defects:
        try:
            require_obstacle(store.home, DatasetInfo.load(inputs.training.folder).obstacle)
        except DataError as error:
            defects.append(f"training images: {error}")
    listed = "".join(f"\n{defect}" for defect in defects)
    return f"nothing was run, since inputs are defective:{listed}" if defects else ""


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
