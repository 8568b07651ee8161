"""Trials: a contender meets a situation at a level. A row of numbers each; a pure function of settings and number."""

import dataclasses
import functools
import time
from collections.abc import Mapping, Sequence
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution import MonitorLimits, Workcell, evaluate_execution
from deltasafe.execution.recording import Execution
from deltasafe.execution.simulate import execute
from deltasafe.execution.verdict import largest_p_occupied
from deltasafe.geometry import Pose, Trajectory
from deltasafe.planning import DistanceField, PlanResult, ToolBody, plan
from deltasafe.scene import LoggedScene, OccupancyGrid, grid_from_image
from deltasafe.studies.baselines import GaussianObstacle
from deltasafe.studies.resumable_jobs import Batch
from deltasafe.studies.safety.motions import (
    OUTCOMES,
    RefusalError,
    level_settings,
    parametric_motion,
    scheduled_motion,
    top_speed_motion,
)
from deltasafe.studies.safety.obstacle_fit import fit_obstacles
from deltasafe.studies.safety.scenarios import Situation, draw_situation, true_mask
from deltasafe.studies.safety.settings import CONTENDERS, PARAMETRIC, SafetyStudySettings

__all__ = [
    "BY_SPEED",
    "COLUMNS",
    "SPEED_EDGES_MPS",
    "STAGES",
    "Eyes",
    "FrozenEyes",
    "SceneRef",
    "Sight",
    "meet",
    "replay",
]

SPEED_EDGES_MPS = (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, np.inf)

COLUMNS: dict[str, type] = {
    "situation": np.int32,
    "scene": np.int32,
    "contender": np.int8,
    "delta": np.float64,
    "member": np.int8,
    "outcome": np.int8,
    "missed_share": np.float64,
    "duration_s": np.float64,
    "length_m": np.float64,
    "simulated_s": np.float64,
    "poses": np.int32,
    "unsafe_poses": np.int32,
    "touching_poses": np.int32,
    "contacts": np.int32,
    "stopped": np.bool_,
    "worst_p_occupied": np.float64,
    "min_tool_m": np.float64,
    "min_arm_m": np.float64,
    "max_error_m": np.float64,
    "max_excess_m": np.float64,
}
"""What is kept of a trial; NaN or 0 where nothing was executed.

``member``: the single member, -1 for all. ``missed_share``: of the true hand's pixels that the picture used shows with
p_occupied <= delta. ``poses``: recorded ones from rest at the start to rest at the goal; ``unsafe_poses`` of them have
a point of the tool with p_occupied > delta in the field used, at ``touching_poses`` the tool touches or crosses the
true hand. ``contacts``, ``min_tool_m`` and ``min_arm_m`` are of the whole recording, approach and retreat included.
"""

BY_SPEED = ("poses_by_speed", "unsafe_by_speed", "touching_by_speed", "min_tool_by_speed_m")
"""The same by reference speed: one more axis, the bins between ``SPEED_EDGES_MPS``."""

STAGES = ("see", "plan", "execute", "judge")


@dataclasses.dataclass(frozen=True)
class Sight:
    """What is seen in a picture: ``ensemble`` (H, W) and ``members`` (M, H, W), all p_occupied."""

    ensemble: NDArray[np.float32]
    members: NDArray[np.float32]


class Eyes(Protocol):
    """Whoever looks at pictures; a dataclass with a JSON form, since it names a batch together with the settings."""

    def look(self, rgb: NDArray[np.uint8]) -> Sight:
        """What is seen in a picture (H, W, 3) uint8."""
        ...


@dataclasses.dataclass(frozen=True)
class FrozenEyes:
    """A frozen ensemble. Its members see as they are; the ensemble's temperature is calibrated for all of them."""

    folder: str

    def look(self, rgb: NDArray[np.uint8]) -> Sight:
        """The mean of the members, recalibrated, and each of them.

        Raises:
            ArtifactError: the folder holds no frozen ensemble.
        """
        from deltasafe.perception.calibration.temperature import apply_temperature

        ensemble = _ensemble(self.folder)
        members = ensemble.member_p_occupied(rgb)
        pooled = apply_temperature(members.mean(axis=0), ensemble.temperature).astype(np.float32)
        return Sight(pooled, members)


@functools.lru_cache(1)
def _ensemble(folder: str) -> Any:
    import torch

    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble

    ensemble = load_ensemble(folder)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)  # side by side one each; and sums of the same order, whatever the machine
    try:
        _ = ensemble.backend
    finally:
        torch.set_num_threads(threads)
    return ensemble


@dataclasses.dataclass(frozen=True)
class SceneRef:
    """A scene by its folder, and what it holds by its digest."""

    folder: str
    digest: str


