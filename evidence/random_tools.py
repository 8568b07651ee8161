"""Check the segment test and the planner with random tools, scenes, margins and voxels, by geometry of its own.

Tools are discs, boxes, capsules, spheres and unions of them, from 5 mm to 30 cm. Scenes are boxes and spheres scaled to
the tool, on voxels of 1 to 20 mm. The checker shares no code with the library. It measures the smallest clearance along
an edge between the tool and the unsafe voxels: corners of voxels to the exact parts, and points of the parts to exact
voxels, at poses that are refined where the minimum may lie (clearance is 1-Lipschitz in the motion).

* An accepted edge, a returned path and a trajectory must keep the margin.
* A refused edge whose clearance exceeds the margin is a false refusal; the largest excess is recorded.
* Further calls and replanning in the unchanged field must not raise the cost, which must be that of the path.
* Only errors of ``deltasafe.errors`` may be raised.
"""

import dataclasses
import itertools
import json
import math
import pathlib
import sys
from random import Random

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from deltasafe.errors import DeltasafeError
from deltasafe.geometry import Pose
from deltasafe.planning import (
    DistanceField,
    MotionSettings,
    Planner,
    PlanStatus,
    ToolBody,
    ToolPart,
    is_segment_safe,
    line_cost,
    path_cost,
    plan_motion,
    verification_test,
)
from deltasafe.scene import Cuboid, OccupancyGrid, Shape, Sphere, grid_from_shapes
from evidence.reporting import command_parser, finish, print_progress

Array = NDArray[np.float64]

DELTA = 0.05
EDGES_PER_SCENE = 10
SCENES_PER_MOTION = 10
TOLERANCE_M = 5e-5
POSE_DRAWS = 40
MAX_VOXELS = 400_000
NAMED = ("unsafe_accepted", "false_refusal_mm", "false_refusal_voxels", "cost_increases", "untyped_exceptions")


@dataclasses.dataclass
class Tally:
    """Counts and extremes over scenes; ``scenes`` also says where a stopped run resumes."""

    scenes: int = 0
    edges: int = 0
    edges_accepted: int = 0
    false_refusals: int = 0
    false_refusal_mm: float = 0.0
    false_refusal_voxels: float = 0.0
    motions: int = 0
    motions_solved: int = 0
    unsafe_accepted: int = 0
    cost_increases: int = 0
    untyped_exceptions: int = 0
    failures: list[str] = dataclasses.field(default_factory=list)


