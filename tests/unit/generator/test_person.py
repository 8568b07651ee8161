"""Body shapes and poses: effect of shape targets, range of samples, rejection of invalid values."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import DataError, SettingsError
from generator import arm as arm_module
from generator.arm import ArmModel
from generator.person import SIMILAR_PEOPLE, Body, Skin, sample_person, shaped_points_m
from generator.pose import POSES, sample_pose
from generator.skeleton import Skeleton

ARM = ArmModel.load()


def joints(body):
    return Skeleton.from_points(ARM, shaped_points_m(ARM, body)).joints_m


def finger_length(body):
    j = joints(body)
    return sum(np.linalg.norm(j[f"finger-3-{k + 1}"] - j[f"finger-3-{k}"]) for k in (1, 2, 3))


def test_shape_targets_change_named_dimension():
    assert finger_length(Body(finger_length=0.5)) > finger_length(Body()) > finger_length(Body(finger_length=-0.5))
    large, small = (np.linalg.norm(joints(Body(hand_scale=s))["finger-3-4"]) for s in (0.5, -0.5))
    assert large > small
    male, female = (np.linalg.norm(joints(Body(masculinity=m))["finger-3-4"]) for m in (1.0, 0.0))
    assert male > female
    assert 0.15 < female < male < 0.23, "meters from wrist to tip"


@settings(deadline=None, max_examples=10)
@given(st.floats(0.1, 10))
def test_ancestry_weights_are_normalized(scale):
    one, other = Body(ancestry=(0.2, 0.3, 0.5)), Body(ancestry=(0.2 * scale, 0.3 * scale, 0.5 * scale))
    assert np.allclose(shaped_points_m(ARM, one), shaped_points_m(ARM, other))


def test_shape_is_linear_in_age():
    young, middle, old = (shaped_points_m(ARM, Body(age=a)) for a in (0.0, 0.5, 1.0))
    assert np.allclose(middle, (young + old) / 2)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_samples_are_in_range_and_deterministic(seed):
    person = sample_person(np.random.default_rng(seed), (3.0, 5.0))
    assert 3 <= person.skin.tone <= 5
    assert sum(person.body.ancestry) == pytest.approx(1)
    assert person == sample_person(np.random.default_rng(seed), (3.0, 5.0))
    pose = sample_pose(np.random.default_rng(seed), list(POSES))
    assert np.degrees(pose.fingers).max() <= 105.001
    assert np.degrees(np.array(pose.fingers)[:, 1:]).min() >= 0
    assert pose == sample_pose(np.random.default_rng(seed), list(POSES))


def test_pose_without_jitter_and_blending_equals_table_entry():
    pose = sample_pose(np.random.default_rng(0), ["claw"], jitter_rad=0.0, blend=0.0)
    assert np.allclose(pose.fingers, POSES["claw"].fingers)
    assert np.allclose(pose.thumb, POSES["claw"].thumb)


def test_similar_people_have_similar_tones_but_differ():
    one, other = SIMILAR_PEOPLE
    assert abs(one.skin.tone - other.skin.tone) < 1
    assert one != other


@pytest.mark.parametrize(
    "make",
    [
        lambda: Body(age=1.2),
        lambda: Body(ancestry=(0.0, 0.0, 0.0)),
        lambda: Skin(tone=9.5),
        lambda: sample_pose(np.random.default_rng(0), ["wave"]),
        lambda: sample_pose(np.random.default_rng(0), []),
    ],
)
def test_invalid_values_raise_settings_error(make):
    with pytest.raises(SettingsError):
        make()


def test_altered_arm_model_raises_data_error(tmp_path, monkeypatch):
    copy = tmp_path / "arm.npz"
    copy.write_bytes(arm_module.ARM_PATH.read_bytes()[:-1] + b"x")
    monkeypatch.setattr(arm_module, "ARM_PATH", copy)
    with pytest.raises(DataError, match="altered"):
        ArmModel.load.__wrapped__(ArmModel)
