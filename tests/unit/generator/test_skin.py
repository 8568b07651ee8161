"""Skin: colours order as tones do, marks lie where anatomy puts them, nothing depends on anything but the recipe."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from generator.arm import ArmModel
from generator.person import Body, Skin, shaped_points_m
from generator.pose import POSES
from generator.skeleton import Skeleton
from generator.skin import Regions, paint
from generator.skin.palette import TONES, darkness_of, linear, palm_albedo, srgb, tone_albedo

ARM = ArmModel.load()
REGIONS = Regions.of(ARM, Skeleton.of(ARM, shaped_points_m(ARM, Body())))
LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@given(st.lists(st.floats(0, 255), min_size=3, max_size=3))
def test_srgb_undoes_linear(colour):
    assert 255 * srgb(linear(colour)) == pytest.approx(colour, abs=1e-9)


def test_the_palette_runs_from_light_to_dark_and_palms_are_more_alike_than_backs():
    tones = np.linspace(0, 9, 37)
    backs = [tone_albedo(tone) @ LUMINANCE for tone in tones]
    palms = [palm_albedo(tone) @ LUMINANCE for tone in tones]
    assert (np.diff(backs) < 0).all()
    assert max(palms) / min(palms) < 0.5 * max(backs) / min(backs)
    assert np.allclose(tone_albedo(4), linear(TONES[4]))
    assert darkness_of(0) == 0
    assert darkness_of(9) == 1


def test_palm_and_back_are_where_they_should_be():
    palm = REGIONS.points_mm[REGIONS.palmar > 0.9]
    assert palm[:, 2].mean() < REGIONS.points_mm[REGIONS.dorsal > 0.9][:, 2].mean()
    assert palm[:, 0].min() > -30, "the forearm has no palm"
    assert np.allclose(REGIONS.palmar[REGIONS.hand_share < 0.1], 0)


def test_a_dark_hand_is_darker_on_the_back_than_on_the_palm_and_than_a_light_one():
    light, dark = (paint(REGIONS, Skin(tone=tone), POSES["flat"]).albedo @ LUMINANCE for tone in (0.5, 8.5))
    back, palm = (REGIONS.dorsal > 0.9) & (REGIONS.hand_share > 0.9), REGIONS.palmar > 0.9
    assert dark[palm].mean() > 1.5 * dark[back].mean()
    assert light[back].mean() > 4 * dark[back].mean()


def test_polish_shows_on_five_nails_and_nowhere_else():
    bare, painted = (paint(REGIONS, Skin(nail_polish=p), POSES["flat"]).albedo for p in (None, (30, 30, 200)))
    changed = np.abs(bare - painted).max(axis=1) > 0.2
    tips = {f for f in range(1, 6) if (changed & (REGIONS.bone_share[f"finger{f}-3"] > 0.5)).any()}
    on_tips = sum(REGIONS.bone_share[f"finger{f}-3"] for f in range(1, 6)) > 0.5
    assert tips == {1, 2, 3, 4, 5}
    assert on_tips[changed].all()
    assert (REGIONS.palm_facing[changed] < 0).all()


def test_creases_are_darker_than_the_skin_between_them():
    albedo = paint(REGIONS, Skin(seed=3), POSES["flat"]).albedo @ LUMINANCE
    joint = REGIONS.joints_mm["finger-3-2"]
    along = (REGIONS.points_mm - joint) @ REGIONS.along["finger3-2"]
    finger = (REGIONS.finger_share[3] > 0.8) & (REGIONS.palm_facing > 0.5)
    crease, between = finger & (np.abs(along) < 1.8), finger & (along > 7) & (along < 11)
    assert albedo[crease].mean() < 0.93 * albedo[between].mean()


def test_skin_is_a_function_of_its_seed_and_stays_physical():
    skin = Skin(tone=4.2, redness=1.0, veins=0.9, wrinkles=1.1, hair=0.8, freckles=0.9, seed=11)
    one, same = (paint(REGIONS, skin, POSES["fist"]) for _ in range(2))
    other = paint(REGIONS, dataclasses.replace(skin, seed=12), POSES["fist"])
    assert np.array_equal(one.albedo, same.albedo)
    assert np.array_equal(one.relief_m, same.relief_m)
    assert not np.array_equal(one.albedo, other.albedo)
    for painted in (one, other):
        assert painted.albedo.min() > 0
        assert painted.albedo.max() <= 0.95
        assert np.abs(painted.relief_m).max() < 0.003