class Checker:
    """Clearance of a tool in a grid."""

    def __init__(self, grid: OccupancyGrid, body: ToolBody) -> None:
        unsafe = np.pad(np.asarray(grid.p_occupied, np.float64) > DELTA, ((1, 1), (1, 1), (0, 0)), constant_values=True)
        inner = np.pad(unsafe, 1, mode="edge")
        buried = np.ones_like(unsafe)
        for axis, shift in itertools.product(range(3), (-1, 1)):
            buried &= np.roll(inner, shift, axis)[1:-1, 1:-1, 1:-1]
        self.half_m, self.table_m = grid.voxel_m / 2, float(grid.origin_m[2])
        lower = np.asarray(grid.origin_m) - [grid.voxel_m, grid.voxel_m, 0]
        self.lower, self.upper, self.top_m = np.asarray(grid.origin_m), np.asarray(grid.upper_m), float(grid.upper_m[2])
        self.centers = lower + (np.argwhere(unsafe & ~buried) + 0.5) * grid.voxel_m
        self.tree = cKDTree(self.centers)
        self.parts, self.points = body.solids, np.concatenate([_points(part) for part in body.solids])
        self.radii = np.concatenate([np.full(len(_points(part)), part.radius_m) for part in body.solids])
        self.rho_m = float((np.hypot(*self.points[:, :2].T) + self.radii).max())
        self.low = (self.points - self.radii[:, None]).min(axis=0)
        self.high = (self.points + self.radii[:, None]).max(axis=0)

    def at(self, pose: Array, most_m: float) -> float:
        """Distance of the tool at a pose to unsafe voxels, table, and the space beside the grid; at most ``most_m``."""
        cos, sin = math.cos(pose[3]), math.sin(pose[3])
        turn = np.array([[cos, sin, 0], [-sin, cos, 0], [0, 0, 1]])
        points, radii = self.points @ turn + pose[:3], self.radii
        least = min(most_m, float((points[:, 2] - radii).min()) - self.table_m)
        up = np.maximum(points[:, 2] - self.top_m, 0)
        beside = np.minimum(points[:, :2] - self.lower[:2], self.upper[:2] - points[:, :2]).min(axis=1)
        least = min(least, float((np.hypot(np.maximum(beside, 0), up) - radii).min()))
        if least <= 0 or not len(self.centers):
            return least
        bound_m = most_m + 4 * self.half_m + float(radii.max())
        near, number = self.tree.query(points, k=4, distance_upper_bound=bound_m)
        row, column = np.nonzero(np.isfinite(near))
        gap = np.abs(points[row] - self.centers[number[row, column]]) - self.half_m
        boxes_m = np.linalg.norm(np.maximum(gap, 0), axis=1) - radii[row]
        least = min(least, float(boxes_m.min(initial=most_m)))
        local = (self.centers - pose[:3]) @ turn.T
        wide = least + 2 * self.half_m
        local = local[((local >= self.low - wide) & (local <= self.high + wide)).all(axis=1)]
        corners = np.array(list(itertools.product((-1, 1), repeat=3))) * self.half_m @ turn.T
        corner = (local[:, None] + corners).reshape(-1, 3)
        return min([least, *(float(_distance(part, corner).min(initial=most_m)) for part in self.parts)])

    def along(self, start: Array, end: Array, margin_m: float, only_violations: bool) -> float:
        """Smallest clearance found along an edge; refined where it may be below the margin, or the least so far."""
        motion_m = float(np.linalg.norm((end - start)[:3]) + self.rho_m * abs(end[3] - start[3]))
        most_m, shortest_m = margin_m + 0.05, max(2 * TOLERANCE_M, motion_m / 400)
        known = {t: self.at(start + t * (end - start), most_m) for t in (0.0, 1.0)}
        open_intervals, least_m = [(0.0, 1.0)], min(known.values())
        while open_intervals and least_m > 0:
            a, b = open_intervals.pop()
            lowest_m = (known[a] + known[b] - (b - a) * motion_m) / 2
            if (b - a) * motion_m <= shortest_m or lowest_m >= (margin_m if only_violations else least_m):
                continue
            middle = (a + b) / 2
            known[middle] = self.at(start + middle * (end - start), most_m)
            least_m = min(least_m, known[middle])
            open_intervals += [(a, middle), (middle, b)]
        return least_m


def _points(part: ToolPart) -> Array:
    """Points (n, 3) on the surface and the edges of the core of a part, in the tool's frame."""
    half = np.array([part.half_x_m, part.half_y_m, part.half_z_m])
    if part.kind in ("capsule", "sphere"):
        core = np.linspace(-1, 1, 9)[:, None] * half
    elif part.kind == "box":
        grid = np.stack(np.meshgrid(*3 * [np.linspace(-1, 1, 9)]), axis=-1).reshape(-1, 3)
        core = grid[np.abs(grid).max(axis=1) == 1] * half
    else:
        angle = np.linspace(0, 2 * np.pi, 96, endpoint=False)
        rim = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        flat = np.concatenate([r * rim for r in (1.0, 0.75, 0.5, 0.25)]) * half[:2]
        core = np.concatenate([np.column_stack([flat, np.full(len(flat), z)]) for z in np.linspace(-1, 1, 7) * half[2]])
    x, y, z = core.T
    cos, sin = (1.0, 0.0) if part.kind == "capsule" else (math.cos(part.yaw_rad), math.sin(part.yaw_rad))
    return np.stack([cos * x - sin * y, sin * x + cos * y, z], axis=1) + np.array([part.x_m, part.y_m, part.z_m])


