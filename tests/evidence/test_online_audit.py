"""The independent audit finds what it has to find."""

import numpy as np

from evidence.online_audit import Driven, Tool, audit, touches

POSE = np.array([0.0, 0.0, 0.05, 0.0])


def test_touches_the_disc_and_the_shaft_only() -> None:
    for point, expected in (
        ((0.029, 0.0, 0.05), True),
        ((0.031, 0.0, 0.05), False),
        ((0.0, 0.016, 0.05), False),
        ((0.0, 0.0, 0.056), True),
        ((0.006, 0.0, 0.1), False),
        ((0.004, 0.0, 0.2), True),
        ((0.0, 0.0, 0.044), False),
    ):
        assert touches(Tool(), POSE, np.array([point])) is expected
    turned = POSE + np.array([0, 0, 0, np.pi / 2])
    assert touches(Tool(), turned, np.array([[0.0, 0.029, 0.05]]))


def test_a_driven_contact_is_told_from_one_at_rest_and_the_distance_is_measured() -> None:
    time_s = np.arange(0, 1, 0.01)
    poses = np.tile(POSE, (100, 1))
    poses[:50, 0] = 0.002 * np.arange(50)
    poses[50:] = poses[49]
    speed = np.where(np.arange(100) < 50, 0.2, 0.0)

    def findings(hand_x_m: float, moves_mps: float = 0.0):  # type: ignore[no-untyped-def]
        driven = Driven(time_s, poses, poses, speed, np.zeros(100))
        return audit(
            Tool(),
            driven,
            lambda t: np.array([[hand_x_m - moves_mps * t, 0.0, 0.05]]),
            lambda age, v: 0.1 * age,
            1,
        )

    assert (findings(0.1).contacts_moving, findings(0.1).contacts_at_rest) == (1, 0)
    late = findings(0.3, 0.2)
    assert (late.contacts_moving, late.contacts_at_rest) == (0, 1)
    far = findings(0.3)
    assert far.contacts_moving == far.contacts_at_rest == 0
    assert abs(far.least_spare_m - (0.3 - 0.096 - 0.03 - 0.1 * 0.48)) < 1e-9
    assert far.is_continuous
