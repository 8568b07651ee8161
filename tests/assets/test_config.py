"""Settings of the library as Dagster config."""

import dataclasses

import dagster as dg
import pytest

from assets.config import configurable
from deltasafe.errors import SettingsError
from deltasafe.execution import ArmSettings, ExecutionSettings
from deltasafe.perception.data.augmentation.settings import AugmentationSettings
from deltasafe.perception.settings import NetworkSettings, TrainingSettings
from deltasafe.planning import MotionSettings, ToolPart
from deltasafe.presets import PRESETS


@pytest.mark.parametrize("preset", PRESETS.values(), ids=PRESETS)
def test_every_setting_of_every_preset_survives_conversion(preset):
    for field in dataclasses.fields(preset):
        settings = getattr(preset, field.name)
        if dataclasses.is_dataclass(settings):
            assert configurable(settings)().settings() == settings


def test_nested_values_can_be_set_and_others_keep_their_defaults():
    config = configurable(TrainingSettings(epochs=7))
    settings = config(network={"backbone": "resnet50"}, batch_size=2).settings()
    assert settings == TrainingSettings(NetworkSettings(backbone="resnet50"), epochs=7, batch_size=2)


def test_tuples_become_lists_and_back():
    config = configurable(AugmentationSettings())
    assert config(left_out=["noise"]).settings().left_out == ("noise",)


def test_parts_of_a_tool_are_a_list_of_forms():
    config = configurable(MotionSettings())
    body = (
        config(body={"parts": [{"kind": "box", "half_x_m": 0.02, "half_y_m": 0.01, "half_z_m": 0.03}]}).settings().body
    )
    assert body.parts == (ToolPart("box", half_x_m=0.02, half_y_m=0.01, half_z_m=0.03),)
    with pytest.raises(SettingsError, match="kind of a part"):
        config(body={"parts": [{"kind": "cone"}]}).settings()


def test_the_arm_is_chosen_in_the_launchpad():
    config = configurable(ExecutionSettings())
    assert config(arm={"model": "panda"}).settings().arm == ArmSettings("panda")
    chosen = config(arm={"model": "a.urdf", "flange_link": "tip", "base_pose": [0.0, 0.5, 0.0, -1.5]}).settings().arm
    assert chosen == ArmSettings("a.urdf", "tip", base_pose=(0.0, 0.5, 0.0, -1.5))
    with pytest.raises(SettingsError, match="iiwa, panda or the path"):
        config(arm={"model": "ur5"}).settings()


def test_an_unknown_key_is_refused_by_dagster():
    config_class = configurable(TrainingSettings())

    @dg.asset
    def reader(config: config_class):
        raise AssertionError

    with pytest.raises(dg.DagsterInvalidConfigError, match="epoch_count"):
        dg.materialize([reader], run_config={"ops": {"reader": {"config": {"epoch_count": 3}}}})


def test_an_invalid_value_raises_the_error_of_the_library():
    with pytest.raises(SettingsError, match="epochs must be at least 1"):
        configurable(TrainingSettings())(epochs=0).settings()


def test_a_run_gets_the_values_of_the_launchpad():
    seen = []
    config_class = configurable(TrainingSettings())

    @dg.asset
    def reader(config: config_class):
        seen.append(config.settings())

    run_config = {"ops": {"reader": {"config": {"epochs": 9, "network": {"architecture": "deeplabv3"}}}}}
    assert dg.materialize([reader], run_config=run_config).success
    assert seen == [TrainingSettings(NetworkSettings(architecture="deeplabv3"), epochs=9)]


@pytest.mark.parametrize(
    ("settings", "field", "description"),
    [
        (TrainingSettings(), "epochs", "passes over the augmented set"),
        (PRESETS["default"].motion, "gamma1_s", "the tracking bound gamma(v)"),
        (PRESETS["default"].motion, "delta", "occupied with at most this probability"),
        (AugmentationSettings(), "left_out", "random draws of the other methods do not change."),
    ],
    ids=["own", "one of two", "inherited", "several lines"],
)
def test_the_form_shows_the_description_of_a_setting(settings, field, description):
    config_class = configurable(settings)

    @dg.asset
    def reader(config: config_class):
        raise AssertionError

    fields = reader.op.config_schema.config_type.fields
    assert description in fields[field].description