def meet(settings: SafetyStudySettings, scenes: Sequence[SceneRef], eyes: Eyes, situation: int) -> Batch:
    """All trials of a situation: arrays of ``COLUMNS`` (T,), of ``BY_SPEED`` (T, bins), and ``seconds`` (T, stages)."""
    table = _Table(settings, scenes, eyes, situation)
    rows = [table.trial(place)[0] for place in range(len(settings.trials_of(situation)))]
    batch: dict[str, NDArray[Any]] = {
        name: np.array([row[name] for row in rows], kind) for name, kind in COLUMNS.items()
    }
    return batch | {name: np.array([row[name] for row in rows]) for name in (*BY_SPEED, "seconds")}


def replay(
    settings: SafetyStudySettings, scenes: Sequence[SceneRef], eyes: Eyes, trial: int
) -> tuple[LoggedScene, Execution]:
    """Trial number ``trial`` once more, with its recording.

    Raises:
        SettingsError: the trial ended without an execution; names its outcome.
    """
    situation, place = settings.situation_and_place(trial)
    table = _Table(settings, scenes, eyes, situation)
    row, execution = table.trial(place)
    if execution is None:
        raise SettingsError(f"trial {trial} was not executed: {OUTCOMES[row['outcome']]}")
    return table.scene, execution


