"""Random planner scenes by the thousand: what the continuous test accepts is safe, and more caution accepts no more.

A scene is a small field of random shapes, a level delta and a margin; edges are random, many of them close to what is
unsafe. An accepted edge is looked at again by brute force that shares no code with the test: points of the body, grown
by the margin, at poses a millimetre apart, asked of the field itself. In every twentieth scene a whole motion is
planned and sampled ten times finer than the controller does: speeds stay within their limits, and the body grown by
the tracking error at the speed that it has there stays in what is free.

The continuous test may refuse what clears the margin by less than its resolution, a millimetre, for it cannot decide
it; where its poses fall, and so what it decides, depends on the field. What a test with a larger margin or a smaller
delta accepts must therefore be accepted at the finest resolution; what was refused at the ordinary one is counted.
"""

import dataclasses
import sys
from random import Random

import numpy as np
from numpy.typing import NDArray

from deltasafe.geometry import Pose
from deltasafe.planning import (
    CheckSettings,
    MotionSettings,
    SafetyField,
    ToolBody,
    is_segment_safe,
    plan_motion,
    segment_test,
)
from deltasafe.progress import Progress, silent
from deltasafe.scene import Cuboid, OccupancyGrid, Shape, Sphere, grid_from_shapes
from deltasafe.trials.audit import audit_path
from evidence.faults.reporting import conclude, parser, progress_every

__all__ = ["Outcome", "check_motion", "check_scene", "main", "try_scenes"]

LOWER_M, UPPER_M = (-0.09, -0.08, 0.0), (0.09, 0.08, 0.05)
EDGES = 12
FINEST_M = 1e-5
SCENES_A_MOTION = 20
POSES_OF_MOTION = 200
VOXELS_M = (0.0025, 0.004, 0.005, 0.0075)


@dataclasses.dataclass
class Outcome:
    """What was tried, and what was wrong with it."""

    scenes: int = 0
    edges: int = 0
    accepted: int = 0
    poses: int = 0
    motions: int = 0
    undecided: int = 0
    failures: list[str] = dataclasses.field(default_factory=list)


def try_scenes(count: int, seed: int, progress: Progress = silent) -> Outcome:
    """``count`` random scenes."""
    outcome = Outcome()
    for done in range(1, count + 1):
        check_scene(Random(f"{seed} {done}"), f"scene {done} of seed {seed}", outcome)
        if done % SCENES_A_MOTION == 0:
            check_motion(Random(f"{seed} {done} motion"), f"motion {done} of seed {seed}", outcome)
        progress(done, count, f"{outcome.accepted} edges accepted, {len(outcome.failures)} failures")
    return outcome


def check_scene(random: Random, name: str, outcome: Outcome) -> None:
    """All properties of one scene."""
    grid, delta = _grid(random), random.uniform(0.02, 0.6)
    margin_m = random.choice((0.0, random.uniform(0.0, 0.003), random.uniform(0.003, 0.015)))
    body = _body(random)
    field = SafetyField.build(grid, delta)
    test = segment_test(field, body, margin_m, CheckSettings())
    wider = segment_test(field, body, min(margin_m + random.choice((1e-5, 0.0005, 0.003)), 0.02), CheckSettings())
    stricter = segment_test(field.at(delta * random.choice((0.5, 0.9, 0.999))), body, margin_m, CheckSettings())
    finest = segment_test(field, body, margin_m, CheckSettings(resolution_m=FINEST_M))
    points = _enlarged(body, margin_m)
    outcome.scenes += 1
    for n in range(EDGES):
        start, end = _edge(random)
        outcome.edges += 1
        words = f"{name}, edge {n} from {start.tolist()} to {end.tolist()}"
        if is_segment_safe(test, start, end) != is_segment_safe(test, end, start):
            outcome.failures.append(f"{words}: the answer depends on the direction")
        if is_segment_safe(test, start, end):
            outcome.accepted += 1
            looked = audit_path(np.stack([start, end]), grid, points, delta, body.rho_max_m)
            outcome.poses += looked.poses
            if looked.unsafe_poses:
                outcome.failures.append(f"{words}: accepted at delta {delta}, a point has {looked.worst_p_occupied}")
            continue
        for kind, more_careful in (("larger margin", wider), ("smaller delta", stricter)):
            if is_segment_safe(more_careful, start, end):
                outcome.undecided += 1
                if is_segment_safe(finest, start, end):
                    continue
                outcome.failures.append(f"{words}: refused, but accepted with a {kind}")


