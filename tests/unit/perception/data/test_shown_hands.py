"""The check of an augmented set counts hands by original, and says what to do about lost ones."""

import types

import numpy as np
import pytest

from deltasafe.perception.data.dataset_info import HANDS
from deltasafe.perception.data.shown_hands import ShownHands


def made(masks_of: dict[str, list[int]], without_hand: tuple[str, ...] = ()) -> ShownHands:
    """Masks of 10 x 10 pixels; the numbers are the hand's rows in each image of an original."""
    masks, recipes = [], []
    for source, rows in masks_of.items():
        for n in rows:
            mask = np.zeros((10, 10), np.uint8)
            mask[:n] = 1
            masks.append(mask)
            recipes.append({"source": source})
    data = types.SimpleNamespace(
        masks=np.array(masks), recipes=recipes, n=len(masks), without_hand=without_hand, info=HANDS
    )
    return ShownHands.of(data)


def test_originals_without_a_hand_are_not_counted() -> None:
    shown = made({"a": [3, 3], "table": [0, 0]}, without_hand=("table",))
    assert shown.passed
    assert (shown.fraction, shown.coverage) == (1.0, pytest.approx(0.3))
    assert not made({"a": [3, 3], "table": [0, 0]}).passed


def test_lost_hands_are_named_with_a_remedy() -> None:
    shown = made({"a": [3] * 9 + [0], "b": [3] * 8 + [0, 0], "c": [3] * 10})
    assert not shown.passed
    assert shown.fraction == pytest.approx(0.9)
    assert "the hand of b (80%), a (90%)" in shown.sentence()
    assert shown.sentence().endswith("crop these originals closer around the hand")


@pytest.mark.parametrize(("rows", "remedy"), [(9, "are the masks inverted?"), (6, "(2 to 60 % required)")])
def test_coverage_outside_its_range_has_a_remedy(rows: int, remedy: str) -> None:
    shown = made({"a": [rows, rows]})
    assert shown.passed == (rows == 6)
    assert shown.sentence().endswith(remedy)


def test_hands_that_are_too_small_have_a_remedy() -> None:
    shown = ShownHands({"a": 1.0}, 0.01)
    assert not shown.passed
    assert shown.sentence().endswith("the hands are too small: crop the originals closer around them")