def _distance(part: ToolPart, points: Array) -> Array:
    """Distance (N,) of points (N, 3) in the tool's frame to a part."""
    p = points - np.array([part.x_m, part.y_m, part.z_m])
    half = np.array([part.half_x_m, part.half_y_m, part.half_z_m])
    if part.kind in ("capsule", "sphere"):
        t = np.clip(p @ half / max(half @ half, 1e-30), -1, 1)
        return np.asarray(np.maximum(np.linalg.norm(p - t[:, None] * half, axis=1) - part.radius_m, 0))
    flat = (p[:, 0] + 1j * p[:, 1]) * np.exp(-1j * part.yaw_rad)
    x, y = np.abs(flat.real), np.abs(flat.imag)
    if part.kind == "box":
        beside = np.hypot(np.maximum(x - half[0], 0), np.maximum(y - half[1], 0))
    else:
        beside = _to_ellipse(x, y, half[0], half[1])
    return np.asarray(np.maximum(np.hypot(beside, np.maximum(np.abs(p[:, 2]) - half[2], 0)) - part.radius_m, 0))


def _to_ellipse(x: Array, y: Array, a: float, b: float) -> Array:
    """Distance of points of the first quadrant: golden-section search over the angle of the point on the ellipse."""
    low, high = np.zeros(len(x)), np.full(len(x), np.pi / 2)
    for _ in range(40):
        one, two = high - 0.618034 * (high - low), low + 0.618034 * (high - low)
        nearer = np.hypot(x - a * np.cos(one), y - b * np.sin(one)) < np.hypot(x - a * np.cos(two), y - b * np.sin(two))
        low, high = np.where(nearer, low, one), np.where(nearer, two, high)
    t = (low + high) / 2
    outside = (x / a) ** 2 + (y / b) ** 2 > 1
    return np.asarray(np.where(outside, np.hypot(x - a * np.cos(t), y - b * np.sin(t)), 0.0))


def random_tool(random: Random) -> ToolBody:
    """Draw a tool whose largest extent is log-uniform from 5 mm to 30 cm."""
    size = math.exp(random.uniform(math.log(0.0025), math.log(0.15)))  # half of the extent

    def half() -> float:
        return max(size * math.exp(random.uniform(math.log(0.1), 0)), 0.001)

    def part() -> ToolPart:
        kind, at = random.choice(("disc", "box", "capsule", "sphere")), (0.3 * size, 0.3 * size, 0.3 * size)
        x, y, z = (random.uniform(-a, a) for a in at)
        if kind == "sphere":
            return ToolPart(kind, x, y, z, radius_m=0.7 * half())
        yaw = random.uniform(-3, 3)
        if kind == "capsule":
            axis = [random.uniform(-0.4, 0.4) * size for _ in range(3)]
            return ToolPart(kind, x, y, z, axis[0], axis[1], axis[2], 0.3 * half())
        rounded = random.choice((0.0, 0.1 * size))
        return ToolPart(kind, x, y, z, 0.5 * half(), 0.5 * half(), 0.5 * half(), rounded, yaw)

    shaft_m = random.choice((0.0, size, 0.25))
    if random.random() < 0.4:
        a, b = size, half()
        return ToolBody(a, b, 2 * half(), 0.5 * min(a, b), shaft_m)
    return ToolBody(
        shaft_radius_m=0.2 * size, shaft_length_m=shaft_m, parts=tuple(part() for _ in range(random.randint(1, 4)))
    )


