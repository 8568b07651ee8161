"""Shapes and poses as drawn: targets do what they are called, draws stay in range, bad values are refused."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deltasafe.errors import DataError, SettingsError
from generator import arm as arm_module
from generator.arm import ArmModel
from generator.person import ALIKE, Body, Skin, draw_person, shaped_points_m
from generator.pose import POSES, draw_pose
from generator.skeleton import Skeleton

ARM = ArmModel.load()


def joints(body):
    return Skeleton.of(ARM, shaped_points_m(ARM, body)).joints_m


def finger_length(body):
    j = joints(body)
    return sum(np.linalg.norm(j[f"finger-3-{k + 1}"] - j[f"finger-3-{k}"]) for k in (1, 2, 3))


def test_targets_do_what_they_are_called():
    assert finger_length(Body(finger_length=0.5)) > finger_length(Body()) > finger_length(Body(finger_length=-0.5))
    large, small = (np.linalg.norm(joints(Body(hand_scale=s))["finger-3-4"]) for s in (0.5, -0.5))
    assert large > small
    male, female = (np.linalg.norm(joints(Body(masculinity=m))["finger-3-4"]) for m in (1.0, 0.0))
    assert male > female
    assert 0.15 < female < male < 0.23, "metres from wrist to tip"


@settings(deadline=None, max_examples=10)
@given(st.floats(0.1, 10))
def test_only_the_proportions_of_ancestry_count(scale):
    one, other = Body(ancestry=(0.2, 0.3, 0.5)), Body(ancestry=(0.2 * scale, 0.3 * scale, 0.5 * scale))
    assert np.allclose(shaped_points_m(ARM, one), shaped_points_m(ARM, other))


def test_shape_is_linear_in_age_between_its_ends():
    young, middle, old = (shaped_points_m(ARM, Body(age=a)) for a in (0.0, 0.5, 1.0))
    assert np.allclose(middle, (young + old) / 2)


@settings(deadline=None)
@given(st.integers(0, 2**32 - 1))
def test_draws_stay_in_range_and_follow_their_seed(seed):
    person = draw_person(np.random.default_rng(seed), (3.0, 5.0))
    assert 3 <= person.skin.tone <= 5
    assert sum(person.body.ancestry) == pytest.approx(1)
    assert person == draw_person(np.random.default_rng(seed), (3.0, 5.0))
    pose = draw_pose(np.random.default_rng(seed), list(POSES))
    assert np.degrees(pose.fingers).max() <= 105.001
    assert np.degrees(np.array(pose.fingers)[:, 1:]).min() >= 0
    assert pose == draw_pose(np.random.default_rng(seed), list(POSES))


def test_without_jitter_and_blending_a_pose_is_that_of_the_table():
    pose = draw_pose(np.random.default_rng(0), ["claw"], jitter_rad=0.0, blend=0.0)
    assert np.allclose(pose.fingers, POSES["claw"].fingers)
    assert np.allclose(pose.thumb, POSES["claw"].thumb)


def test_the_two_alike_are_alike_and_differ():
    one, other = ALIKE
    assert abs(one.skin.tone - other.skin.tone) < 1
    assert one != other


@pytest.mark.parametrize(
    "make",
    [
        lambda: Body(age=1.2),
        lambda: Body(ancestry=(0.0, 0.0, 0.0)),
        lambda: Skin(tone=9.5),
        lambda: draw_pose(np.random.default_rng(0), ["wave"]),
        lambda: draw_pose(np.random.default_rng(0), []),
    ],
)
def test_bad_values_are_refused(make):
    with pytest.raises(SettingsError):
        make()


def test_an_altered_model_is_refused(tmp_path, monkeypatch):
    copy = tmp_path / "arm.npz"
    copy.write_bytes(arm_module.ARM_PATH.read_bytes()[:-1] + b"x")
    monkeypatch.setattr(arm_module, "ARM_PATH", copy)
    with pytest.raises(DataError, match="altered"):
        ArmModel.load.__wrapped__(ArmModel)


def test_the_registry_holds_the_models_digest():
    registry = (arm_module.ARM_PATH.parent / "registry.sha256").read_text().split()
    assert registry == [arm_module.ARM_SHA256, "arm.npz"]
    assert dataclasses.is_dataclass(ArmModel)
