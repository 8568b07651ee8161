"""A share of ``python -m evidence.faults.properties``, and that it would see what it looks for."""

from random import Random

import pytest

from evidence.faults import properties
from evidence.faults.properties import Outcome, check_motion, check_scene, try_scenes


def test_no_property_is_broken_in_a_few_scenes() -> None:
    outcome = try_scenes(40, seed=1)
    assert outcome.failures == []
    assert outcome.accepted > 100
    assert outcome.edges - outcome.accepted > 100


def test_a_test_that_accepts_everything_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(properties, "is_segment_safe", lambda test, start, end: True)
    outcome = try_scenes(5, seed=1)
    assert any("a point has" in words for words in outcome.failures)


def test_a_test_that_ignores_its_margin_is_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    genuine = properties.segment_test
    monkeypatch.setattr(properties, "segment_test", lambda field, body, margin_m, how: genuine(field, body, 0.0, how))
    outcome = Outcome()
    for n in range(30):
        check_scene(Random(n), f"scene {n}", outcome)
    assert any("a point has" in words for words in outcome.failures)


def test_a_faster_motion_would_be_found_out(monkeypatch: pytest.MonkeyPatch) -> None:
    outcome = Outcome()
    for n in range(8):
        check_motion(Random(f"{n}"), f"motion {n}", outcome)
    assert outcome.motions > 0
    assert outcome.failures == []
    genuine = properties.plan_motion

    def at_double_speed(*arguments, **options):  # type: ignore[no-untyped-def]
        import dataclasses

        motion = genuine(*arguments, **options)
        if motion.trajectory is None:
            return motion
        faster = dataclasses.replace(motion.trajectory, velocities=2 * motion.trajectory.velocities)
        return dataclasses.replace(motion, trajectory=faster)

    monkeypatch.setattr(properties, "plan_motion", at_double_speed)
    for n in range(8):
        check_motion(Random(f"{n}"), f"motion {n}", outcome)
    assert any("m/s" in words for words in outcome.failures)
