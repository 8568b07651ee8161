"""Ranges of settings in mathematical notation."""

import dataclasses
import math

import pytest

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_choice, check_range


@dataclasses.dataclass
class Settings:
    value: object


@pytest.mark.parametrize(
    ("interval", "inside", "outside"),
    [
        ("(0, 1)", [1e-9, 0.5], [0, 1, -1, math.nan, math.inf, -math.inf]),
        ("[0, 1]", [0, 1], [-1e-9, 1.0000001, math.nan]),
        ("[0, 1)", [0, 0.9], [1, math.nan]),
        ("(0, 1]", [1, 0.1], [0]),
        ("[2, inf)", [2, 10**400], [1, math.inf, math.nan]),
        ("[1, 1e6]", [1, 1_000_000, (1, 2)], [(), (1, 0), 0]),
    ],
)
def test_brackets_decide_whether_ends_are_included(interval, inside, outside):
    for value in inside:
        check_range(Settings(value), interval, "value")
    for value in outside:
        with pytest.raises(SettingsError, match="value must be"):
            check_range(Settings(value), interval, "value")


@pytest.mark.parametrize(
    ("interval", "words"),
    [("(0, 1]", "in (0, 1]"), ("[0, inf)", "at least 0"), ("(0, inf)", "positive"), ("(2, inf)", "above 2")],
)
def test_message_names_the_field_the_interval_and_the_value(interval, words):
    with pytest.raises(SettingsError) as caught:
        check_range(Settings(-1), interval, "value")
    assert str(caught.value) == f"value must be {words}, got -1"


def test_choice_must_be_one_of_the_list():
    check_choice(Settings("a"), ("a", "b"), "value")
    with pytest.raises(SettingsError, match="value must be one of a, b, got 'c'"):
        check_choice(Settings("c"), ("a", "b"), "value")
