"""``evidence.faults.properties`` with few scenes, and planners with defects that it must detect."""

import dataclasses
from random import Random

import pytest

from evidence.faults import properties
from evidence.faults.properties import Outcome, check_motion, check_scene, check_scenes


def test_properties_hold_in_a_few_scenes() -> None:
    outcome = check_scenes(40, seed=1)
    assert outcome.failures == []
    assert outcome.accepted > 100
    assert outcome.edges - outcome.accepted > 100


def test_accepting_every_edge_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(properties, "is_segment_safe", lambda test, start, end: True)
    outcome = check_scenes(5, seed=1)
    assert any("accepted at delta" in failure for failure in outcome.failures)


def test_ignored_margin_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    original = properties.segment_test
    monkeypatch.setattr(properties, "segment_test", lambda field, body, _, checks: original(field, body, 0.0, checks))
    outcome = Outcome()
    for n in range(30):
        check_scene(Random(n), f"scene {n}", outcome)
    assert any("accepted at delta" in failure for failure in outcome.failures)


def test_doubled_speed_is_detected(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = Outcome()
    for n in range(8):
        check_motion(Random(f"{n}"), f"motion {n}", outcome)
    assert outcome.motions > 0
    assert outcome.failures == []
    original = properties.plan_motion

    def at_double_speed(*arguments, **options):  # type: ignore[no-untyped-def]
        motion = original(*arguments, **options)
        if motion.trajectory is None:
            return motion
        faster = dataclasses.replace(motion.trajectory, velocities=2 * motion.trajectory.velocities)
        return dataclasses.replace(motion, trajectory=faster)

    monkeypatch.setattr(properties, "plan_motion", at_double_speed)
    for n in range(8):
        check_motion(Random(f"{n}"), f"motion {n}", outcome)
    assert any("m/s exceeds" in failure for failure in outcome.failures)