def random_grid(random: Random, size_m: float) -> OccupancyGrid:
    """Draw boxes and spheres scaled to a tool of ``size_m``, often with a slot between two of them."""
    half_m, height_m = max(4 * size_m, 0.06), max(2 * size_m, 0.03)
    least_m = (4 * half_m * half_m * height_m / MAX_VOXELS) ** (1 / 3)
    voxel_m = max(least_m, math.exp(random.uniform(math.log(0.001), math.log(0.02))))
    shapes: list[Shape] = []
    if random.random() < 0.5:
        gap_m = size_m * random.uniform(0.3, 1.5)
        for sign in (-1, 1):
            shapes.append(
                Cuboid((0.0, sign * (gap_m + half_m / 2), height_m / 2), (0.3 * size_m, half_m / 2, height_m / 2))
            )
    for _ in range(random.randint(0, 4)):
        px, py, z = random.uniform(-half_m, half_m), random.uniform(-half_m, half_m), random.uniform(0, height_m)
        if random.random() < 0.5:
            shapes.append(Sphere((px, py, z), size_m * random.uniform(0.1, 0.8)))
        else:
            h = tuple(size_m * random.uniform(0.1, 0.8) for _ in range(3))
            shapes.append(Cuboid((px, py, z), (h[0], h[1], h[2]), random.uniform(0, 3.1)))
    return grid_from_shapes(shapes, 0.0, (-half_m, -half_m, 0.0), (half_m, half_m, height_m), voxel_m)


def check_scene(number: int, seed: int, tally: Tally) -> None:
    """Check edges of one scene, and a motion in every tenth."""
    random, name = Random(f"{seed} {number}"), f"scene {number} of seed {seed}"
    try:
        body = random_tool(random)
        size_m = max(0.003, *(part.reach_m for part in body.parts or body.solids[:1]))
        grid, margin_m = (
            random_grid(random, size_m),
            random.choice((0.0, random.uniform(0, 0.005), random.uniform(0, 0.02))),
        )
        field, checker = DistanceField.build(grid, DELTA), Checker(grid, body)
        test = verification_test(field, body, margin_m)
        for _ in range(EDGES_PER_SCENE):
            start, end = _random_edge(random, size_m)
            accepted, tally.edges = is_segment_safe(test, start, end), tally.edges + 1
            excess_m = checker.along(start, end, margin_m, accepted) - margin_m
            tally.edges_accepted += accepted
            if accepted and excess_m < -1e-6:
                tally.unsafe_accepted += 1
                tally.failures.append(f"{name}: {start.tolist()} to {end.tolist()} lacks {-1e3 * excess_m} mm")
            if not accepted and excess_m > TOLERANCE_M:
                tally.false_refusals += 1
                tally.false_refusal_mm = max(tally.false_refusal_mm, 1e3 * excess_m)
                tally.false_refusal_voxels = max(tally.false_refusal_voxels, excess_m / grid.voxel_m)
        if number % SCENES_PER_MOTION == 0:
            _check_motion(random, name, (grid, body, size_m), checker, tally)
    except DeltasafeError:
        pass
    except Exception as error:  # the kind of failure that this command looks for
        tally.untyped_exceptions += 1
        tally.failures.append(f"{name}: {error!r}")
    tally.scenes += 1


