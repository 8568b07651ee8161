"""Check properties of the planner in random scenes: accepted edges are safe, and stricter tests accept no more.

A scene is a small grid of random shapes, a delta and a margin. Edges are random, many of them close to unsafe regions.

* An accepted edge is checked by brute force that shares no code with the test: points of the body, enlarged by the
  margin, are looked up in the grid at poses 1 mm apart.
* The answer does not depend on the direction of the edge.
* An edge that was refused is not accepted with a larger margin or a smaller delta.
* In every twentieth scene a motion is planned and sampled ten times more finely than the controller does. Its speeds
  stay within their limits, and the body enlarged by the tracking error at its speed stays in free space.

The continuous test may refuse edges whose clearance exceeds the margin by less than its resolution of 1 mm. The poses
that it checks depend on the grid, so a stricter test may accept such an edge. This counts as undecided, and the edge
must then be accepted at the finest resolution.
"""

import dataclasses
import sys
from random import Random

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.progress import Progress, silent
from deltasafe.geometry import Pose
from deltasafe.planning import (
    CheckSettings,
    DistanceField,
    MotionSettings,
    ToolBody,
    is_segment_safe,
    plan_motion,
    segment_test,
)
from deltasafe.planning.audit import audit_path
from deltasafe.scene import Cuboid, OccupancyGrid, Shape, Sphere, grid_from_shapes
from evidence.reporting import command_parser, finish, print_progress

LOWER_M, UPPER_M = (-0.09, -0.08, 0.0), (0.09, 0.08, 0.05)
VOXELS_M = (0.0025, 0.004, 0.005, 0.0075)
EDGES_PER_SCENE = 12
FINEST_RESOLUTION_M = 1e-5
SCENES_PER_MOTION = 20
POSES_PER_MOTION = 200
N_POINTS = 1500


@dataclasses.dataclass
class Outcome:
    """Counts of what was checked, and the properties that did not hold."""

    scenes: int = 0
    edges: int = 0
    accepted: int = 0
    poses: int = 0
    motions: int = 0
    undecided: int = 0
    failures: list[str] = dataclasses.field(default_factory=list)


def check_scenes(count: int, seed: int, progress: Progress = silent) -> Outcome:
    """Check ``count`` random scenes."""
    outcome = Outcome()
    for done in range(1, count + 1):
        check_scene(Random(f"{seed} {done}"), f"scene {done} of seed {seed}", outcome)
        if done % SCENES_PER_MOTION == 0:
            check_motion(Random(f"{seed} {done} motion"), f"motion {done} of seed {seed}", outcome)
        progress(done, count, f"{outcome.accepted} edges accepted, {len(outcome.failures)} failures")
    return outcome


def check_scene(random: Random, name: str, outcome: Outcome) -> None:
    """Check all properties of the edges of one scene."""
    grid, delta = _random_grid(random), random.uniform(0.02, 0.6)
    margin_m = random.choice((0.0, random.uniform(0.0, 0.003), random.uniform(0.003, 0.015)))
    body = _random_body(random)
    field = DistanceField.build(grid, delta)
    test = segment_test(field, body, margin_m, CheckSettings())
    wider = segment_test(field, body, min(margin_m + random.choice((1e-5, 0.0005, 0.003)), 0.02), CheckSettings())
    stricter = segment_test(field.at_delta(delta * random.choice((0.5, 0.9, 0.999))), body, margin_m, CheckSettings())
    finest = segment_test(field, body, margin_m, CheckSettings(resolution_m=FINEST_RESOLUTION_M))
    # shrunk by 1e-9, so that rounding cannot move a point out of the enlarged body
    points = body.samples(margin_m, N_POINTS, seed=7) * (1 - 1e-9)
    outcome.scenes += 1
    for n in range(EDGES_PER_SCENE):
        start, end = _random_edge(random)
        outcome.edges += 1
        edge = f"{name}, edge {n} from {start.tolist()} to {end.tolist()}"
        accepted = is_segment_safe(test, start, end)
        if accepted != is_segment_safe(test, end, start):
            outcome.failures.append(f"{edge}: the answer depends on the direction")
        if accepted:
            outcome.accepted += 1
            audit = audit_path(np.stack([start, end]), grid, points, delta, body.rho_max_m)
            outcome.poses += audit.poses
            if audit.unsafe_poses:
                outcome.failures.append(f"{edge}: accepted at delta {delta}, but p = {audit.worst_p_occupied}")
            continue
        for difference, other in (("larger margin", wider), ("smaller delta", stricter)):
            if is_segment_safe(other, start, end):
                outcome.undecided += 1
                if not is_segment_safe(finest, start, end):
                    outcome.failures.append(f"{edge}: refused, but accepted with a {difference}")