class _Table:
    """A situation laid out: what its trials share is made once, when the first of them asks for it."""

    def __init__(self, settings: SafetyStudySettings, scenes: Sequence[SceneRef], eyes: Eyes, situation: int) -> None:
        self.settings, self.eyes = settings, eyes
        self.scene = LoggedScene.load(scenes[situation % len(scenes)].folder)
        self.situation: Situation = draw_situation(settings, len(scenes), self.scene, situation)
        self.body = ToolBody()
        self.seconds = dict.fromkeys(STAGES, 0.0)
        # of this situation alone: caches of the class would keep every situation for as long as the process lives
        self.grid = functools.cache(self._grid)
        self.field = functools.cache(self._field)
        self.plan = functools.cache(self._plan)

    @functools.cached_property
    def sight(self) -> Sight:
        with _Clock(self.seconds, "see"):
            return self.eyes.look(self.situation.rgb)

    @functools.cached_property
    def hand(self) -> NDArray[np.bool_]:
        return true_mask(self.scene)

    @property
    def member(self) -> int:
        return self.situation.member % len(self.sight.members)

    def picture(self, contender: str) -> NDArray[np.float32]:
        """p_occupied (H, W) that a contender is given."""
        return self.sight.members[self.member] if contender == "single_member" else self.sight.ensemble

    def _grid(self, single: bool) -> OccupancyGrid:
        return self._extruded(self.picture("single_member" if single else "ours"))

    def _field(self, single: bool, delta: float) -> DistanceField:
        return DistanceField.build(self.grid(single), delta)

    @functools.cached_property
    def view(self) -> DistanceField:
        return DistanceField.build(self._extruded(np.zeros_like(self.sight.ensemble)), self.settings.deltas[0])

    @functools.cached_property
    def obstacles(self) -> list[GaussianObstacle]:
        scene, settings = self.scene, self.settings
        count = settings.n_obstacles
        return fit_obstacles(self.sight.ensemble, scene.camera, scene.table_z_m, scene.hand_height_m, count, 0)

    def _plan(self, single: bool, delta: float, start: Pose, goal: Pose) -> PlanResult:
        """The path of our planner; the one without a schedule drives the same."""
        motion = level_settings(self.settings.motion, delta)
        seed = self.situation.plan_seed
        return plan(start, goal, self.field(single, delta), motion, seed, self.body, self.settings.motion.tracking)

    def trial(self, place: int) -> tuple[dict[str, Any], Execution | None]:
        """Its row and, if it was executed, the recording."""
        contender, delta = self.settings.trials_of(self.situation.number)[place]
        single = contender == "single_member"
        self.seconds = dict.fromkeys(STAGES, 0.0)
        row: dict[str, Any] = {name: np.nan if kind is np.float64 else 0 for name, kind in COLUMNS.items()}
        row |= {
            "situation": self.situation.number,
            "scene": self.situation.scene,
            "contender": CONTENDERS.index(contender),
            "delta": delta,
            "member": self.member if single else -1,
            "missed_share": float((self.picture(contender)[self.hand] <= delta).mean()),
        }
        row |= {name: np.zeros(len(SPEED_EDGES_MPS) - 1, np.int32) for name in BY_SPEED[:-1]}
        row[BY_SPEED[-1]] = np.full(len(SPEED_EDGES_MPS) - 1, np.nan)
        execution = None
        try:
            with _Clock(self.seconds, "plan"):
                trajectory = self._trajectory(contender, delta)
            with _Clock(self.seconds, "execute"):
                execution = self._execute(trajectory)
        except RefusalError as refusal:
            row["outcome"] = OUTCOMES.index(str(refusal))
        except PlanningError:
            row["outcome"] = OUTCOMES.index("the arm cannot follow")
        else:
            with _Clock(self.seconds, "judge"):
                row |= self._judged(execution, trajectory, delta, self.grid(single))
        return row | {"seconds": np.array([self.seconds[name] for name in STAGES])}, execution

    def _trajectory(self, contender: str, delta: float) -> Trajectory:
        settings = self.settings
        if self.situation.task is None:
            raise RefusalError("no task")
        start, goal = self.situation.task
        motion = level_settings(settings.motion, delta)
        if contender in PARAMETRIC:
            seed = self.situation.plan_seed
            return parametric_motion(
                contender, self.obstacles, self.view, start, goal, motion, seed, self.body, settings.motion.tracking
            )
        single = contender == "single_member"
        timed = top_speed_motion if contender == "top_speed" else scheduled_motion
        result = self.plan(single, delta, start, goal)
        return timed(result, self.field(single, delta), motion, self.body, settings.motion.tracking)

    def _execute(self, trajectory: Trajectory) -> Execution:
        settings, scene = self.settings, self.scene
        fastest_m = float(settings.motion.tracking.error_m(settings.motion.v_max_mps))
        return execute(
            trajectory,
            Workcell(self.body, scene.true_mesh(), scene.table_z_m),
            settings.execution,
            self.situation.arm_seed,
            limits=MonitorLimits.of(settings.motion),
            unsafe_below_m=float(self.grid(False).upper_m[2]) + fastest_m,
        )

    def _judged(
        self, execution: Execution, trajectory: Trajectory, delta: float, grid: OccupancyGrid
    ) -> Mapping[str, Any]:
        verdict = evaluate_execution(execution, grid, level_settings(self.settings.motion, delta))
        judged = execution.judged
        touching = execution.tool_to_hand_m[judged] <= 0
        unsafe = np.zeros(verdict.poses, np.bool_)
        if not verdict.whole_motion_delta_safe:
            unsafe = largest_p_occupied(execution, grid, self.body)[judged] > delta
        tool_m = execution.tool_to_hand_m[judged]
        speed_bin = np.digitize(execution.reference_speed_mps[judged], SPEED_EDGES_MPS[1:-1])
        n_bins = len(SPEED_EDGES_MPS) - 1
        steps_m = np.linalg.norm(np.diff(trajectory.poses[:, :3], axis=0), axis=1)
        return {
            "outcome": OUTCOMES.index("executed"),
            "duration_s": trajectory.duration_s,
            "length_m": float(steps_m.sum()),
            "simulated_s": float(execution.time_s[-1]),
            "poses": verdict.poses,
            "unsafe_poses": int(unsafe.sum()),
            "touching_poses": int(touching.sum()),
            "contacts": verdict.contacts,
            "stopped": not verdict.completed,
            "worst_p_occupied": verdict.worst_p_occupied,
            "min_tool_m": float(execution.tool_to_hand_m.min()),
            "min_arm_m": float(execution.arm_to_hand_m.min()),
            "max_error_m": verdict.max_error_m,
            "max_excess_m": verdict.max_excess_m,
            "poses_by_speed": np.bincount(speed_bin, minlength=n_bins).astype(np.int32),
            "unsafe_by_speed": np.bincount(speed_bin[unsafe], minlength=n_bins).astype(np.int32),
            "touching_by_speed": np.bincount(speed_bin[touching], minlength=n_bins).astype(np.int32),
            "min_tool_by_speed_m": np.array([tool_m[speed_bin == n].min(initial=np.inf) for n in range(n_bins)]),
        }

    def _extruded(self, picture: NDArray[np.float32]) -> OccupancyGrid:
        scene = self.scene
        return grid_from_image(picture, scene.camera, scene.table_z_m, scene.hand_height_m, self.settings.field)


class _Clock:
    """CPU time of this thread inside a `with` block, added to a stage; a stage inside another is not counted twice."""

    def __init__(self, seconds: dict[str, float], stage: str) -> None:
        self.seconds, self.stage = seconds, stage

    def __enter__(self) -> None:
        self.began_s, self.others_s = time.thread_time(), sum(self.seconds.values())

    def __exit__(self, *error: object) -> None:
        spent_s = time.thread_time() - self.began_s
        inside_s = sum(self.seconds.values()) - self.others_s
        self.seconds[self.stage] += spent_s - inside_s
