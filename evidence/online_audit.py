"""Independent check of live runs: shares no code with the loop; own geometry, brute force over points."""

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Tool:
    """Dimensions of the tool: an elliptic disc, and an upright shaft on it."""

    a_m: float = 0.03
    b_m: float = 0.015
    thickness_m: float = 0.01
    shaft_radius_m: float = 0.005
    shaft_length_m: float = 0.25


def touches(tool: Tool, pose: Array, points_m: Array) -> bool:
    """Whether any of the points (N, 3) lies in the tool at a pose x, y, z, yaw."""
    x, y, z = (points_m - pose[:3]).T
    near = (np.abs(x) < tool.a_m) & (np.abs(y) < tool.a_m)
    x, y, z = x[near], y[near], z[near]
    u = np.cos(pose[3]) * x + np.sin(pose[3]) * y
    v = np.cos(pose[3]) * y - np.sin(pose[3]) * x
    in_disc = ((u / tool.a_m) ** 2 + (v / tool.b_m) ** 2 <= 1) & (np.abs(z) <= tool.thickness_m / 2)
    in_shaft = (u**2 + v**2 <= tool.shaft_radius_m**2) & (z >= 0) & (z <= tool.shaft_length_m)
    return bool((in_disc | in_shaft).any())


def tool_points(tool: Tool) -> Array:
    """Points (M, 3) on the rim of disc and shaft, in the tool's frame."""
    angle = np.linspace(0, 2 * np.pi, 61)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    rings = [
        np.column_stack([circle * [tool.a_m, tool.b_m] * share, np.full(60, z)])
        for share in (1.0, 0.6, 0.3)
        for z in np.linspace(-tool.thickness_m / 2, tool.thickness_m / 2, 3)
    ]
    shaft = [
        np.column_stack([circle[::6] * tool.shaft_radius_m, np.full(10, z)])
        for z in np.arange(0.0, tool.shaft_length_m, 0.008)
    ]
    return np.concatenate(rings + shaft)


@dataclasses.dataclass(frozen=True)
class AuditResult:
    """Findings about a run.

    Attributes:
        contacts_moving, contacts_at_rest: number of contacts; a contact without a gap counts once, and as moving
            as soon as the tool moves in it.
        least_spare_m: smallest distance to the hand as it was in the image, beyond what the argument asks for.
        is_continuous: whether the reference never moved faster than stated; 1 cm/s is allowed for what lies between two
            samples.
    """

    contacts_moving: int
    contacts_at_rest: int
    least_spare_m: float
    is_continuous: bool


@dataclasses.dataclass(frozen=True)
class Driven:
    """What is checked of a run, by time.

    Attributes:
        time_s: (N,).
        reference, executed: (N, 4) poses x, y, z, yaw.
        speed_mps: (N,) reference speed of the tool's fastest point.
        captured_s: (N,) capture time of the image that the motion was accepted with; NaN at rest.
    """

    time_s: Array
    reference: Array
    executed: Array
    speed_mps: Array
    captured_s: Array


def audit(
    tool: Tool,
    run: Driven,
    hand_at: Callable[[float], Array],
    needed_m: Callable[[float, float], float],
    every: int = 2,
) -> AuditResult:
    """Check a run against the true hand.

    Args:
        hand_at: dense points (P, 3) on the true hand at a time.
        needed_m: distance that a pose of the reference needs from the hand in the image, at an age of the image and a
            speed: r + v_hand age + gamma.
        every: samples between two poses that are checked for contact; distances are measured at each fourth of them.
    """
    time_s, reference, speed_mps = run.time_s, run.reference, run.speed_mps
    moving = speed_mps > 1e-9
    touching = {True: False, False: False}
    contacts = {True: 0, False: 0}
    spare_m, trees = np.inf, {}
    rim = tool_points(tool)
    for n in range(0, len(time_s), every):
        is_moving = bool(moving[max(n - every + 1, 0) : n + 1].any())
        hit = touches(tool, run.executed[n], hand_at(float(time_s[n])))
        contacts[is_moving] += hit and not touching[is_moving] and (is_moving or not touching[True])
        touching = {True: hit and (is_moving or touching[True]), False: hit and not is_moving}
        if moving[n] and n % (4 * every) == 0 and np.isfinite(run.captured_s[n]):
            seen_s = float(run.captured_s[n])
            if seen_s not in trees:
                trees = {seen_s: cKDTree(hand_at(seen_s))}
            cos, sin = np.cos(reference[n, 3]), np.sin(reference[n, 3])
            turned = rim @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]]) + reference[n, :3]
            far_m = float(trees[seen_s].query(turned)[0].min())
            spare_m = min(spare_m, far_m - needed_m(float(time_s[n]) - seen_s, float(speed_mps[n])))
    steps = np.linalg.norm(np.diff(reference[:, :3], axis=0), axis=1) + tool.a_m * np.abs(np.diff(reference[:, 3]))
    fastest = np.maximum(speed_mps[:-1], speed_mps[1:])
    continuous = bool((steps <= (fastest + 0.01) * np.diff(time_s) + 1e-9).all())
    return AuditResult(contacts[True], contacts[False], spare_m, continuous)