def check_motion(random: Random, name: str, outcome: Outcome) -> None:
    """Plan a motion between two poses beside the obstacles, and check its speeds and its clearance."""
    grid = _random_grid(random, max_shapes=2)
    settings = MotionSettings(n_iterations=400, rate_hz=10_000.0, delta=random.uniform(0.02, 0.6))
    start, goal = (
        Pose(x, random.uniform(-0.03, 0.03), random.uniform(0.015, 0.07), random.uniform(-1, 1)) for x in (-0.04, 0.04)
    )
    motion = plan_motion(grid, start, goal, settings, random.randrange(2**31))
    if motion.trajectory is None:
        return
    outcome.motions += 1
    velocities, poses, body = motion.trajectory.velocities, motion.trajectory.poses, motion.body
    yaw_rate_radps = np.abs(velocities[:, 3])
    speed_mps = np.linalg.norm(velocities[:, :3], axis=1) + body.rho_max_m * yaw_rate_radps
    if speed_mps.max() > settings.v_max_mps * (1 + 1e-9):
        outcome.failures.append(f"{name}: {speed_mps.max()} m/s exceeds {settings.v_max_mps} m/s")
    if yaw_rate_radps.max() > settings.yaw_rate_radps * (1 + 1e-9):
        outcome.failures.append(f"{name}: {yaw_rate_radps.max()} rad/s exceeds {settings.yaw_rate_radps} rad/s")
    for n in random.sample(range(len(poses)), min(POSES_PER_MOTION, len(poses))):
        error_m = float(motion.tracking.error_m(max(speed_mps[n], settings.v_min_mps)))
        points = body.samples(error_m, N_POINTS, seed=7)
        audit = audit_path(poses[n][None], grid, points, settings.delta, body.rho_max_m)
        outcome.poses += 1
        if audit.unsafe_poses:
            sample = f"{name}, sample {n}: {speed_mps[n]} m/s"
            outcome.failures.append(f"{sample}, p = {audit.worst_p_occupied} within {1e3 * error_m} mm")


def _random_grid(random: Random, max_shapes: int = 4) -> OccupancyGrid:
    shapes: list[Shape] = []
    for _ in range(random.randint(1, max_shapes)):
        x, y = random.uniform(-0.08, 0.08), random.uniform(-0.07, 0.07)
        if random.random() < 0.5:
            shapes.append(Sphere((x, y, random.uniform(0.0, 0.05)), random.uniform(0.004, 0.02)))
        else:
            half = (random.uniform(0.003, 0.02), random.uniform(0.003, 0.02), random.uniform(0.003, 0.02))
            shapes.append(Cuboid((x, y, half[2]), half, random.uniform(0.0, 3.1)))
    return grid_from_shapes(shapes, random.uniform(0.003, 0.02), LOWER_M, UPPER_M, random.choice(VOXELS_M))


def _random_body(random: Random) -> ToolBody:
    if random.random() < 0.5:
        return ToolBody()
    a, b = random.uniform(0.006, 0.03), random.uniform(0.006, 0.03)
    return ToolBody(a, b, random.uniform(0.002, 0.012), 0.004, random.choice((0.0, 0.25)))


def _random_edge(random: Random) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    start = np.array([random.uniform(-0.08, 0.08), random.uniform(-0.07, 0.07), random.uniform(0.004, 0.08), 0.0])
    start[3] = random.uniform(-3.2, 3.2)
    offset = np.array([random.gauss(0, 1) for _ in range(4)])
    offset *= random.choice((0.0, 0.005, 0.03, 0.1)) / max(float(np.linalg.norm(offset[:3])), 1e-9)
    offset[3] = random.choice((0.0, random.uniform(-1.6, 1.6)))
    return start, start + offset


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.faults.properties``."""
    parser = command_parser("faults.properties", __doc__, seeded=True)
    parser.add_argument("--count", type=int, default=10_000, help="scenes (default 10000)")
    options = parser.parse_args(arguments)
    outcome = check_scenes(options.count, options.seed, print_progress(500))
    counts = dataclasses.asdict(outcome) | {"failures": len(outcome.failures)}
    counts["edges_accepted"] = counts.pop("accepted")
    figures = {f"property_{name}": count for name, count in counts.items()}
    return finish(options, figures, outcome.failures)


if __name__ == "__main__":
    sys.exit(main())
