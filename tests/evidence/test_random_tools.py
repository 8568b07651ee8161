"""The independent checker of random tools: closed forms, and faults that it must find."""

import numpy as np
import pytest

from deltasafe.planning import ToolBody, ToolPart
from deltasafe.scene import OccupancyGrid
from evidence import random_tools
from evidence.random_tools import Checker, Tally, check_scene


def checker(body: ToolBody) -> Checker:
    p_occupied = np.zeros((80, 80, 40), np.float32)
    p_occupied[40:44, 40:44, :20] = 1.0
    return Checker(OccupancyGrid(p_occupied, np.array([-0.2, -0.2, 0.0]), 0.005), body)


def test_clearance_in_closed_form() -> None:
    sphere = checker(ToolBody(shaft_length_m=0.0, parts=(ToolPart("sphere", radius_m=0.01),)))
    assert sphere.at(np.array([0.01, 0.01, 0.13, 0.0]), 1.0) == pytest.approx(0.02)
    assert sphere.at(np.array([-0.03, -0.04, 0.05, 0.0]), 1.0) == pytest.approx(0.04)
    assert sphere.at(np.array([-0.1, -0.1, 0.015, 0.0]), 1.0) == pytest.approx(0.005)
    assert sphere.at(np.array([-0.17, 0.0, 0.05, 0.0]), 1.0) == pytest.approx(0.02)
    disc = checker(ToolBody(shaft_length_m=0.0))
    assert disc.at(np.array([-0.05, 0.01, 0.05, 0.0]), 1.0) == pytest.approx(0.02)
    assert disc.at(np.array([-0.05, 0.01, 0.05, np.pi / 2]), 1.0) == pytest.approx(0.035)
    box = checker(ToolBody(shaft_length_m=0.0, parts=(ToolPart("box", 0, 0, 0, 0.02, 0.01, 0.01),)))
    assert box.at(np.array([0.01, 0.01, 0.15, 0.3]), 1.0) == pytest.approx(0.04)


def test_clearance_along_an_edge_is_that_of_the_nearest_pose() -> None:
    sphere = checker(ToolBody(shaft_length_m=0.0, parts=(ToolPart("sphere", radius_m=0.01),)))
    start, end = np.array([-0.1, 0.01, 0.13, 0.0]), np.array([0.12, 0.01, 0.13, 0.0])
    assert sphere.along(start, end, 0.005, only_violations=False) == pytest.approx(0.02, abs=2e-4)


def test_a_few_scenes_hold() -> None:
    tally = Tally()
    for number in range(1, 5):
        check_scene(number, 0, tally)
    assert tally.failures == []
    assert tally.scenes == 4
    assert tally.edges_accepted > 0


def test_accepted_collisions_and_untyped_errors_are_found(monkeypatch: pytest.MonkeyPatch) -> None:
    tally = Tally()
    monkeypatch.setattr(random_tools, "is_segment_safe", lambda *_: True)
    check_scene(1, 0, tally)
    assert tally.unsafe_accepted > 0
    monkeypatch.setattr(random_tools, "is_segment_safe", lambda *_: 1 / 0)
    check_scene(1, 0, tally)
    assert tally.untyped_exceptions == 1
