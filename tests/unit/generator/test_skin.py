"""Skin: order of tones, anatomical position of marks, determinism."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.arm import ArmModel
from generator.person import Body, Skin, shaped_points_m
from generator.pose import POSES
from generator.skeleton import Skeleton
from generator.skin import Regions, paint_skin
from generator.skin.palette import TONES_SRGB, linear_to_srgb, palm_albedo, srgb_to_linear, tone_albedo

ARM = ArmModel.load()
REGIONS = Regions.from_skeleton(ARM, Skeleton.from_points(ARM, shaped_points_m(ARM, Body())))
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@given(st.lists(st.floats(0, 255), min_size=3, max_size=3))
def test_srgb_round_trip(color):
    assert 255 * linear_to_srgb(srgb_to_linear(color)) == pytest.approx(color, abs=1e-9)


def test_tones_darken_monotonically_and_palms_vary_less_than_backs():
    tones = np.linspace(0, 9, 37)
    backs = [tone_albedo(tone) @ LUMINANCE for tone in tones]
    palms = [palm_albedo(tone) @ LUMINANCE for tone in tones]
    assert (np.diff(backs) < 0).all()
    assert max(palms) / min(palms) < 0.5 * max(backs) / min(backs)
    assert np.allclose(tone_albedo(4), srgb_to_linear(TONES_SRGB[4]))


def test_palm_is_below_back_and_not_on_forearm():
    palm = REGIONS.points_mm[REGIONS.palmar > 0.9]
    assert palm[:, 2].mean() < REGIONS.points_mm[REGIONS.dorsal > 0.9][:, 2].mean()
    assert palm[:, 0].min() > -30, "palm skin on the forearm"
    assert np.allclose(REGIONS.palmar[REGIONS.hand_weight < 0.1], 0)


def test_dark_hand_has_lighter_palm_and_darker_back_than_light_hand():
    light, dark = (paint_skin(REGIONS, Skin(tone=tone), POSES["flat"]).albedo @ LUMINANCE for tone in (0.5, 8.5))
    back, palm = (REGIONS.dorsal > 0.9) & (REGIONS.hand_weight > 0.9), REGIONS.palmar > 0.9
    assert dark[palm].mean() > 1.5 * dark[back].mean()
    assert light[back].mean() > 4 * dark[back].mean()


def test_polish_changes_five_nails_only():
    bare, painted = (paint_skin(REGIONS, Skin(nail_polish=p), POSES["flat"]).albedo for p in (None, (30, 30, 200)))
    changed = np.abs(bare - painted).max(axis=1) > 0.2
    tips = {f for f in range(1, 6) if (changed & (REGIONS.bone_weights[f"finger{f}-3"] > 0.5)).any()}
    on_tips = sum(REGIONS.bone_weights[f"finger{f}-3"] for f in range(1, 6)) > 0.5
    assert tips == {1, 2, 3, 4, 5}
    assert on_tips[changed].all()
    assert (REGIONS.palm_facing[changed] < 0).all()


def test_creases_are_darker_than_skin_between_joints():
    albedo = paint_skin(REGIONS, Skin(seed=3), POSES["flat"]).albedo @ LUMINANCE
    joint = REGIONS.joints_mm["finger-3-2"]
    along = (REGIONS.points_mm - joint) @ REGIONS.bone_directions["finger3-2"]
    finger = (REGIONS.digit_weights[3] > 0.8) & (REGIONS.palm_facing > 0.5)
    crease, between = finger & (np.abs(along) < 1.8), finger & (along > 7) & (along < 11)
    assert albedo[crease].mean() < 0.93 * albedo[between].mean()


def test_skin_is_deterministic_and_within_physical_bounds():
    skin = Skin(tone=4.2, redness=1.0, veins=0.9, wrinkles=1.1, hair=0.8, freckles=0.9, seed=11)
    one, same = (paint_skin(REGIONS, skin, POSES["fist"]) for _ in range(2))
    other = paint_skin(REGIONS, dataclasses.replace(skin, seed=12), POSES["fist"])
    assert np.array_equal(one.albedo, same.albedo)
    assert np.array_equal(one.relief_m, same.relief_m)
    assert not np.array_equal(one.albedo, other.albedo)
    for painted in (one, other):
        assert painted.albedo.min() > 0
        assert painted.albedo.max() <= 0.95
        assert np.abs(painted.relief_m).max() < 0.003