def check_motion(random: Random, name: str, outcome: Outcome) -> None:
    """A whole motion, if there is one between two poses beside the obstacles."""
    grid, settings = (
        _grid(random, 2),
        MotionSettings(n_iterations=400, rate_hz=10_000.0, delta=random.uniform(0.02, 0.6)),
    )
    ends = [
        Pose(x, random.uniform(-0.03, 0.03), random.uniform(0.015, 0.07), random.uniform(-1, 1)) for x in (-0.04, 0.04)
    ]
    motion = plan_motion(grid, ends[0], ends[1], 0.0, settings, random.randrange(2**31))
    if motion.trajectory is None:
        return
    outcome.motions += 1
    velocities, poses, body = motion.trajectory.velocities, motion.trajectory.poses, motion.body
    speed_mps = np.linalg.norm(velocities[:, :3], axis=1) + body.rho_max_m * np.abs(velocities[:, 3])
    if speed_mps.max() > settings.v_max_mps * (1 + 1e-9):
        outcome.failures.append(f"{name}: {speed_mps.max()} m/s, allowed are {settings.v_max_mps}")
    if np.abs(velocities[:, 3]).max() > settings.yaw_rate_radps * (1 + 1e-9):
        outcome.failures.append(f"{name}: turns at {np.abs(velocities[:, 3]).max()} rad/s")
    for n in random.sample(range(len(poses)), min(POSES_OF_MOTION, len(poses))):
        error_m = float(motion.tracking.error_m(max(speed_mps[n], settings.v_min_mps)))
        points = body.samples(error_m, 1500, seed=7)
        looked = audit_path(poses[n][None], grid, points, settings.delta, body.rho_max_m)
        outcome.poses += 1
        if looked.unsafe_poses:
            words = f"{name}, sample {n}: {speed_mps[n]} m/s"
            outcome.failures.append(f"{words}, and {1e3 * error_m} mm away is {looked.worst_p_occupied}")


def _grid(random: Random, most: int = 4) -> OccupancyGrid:
    shapes: list[Shape] = []
    for _ in range(random.randint(1, most)):
        x, y = random.uniform(-0.08, 0.08), random.uniform(-0.07, 0.07)
        if random.random() < 0.5:
            shapes.append(Sphere((x, y, random.uniform(0.0, 0.05)), random.uniform(0.004, 0.02)))
        else:
            half = (random.uniform(0.003, 0.02), random.uniform(0.003, 0.02), random.uniform(0.003, 0.02))
            shapes.append(Cuboid((x, y, half[2]), half, random.uniform(0.0, 3.1)))
    return grid_from_shapes(shapes, random.uniform(0.003, 0.02), LOWER_M, UPPER_M, random.choice(VOXELS_M))


def _body(random: Random) -> ToolBody:
    if random.random() < 0.5:
        return ToolBody()
    a, b = random.uniform(0.006, 0.03), random.uniform(0.006, 0.03)
    return ToolBody(a, b, random.uniform(0.002, 0.012), 0.004, random.choice((0.0, 0.25)))


def _edge(random: Random) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    start = np.array([random.uniform(-0.08, 0.08), random.uniform(-0.07, 0.07), random.uniform(0.004, 0.08), 0.0])
    start[3] = random.uniform(-3.2, 3.2)
    way = np.array([random.gauss(0, 1) for _ in range(4)])
    way *= random.choice((0.0, 0.005, 0.03, 0.1)) / max(float(np.linalg.norm(way[:3])), 1e-9)
    way[3] = random.choice((0.0, random.uniform(-1.6, 1.6)))
    return start, start + way


def _enlarged(body: ToolBody, margin_m: float) -> NDArray[np.float64]:
    """Points of the body grown by the margin: drawn uniformly, and so deep inside that rounding cannot move one out."""
    return body.samples(margin_m, 1500, seed=7) * (1 - 1e-9)


def main(arguments: list[str] | None = None) -> int:
    """``python -m evidence.faults.properties``."""
    made = parser(__doc__)
    made.add_argument("--count", type=int, default=10_000, help="scenes (default 10000)")
    options = made.parse_args(arguments)
    outcome = try_scenes(options.count, options.seed, progress_every(500))
    figures = {
        "property_scenes": outcome.scenes,
        "property_failures": len(outcome.failures),
        "property_edges": outcome.edges,
        "property_edges_accepted": outcome.accepted,
        "property_poses": outcome.poses,
        "property_motions": outcome.motions,
        "property_undecided": outcome.undecided,
    }
    return conclude("properties", figures, options, outcome.failures)


if __name__ == "__main__":
    sys.exit(main())
