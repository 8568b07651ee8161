"""Measure planning while the hand moves: live runs in simulated time, against planning once on the same seeds.

A run takes a packaged scene, lets its hand move, and drives the tool from start to goal. The camera hangs 0.9 m above
the table, so that a hand from outside the view arrives in time to be seen. p_occupied is an oracle here: the true
outline, widened by about three pixels. The arm follows its reference with an error as large as its bound, in random
directions. An audit that shares no code with the loop checks each run. Runs are stored by settings and code; a stopped
command continues.
"""

import dataclasses
import os
import pathlib
import sys

import numpy as np
from numpy.typing import NDArray

from deltasafe.io.images import read_rgb
from deltasafe.online.hand_motions import KINDS, HandMotion
from deltasafe.online.loop import OnlineLoop, Task
from deltasafe.online.moving_scene import MovingHand, SimulatedCamera, hand_of
from deltasafe.online.settings import OnlineSettings
from deltasafe.online.simulation import KinematicArm, LiveRun, run_simulated
from deltasafe.planning import MotionSettings, plan_motion
from deltasafe.scene import Camera, FieldSettings, LoggedScene, grid_from_image
from deltasafe.studies.intervals import clopper_pearson, upper_bound
from deltasafe.studies.resumable_jobs import Batch, run_batches
from evidence.online_audit import Driven, Tool, audit, touches
from evidence.reporting import command_parser, finish, print_progress
from pipelines.command_line import run_command
from pipelines.home import DATASETS

SPEEDS_MPS = (0.0, 0.05, 0.1, 0.2, 0.4)
LEAST_V_HAND_MPS = 0.05
CAMERA_M = 0.9
VOXEL_M = 0.01
DURATION_S = 12.0
CLEAR_AT_START_M = 0.08
"""Scenarios whose hand begins nearer to the tool are drawn again: the arm could not begin beside it."""

MOTION = MotionSettings(n_iterations=800, n_refinements=200)
AUDITED = ("contacts_moving", "contacts_at_rest", "spare_m", "continuous")
LIVE = ("reached", "duration_s", "cycles", "braking", "resting", "plans", "cycle_p50_ms", "cycle_p99_ms")
ONCE = ("once_contact", "once_duration_s")

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Scenario:
    """A live run: scene, motion and true speed of the hand, its assumed maximum speed, and the seed."""

    scene: str
    kind: str
    speed_mps: float
    v_hand_mps: float
    seed: int