def _check_motion(
    random: Random, name: str, scene: tuple[OccupancyGrid, ToolBody, float], checker: Checker, tally: Tally
) -> None:
    grid, body, size_m = scene
    settings = MotionSettings(
        n_iterations=300,
        n_refinements=100,
        body=body,
        z_max_above_field_m=max(0.07, 2 * size_m),
        steering_range_m=max(0.1, size_m),
        z_min_above_table_m=0.0,
    )
    slowest_m = float(settings.tracking.error_m(settings.v_min_mps))
    start, goal = (_free_pose(random, checker, side, size_m, slowest_m) for side in (-1, 1))
    motion = plan_motion(grid, start, goal, settings, random.randrange(2**31))
    tally.motions += 1
    field = DistanceField.build(grid, DELTA)
    fewer = dataclasses.replace(settings, n_iterations=100, n_refinements=30)
    planner, best = Planner(start, [goal], field, fewer, 0, body), math.inf
    for result in (planner.plan()[0], planner.plan()[0], planner.replan(field)[0]):
        cost = math.inf if result.cost is None else result.cost
        line = line_cost(settings.cost, settings.rotation_weight_m2, field.arrays.table_z_m, settings.length_weight_m)
        tally.cost_increases += cost > best or (result.path is not None and cost != path_cost(line, result.path.poses))
        best = cost
    if motion.result.status is not PlanStatus.SOLVED or motion.result.path is None:
        return
    tally.motions_solved += 1
    if motion.trajectory is None:
        tally.failures.append(f"{name}: the plan is solved, but the schedule refuses: {motion.reason}")
        return
    margins = [(motion.result.path.poses, motion.result.margin_m), (motion.trajectory.poses[::40], slowest_m)]
    for poses, margin_m in margins:
        for a, b in itertools.pairwise(poses):
            if checker.along(a, b, margin_m, only_violations=True) < margin_m - 1e-5:
                tally.unsafe_accepted += 1
                tally.failures.append(f"{name}: the motion comes too close from {a.tolist()} to {b.tolist()}")


def _free_pose(random: Random, checker: Checker, side: int, size_m: float, margin_m: float) -> Pose:
    """Draw a pose on one side that keeps the margin by the checker; the last of ``POSE_DRAWS`` if none does.

    The first half of the draws is between the obstacles, the others reach above them. Poses that were drawn without
    this test left 19 of 40 motions unsolved, all for an unsafe start or goal.
    """
    for draw in range(POSE_DRAWS):
        top_m = 3 * size_m if draw < POSE_DRAWS / 2 else max(checker.top_m, 3 * size_m) + size_m
        x, y = side * random.uniform(2, 3) * size_m, random.uniform(-1, 1) * size_m
        pose = np.array([x, y, random.uniform(0.5 * size_m, top_m), random.uniform(-1, 1)])
        if checker.at(pose, 2 * margin_m) >= margin_m:
            break
    return Pose(*pose.tolist())


def _random_edge(random: Random, size_m: float) -> tuple[Array, Array]:
    start = np.array(
        [random.uniform(-2.5, 2.5) * size_m, random.uniform(-1.5, 1.5) * size_m, 0.0, random.uniform(-3, 3)]
    )
    start[2] = random.uniform(0.0, 2.5) * size_m
    offset = np.array([random.gauss(0, 1) for _ in range(3)])
    offset *= size_m * random.choice((0.0, 0.1, 0.5, 2.0)) / max(float(np.linalg.norm(offset)), 1e-9)
    return start, start + np.append(offset, random.choice((0.0, random.uniform(-1.6, 1.6))))


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.random_tools``."""
    parser = command_parser("random_tools", __doc__, seeded=True)
    parser.add_argument("--scenes", type=int, default=10_000, help="number of scenes (default 10000)")
    parser.add_argument("--state", type=pathlib.Path, help="file of counts, with which a stopped run resumes")
    options = parser.parse_args(arguments)
    state, tally, progress = options.state, Tally(), print_progress(100)
    if state is not None and state.exists():
        tally = Tally(**json.loads(state.read_text(encoding="utf-8")))
    while tally.scenes < options.scenes:
        check_scene(tally.scenes, options.seed, tally)
        progress(tally.scenes, options.scenes, f"{tally.edges_accepted} edges accepted, {len(tally.failures)} failures")
        if state is not None and tally.scenes % 20 == 0:
            state.write_text(json.dumps(dataclasses.asdict(tally)), encoding="utf-8")
    figures = {
        name if name in NAMED else f"random_tool_{name}": value
        for name, value in dataclasses.asdict(tally).items()
        if name != "failures"
    }
    if not tally.motions_solved:  # without a solved motion there is no cost that could rise
        del figures["cost_increases"]
    options.state = None
    return finish(options, figures, tally.failures)


if __name__ == "__main__":
    sys.exit(main())
