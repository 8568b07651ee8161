"""The generator of the rendered hands and scenes: not part of the wheel, an optional dependency group.

A picture is a function of its recipe, a recipe of settings, surroundings, seed and index. Submodules by the field's
terms: ``person`` and ``arm`` (shape), ``pose``, ``skeleton``, ``skinning``, ``skin``, ``surroundings``, ``staging``,
``render``, ``mask``, ``webcam``. The mathematics needs numpy and scipy; only rendering needs Mitsuba.
"""

from generator.drawing import draw_hand, draw_scene
from generator.hand_sets import make_hands
from generator.scenes import make_scenes
from generator.settings import TEST_LIKE, TRAIN_LIKE, HandSetSettings, SceneSettings
from generator.surroundings import CollisionArrays
from generator.surroundings.fetch import fetch

__all__ = [
    "TEST_LIKE",
    "TRAIN_LIKE",
    "CollisionArrays",
    "HandSetSettings",
    "SceneSettings",
    "draw_hand",
    "draw_scene",
    "fetch",
    "make_hands",
    "make_scenes",
]