def scenarios(count: int, seed: int, factor: float) -> list[Scenario]:
    """Draw scenarios, all motions and speeds in turn; the hand moves at ``factor`` times its assumed speed."""
    names = sorted(path.name for path in (DATASETS / "scenes").iterdir() if path.is_dir())
    drawn = []
    for number in range(count):
        kind, speed = KINDS[number % len(KINDS)], SPEEDS_MPS[number // len(KINDS) % len(SPEEDS_MPS)]
        name = names[(number // (len(KINDS) * len(SPEEDS_MPS)) + 7 * number) % len(names)]
        drawn.append(Scenario(name, kind, factor * speed, max(speed, LEAST_V_HAND_MPS), seed + number))
    return drawn


def run_scenario(scenario: Scenario) -> Batch:
    """Run one scenario, live and planned once; return ``AUDITED``, ``LIVE`` and ``ONCE``."""
    scene = LoggedScene.load(DATASETS / "scenes" / scenario.scene)
    camera = dataclasses.replace(scene.camera, position_m=np.array([0.0, 0.0, CAMERA_M]))
    motion, hand = clear_start(scenario, scene)
    task = Task(camera, scene.table_z_m, hand.height_m - scene.table_z_m + 0.002, scene.start, scene.goal)
    row = live_figures(scenario, task, motion, hand)
    again, hand = clear_start(scenario, scene)
    row |= once_figures(scenario, task, again, hand)
    return {name: np.float64(value) for name, value in row.items()}  # type: ignore[misc]


def clear_start(scenario: Scenario, scene: LoggedScene) -> tuple[HandMotion, MovingHand]:
    """Return the first motion drawn whose hand does not begin at the tool."""
    start = scene.start.as_array()[:3]
    hand = hand_of(scene, read_rgb(scene.image_path), lambda time_s: np.zeros(2))
    for attempt in range(100):
        motion = HandMotion(scenario.kind, scenario.speed_mps, 1000 * scenario.seed + attempt)
        hand = dataclasses.replace(hand, displacement=motion)
        if np.linalg.norm((hand.at(0.0) - start)[:, :2], axis=1).min() > CLEAR_AT_START_M:
            return motion, hand
    raise RuntimeError(f"no start of {scenario} is clear")


def live_figures(scenario: Scenario, task: Task, motion: HandMotion, hand: MovingHand) -> dict[str, float]:
    """Run the loop, and audit what the arm did."""
    source = OutlineCamera(hand, task.camera, plate(task.camera))
    settings = OnlineSettings(v_hand_mps=scenario.v_hand_mps)
    cycles_ms: list[float] = []

    def oracle(rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        return source.silhouette(source.captured_s).astype(np.float32)

    def note(now_s: float, observation: object, pose: Array, decision: object, timing_ms: dict[str, float]) -> None:
        cycles_ms.append(timing_ms.get("motion", 0.0) + (timing_ms.get("field", 0.0) if observation else 0.0))

    loop = OnlineLoop(task, oracle, MOTION, settings, seed=scenario.seed, field=FieldSettings(voxel_m=VOXEL_M))
    run = run_simulated(loop, source, arm_of(scenario), DURATION_S, on_sample=motion.see, note=note)
    kinds = [decision.kind for decision in run.decisions]
    return audited(scenario, run, hand) | {
        "reached": run.reached_goal,
        "duration_s": float(run.time_s[-1]),
        "cycles": len(kinds),
        "braking": kinds.count("brake"),
        "resting": kinds.count("rest"),
        "plans": sum(decision.planned for decision in run.decisions),
        "cycle_p50_ms": float(np.percentile(cycles_ms, 50)),
        "cycle_p99_ms": float(np.percentile(cycles_ms, 99)),
    }


def audited(scenario: Scenario, run: LiveRun, hand: MovingHand) -> dict[str, float]:
    """Check a run against the true hand."""

    def needed_m(age_s: float, speed_mps: float) -> float:
        return scenario.v_hand_mps * age_s + MOTION.gamma0_m + MOTION.gamma1_s * max(speed_mps, MOTION.v_min_mps)

    driven = Driven(run.time_s, run.reference, run.tool, run.speed_mps, run.captured_s)
    found = audit(Tool(), driven, hand.at, needed_m)
    return {
        "contacts_moving": found.contacts_moving,
        "contacts_at_rest": found.contacts_at_rest,
        "spare_m": found.least_spare_m,
        "continuous": found.is_continuous,
    }


def once_figures(scenario: Scenario, task: Task, motion: HandMotion, hand: MovingHand) -> dict[str, float]:
    """Plan from the first image as if the hand held still, and execute that without looking again."""
    source = OutlineCamera(hand, task.camera, plate(task.camera))
    ends = task.start, task.goal
    image = source.silhouette(0.0).astype(np.float32)
    grid = grid_from_image(image, task.camera, task.table_z_m, task.hand_height_m, FieldSettings(voxel_m=VOXEL_M), ends)
    trajectory = plan_motion(grid, *ends, MOTION, scenario.seed).trajectory
    if trajectory is None:
        return {"once_contact": np.nan, "once_duration_s": np.nan}
    arm, contact = arm_of(scenario), False
    for n in range(0, len(trajectory.time_s), 10):
        time_s = 0.1 + float(trajectory.time_s[n])
        pose = arm.pose(trajectory.poses[n], float(trajectory.speed_mps[n]), time_s)
        motion.see(time_s, pose)
        contact |= touches(Tool(), pose, hand.at(time_s))
    return {"once_contact": contact, "once_duration_s": 0.1 + trajectory.duration_s}


def arm_of(scenario: Scenario) -> KinematicArm:
    """Return an arm that uses its whole tracking bound."""
    return KinematicArm(lambda speed: float(MOTION.tracking.error_m(max(speed, MOTION.v_min_mps))), scenario.seed)


class OutlineCamera(SimulatedCamera):
    """Delivers the times of images for the oracle, which takes the outline; the images show noise only."""

    def draw(self, time_s: float, number: int = 0) -> NDArray[np.uint8]:
        """Return an image unlike the others."""
        rgb = plate(self.camera)
        rgb[0] = np.random.default_rng(number).integers(0, 256, rgb[0].shape, np.uint8)
        return rgb


def plate(camera: Camera) -> NDArray[np.uint8]:
    """Return an empty table."""
    return np.full((camera.height, camera.width, 3), 150, np.uint8)


def figures_of(drawn: list[Scenario], rows: list[Batch], prefix: str) -> dict[str, float]:
    """Counts, shares and exact intervals over runs."""
    table = {name: np.array([float(row[name]) for row in rows]) for name in AUDITED + LIVE + ONCE}
    n, touched = len(rows), int((table["contacts_moving"] > 0).sum())
    planned = np.isfinite(table["once_contact"])
    once = int(np.nansum(table["once_contact"]))
    both = planned & (table["reached"] > 0) & (table["once_contact"] == 0)
    low, high = clopper_pearson(touched, n)
    figures = {
        "runs": n,
        "contacts_moving": touched,
        "contacts_moving_low": low,
        "contacts_moving_high": high,
        "contacts_moving_upper95": upper_bound(touched, n),
        "contacts_at_rest": int((table["contacts_at_rest"] > 0).sum()),
        "plan_once_runs": int(planned.sum()),
        "plan_once_contacts": once,
        "reached_goal": float(table["reached"].mean()),
        "time_to_goal_ratio": float(np.median((table["duration_s"] / table["once_duration_s"])[both]))
        if both.any()
        else np.nan,
        "share_braking": float(table["braking"].sum() / table["cycles"].sum()),
        "share_resting": float(table["resting"].sum() / table["cycles"].sum()),
        "least_spare_mm": 1000 * float(table["spare_m"][np.isfinite(table["spare_m"])].min(initial=np.inf)),
        "cycle_without_perception_p50_ms": float(np.median(table["cycle_p50_ms"])),
        "cycle_without_perception_p99_ms": float(np.max(table["cycle_p99_ms"])),
    }
    for speed in sorted({scenario.speed_mps for scenario in drawn}):
        chosen = np.array([scenario.speed_mps == speed for scenario in drawn])
        name = f"at_{round(100 * speed):03d}_cmps"
        figures |= {
            f"{name}_runs": int(chosen.sum()),
            f"{name}_contacts_moving": int((table["contacts_moving"] > 0)[chosen].sum()),
            f"{name}_plan_once_contacts": int(np.nansum(table["once_contact"][chosen])),
            f"{name}_reached_goal": float(table["reached"][chosen].mean()),
        }
    return {prefix + name: float(value) for name, value in figures.items() if np.isfinite(value)}


def failures_of(drawn: list[Scenario], rows: list[Batch]) -> list[str]:
    """Runs that break the promise: the hand kept v_hand."""
    failures = []
    for scenario, row in zip(drawn, rows, strict=True):
        if row["contacts_moving"] > 0 or not row["continuous"] or row["spare_m"] < 0:
            failures.append(f"{scenario}: { {name: float(row[name]) for name in AUDITED} }")
    return failures


def main() -> int:
    """Run the scenarios, print the figures, and return the exit status."""
    parser = command_parser("online", __doc__, seeded=True)
    parser.add_argument("--runs", type=int, default=1000, help="runs in which the hand keeps v_hand (default 1000)")
    parser.add_argument("--fast-runs", type=int, default=250, help="runs at twice v_hand (default 250)")
    parser.add_argument("--work", type=pathlib.Path, default=pathlib.Path(".deltasafe/online"), help="stored runs")
    parser.add_argument("--workers", type=int, default=max(1, (os.cpu_count() or 2) - 1), help="number of processes")
    options = parser.parse_args()
    kept, fast = scenarios(options.runs, options.seed, 1.0), scenarios(options.fast_runs, options.seed + 10**6, 2.0)
    jobs = [(f"run-{number:05d}", (scenario,)) for number, scenario in enumerate(kept)]
    jobs += [(f"fast-{number:05d}", (scenario,)) for number, scenario in enumerate(fast)]
    rows, _ = run_batches(run_scenario, jobs, options.work, options.workers, print_progress(5))
    figures = figures_of(kept, rows[: len(kept)], "")
    if fast:
        figures |= figures_of(fast, rows[len(kept) :], "twice_v_hand_")
    figures = {name: round(value, 6) for name, value in figures.items()}
    return finish(options, figures, failures_of(kept, rows[: len(kept)]))


if __name__ == "__main__":
    sys.exit(run_command(main))
