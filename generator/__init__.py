"""Generator of rendered hands and scenes: not part of the wheel, installed as an optional dependency group.

A picture is a function of its recipe, and a recipe is a function of settings, surroundings, seed and index. The modules
in order: ``settings``, ``recipe_sampling``, ``person`` and ``arm`` (shape), ``pose``, ``skeleton``, ``skinning``,
``skin``, ``surroundings``, ``stage_building``, ``render``, ``webcam``, ``hand_sets``, ``scenes``. Only rendering needs
Mitsuba.
"""

from generator.hand_sets import make_hands
from generator.recipe_sampling import sample_hand_recipe, sample_scene_recipe
from generator.scenes import make_scenes
from generator.settings import TEST_LIKE, TRAIN_LIKE, HandSetSettings, SceneSettings
from generator.surroundings import Surroundings
from generator.surroundings.fetch import fetch_surroundings

__all__ = [
    "TEST_LIKE",
    "TRAIN_LIKE",
    "HandSetSettings",
    "SceneSettings",
    "Surroundings",
    "fetch_surroundings",
    "make_hands",
    "make_scenes",
    "sample_hand_recipe",
    "sample_scene_recipe",
]
