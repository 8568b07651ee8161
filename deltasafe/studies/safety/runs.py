"""Trials: a method runs in a scenario at a delta. One table row each, a pure function of settings and number."""

import dataclasses
import functools
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution import MonitorLimits, Workcell, evaluate_execution
from deltasafe.execution.recording import Execution
from deltasafe.execution.simulate import execute
from deltasafe.execution.verdict import largest_p_occupied
from deltasafe.geometry import Trajectory
from deltasafe.planning import DistanceField, PlanResult, plan
from deltasafe.scene import LoggedScene, OccupancyGrid, grid_from_image
from deltasafe.studies.baselines import GaussianObstacle
from deltasafe.studies.resumable_jobs import Batch
from deltasafe.studies.safety.motions import (
    OUTCOMES,
    RefusalError,
    parametric_motion,
    scheduled_motion,
    top_speed_motion,
)
from deltasafe.studies.safety.obstacle_fit import fit_obstacles
from deltasafe.studies.safety.predictors import Prediction, Predictor
from deltasafe.studies.safety.scenarios import draw_scenario, true_mask
from deltasafe.studies.safety.settings import METHODS, PARAMETRIC, SafetyStudySettings
from deltasafe.trials.motion_margin import motion_margin_m

SPEED_EDGES_MPS = (0.0, 0.005, 0.02, 0.05, 0.1, 0.15, np.inf)
N_BINS = len(SPEED_EDGES_MPS) - 1

COLUMNS: dict[str, type] = {
    "scenario": np.int32,
    "scene": np.int32,
    "method": np.int8,
    "delta": np.float64,
    "member": np.int8,
    "outcome": np.int8,
    "miss_rate": np.float64,
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
"""Columns of a trial and their types; NaN or 0 if no motion was executed.

``method`` and ``outcome`` are indices into ``METHODS`` and ``OUTCOMES``. ``member`` is the single member, -1 for the
ensemble. ``miss_rate`` is the fraction of the true hand's pixels with p_occupied <= delta in the image used. ``poses``
counts recorded poses from rest at the start to rest at the goal. At ``unsafe_poses`` of them a point of the tool has
p_occupied > delta in the field used, or is inside its margin; at ``touching_poses`` the tool touches or crosses the
true hand. ``contacts``, ``min_tool_m`` and ``min_arm_m`` cover the whole recording, approach and retreat included.
"""

BY_SPEED = ("poses_by_speed", "unsafe_by_speed", "touching_by_speed", "min_tool_by_speed_m")
"""Columns by reference speed, with a second axis for the bins between ``SPEED_EDGES_MPS``."""

STAGES = ("see", "plan", "execute", "judge")
"""Stages of a trial whose CPU time is measured; ``see`` is the prediction."""


@dataclasses.dataclass(frozen=True)
class SceneRef:
    """A scene by its folder, and the digest of its content."""

    folder: str
    digest: str


def run_scenario(settings: SafetyStudySettings, scenes: Sequence[SceneRef], predictor: Predictor, number: int) -> Batch:
    """Run all trials of a scenario; return ``COLUMNS`` (T,), ``BY_SPEED`` (T, bins) and ``seconds`` (T, stages)."""
    runner = _ScenarioRunner(settings, scenes, predictor, number)
    rows = [runner.run_trial(position)[0] for position in range(len(settings.trials_of(number)))]
    batch: dict[str, NDArray[Any]] = {
        name: np.array([row[name] for row in rows], kind) for name, kind in COLUMNS.items()
    }
    return batch | {name: np.array([row[name] for row in rows]) for name in (*BY_SPEED, "seconds")}


def replay(
    settings: SafetyStudySettings, scenes: Sequence[SceneRef], predictor: Predictor, trial: int
) -> tuple[LoggedScene, Execution]:
    """Run trial number ``trial`` again; return its scene and its recording.

    Raises:
        SettingsError: the trial ended without an execution; names its outcome.
    """
    number, position = settings.locate(trial)
    runner = _ScenarioRunner(settings, scenes, predictor, number)
    row, execution = runner.run_trial(position)
    if execution is None:
        raise SettingsError(f"trial {trial} was not executed: {OUTCOMES[row['outcome']]}")
    return runner.scene, execution


class _ScenarioRunner:
    """Runs the trials of one scenario. Everything that they share is computed once, on first use."""

    def __init__(
        self, settings: SafetyStudySettings, scenes: Sequence[SceneRef], predictor: Predictor, number: int
    ) -> None:
        self.settings, self.predictor = settings, predictor
        self.scene = LoggedScene.load(scenes[number % len(scenes)].folder)
        self.scenario = draw_scenario(settings, len(scenes), self.scene, number)
        self.seconds = dict.fromkeys(STAGES, 0.0)
        # caches of this instance: caches of the class would keep every scenario as long as the process lives
        self.grid = functools.cache(self._grid)
        self.field = functools.cache(self._field)
        self.plan = functools.cache(self._plan)

    @functools.cached_property
    def prediction(self) -> Prediction:
        with _Clock(self.seconds, "see"):
            return self.predictor.predict(self.scenario.rgb)

    @functools.cached_property
    def hand(self) -> NDArray[np.bool_]:
        return true_mask(self.scene)

    @property
    def member(self) -> int:
        return self.scenario.member % len(self.prediction.members)

    @functools.cached_property
    def view(self) -> DistanceField:
        """Field in which only the space outside the camera's view is occupied."""
        return DistanceField.build(self._extrude(np.zeros_like(self.prediction.ensemble)), self.settings.deltas[0])

    @functools.cached_property
    def obstacles(self) -> list[GaussianObstacle]:
        scene, count = self.scene, self.settings.n_obstacles
        return fit_obstacles(self.prediction.ensemble, scene.camera, scene.table_z_m, scene.hand_height_m, count, 0)

    def p_occupied(self, single: bool) -> NDArray[np.float32]:
        """Predicted p_occupied (H, W) of the single member or of the ensemble."""
        return self.prediction.members[self.member] if single else self.prediction.ensemble

    def _grid(self, single: bool) -> OccupancyGrid:
        return self._extrude(self.p_occupied(single))

    def _field(self, variant: str, delta: float) -> DistanceField:
        """Build the field of the ensemble, of the ``single_member``, or of the ensemble ``with_margin``."""
        grid = self.grid(variant == "single_member")
        if variant == "with_margin":
            grid = grid.dilated(delta, self.margin_m(delta))
        return DistanceField.build(grid, delta)

    def margin_m(self, delta: float) -> float:
        """Return the margin of ``with_margin``."""
        motion = dataclasses.replace(self.settings.motion, delta=delta, motion_alpha=self.settings.motion_alpha)
        return motion_margin_m(self.predictor.calibration(), motion, self.scene.camera, self.grid(False))

    def _plan(self, variant: str, delta: float) -> PlanResult:
        """Plan our path; ``ours`` and ``top_speed`` share it."""
        assert self.scenario.task is not None
        start, goal = self.scenario.task
        motion = dataclasses.replace(self.settings.motion, delta=delta)
        seed = self.scenario.plan_seed
        return plan(start, goal, self.field(variant, delta), motion, seed, motion.body, motion.tracking)

    def run_trial(self, position: int) -> tuple[dict[str, Any], Execution | None]:
        """Run one trial; return its row and, if it was executed, the recording."""
        method, delta = self.settings.trials_of(self.scenario.number)[position]
        single = method == "single_member"
        self.seconds = dict.fromkeys(STAGES, 0.0)
        row: dict[str, Any] = {name: np.nan if kind is np.float64 else 0 for name, kind in COLUMNS.items()}
        row |= {
            "scenario": self.scenario.number,
            "scene": self.scenario.scene,
            "method": METHODS.index(method),
            "delta": delta,
            "member": self.member if single else -1,
            "miss_rate": float((self.p_occupied(single)[self.hand] <= delta).mean()),
        }
        row |= {name: np.zeros(N_BINS, np.int32) for name in BY_SPEED[:-1]}
        row[BY_SPEED[-1]] = np.full(N_BINS, np.nan)
        execution = None
        try:
            with _Clock(self.seconds, "plan"):
                trajectory = self._trajectory(method, delta)
            with _Clock(self.seconds, "execute"):
                execution = self._execute(trajectory)
        except RefusalError as refusal:
            row["outcome"] = OUTCOMES.index(str(refusal))
        except PlanningError:
            row["outcome"] = OUTCOMES.index("the arm cannot follow")
        else:
            with _Clock(self.seconds, "judge"):
                row |= self._evaluate(execution, trajectory, delta, self.field(_variant(method), delta).grid)
        return row | {"seconds": np.array([self.seconds[name] for name in STAGES])}, execution

    def _trajectory(self, method: str, delta: float) -> Trajectory:
        task, seed = self.scenario.task, self.scenario.plan_seed
        if task is None:
            raise RefusalError("no task")
        motion = dataclasses.replace(self.settings.motion, delta=delta)
        if method in PARAMETRIC:
            return parametric_motion(method, self.obstacles, self.view, task, motion, seed)
        variant = _variant(method)
        timed = top_speed_motion if method == "top_speed" else scheduled_motion
        result = self.plan(variant, delta)
        return timed(result, self.field(variant, delta), motion)

    def _execute(self, trajectory: Trajectory) -> Execution:
        settings, scene, motion = self.settings, self.scene, self.settings.motion
        max_error_m = float(motion.tracking.error_m(motion.v_max_mps))
        return execute(
            trajectory,
            Workcell(motion.body, scene.true_mesh(), scene.table_z_m),
            settings.execution,
            self.scenario.arm_seed,
            limits=MonitorLimits.of(motion),
            unsafe_below_m=float(self.grid(False).upper_m[2]) + max_error_m,
        )

    def _evaluate(
        self, execution: Execution, trajectory: Trajectory, delta: float, grid: OccupancyGrid
    ) -> dict[str, Any]:
        """Compute the columns of an executed motion."""
        motion = dataclasses.replace(self.settings.motion, delta=delta)
        verdict = evaluate_execution(execution, grid, motion)
        judged = execution.judged
        tool_m = execution.tool_to_hand_m[judged]
        touching = tool_m <= 0
        unsafe = np.zeros(verdict.poses, np.bool_)
        if not verdict.whole_motion_delta_safe:
            unsafe = largest_p_occupied(execution, grid, motion.body)[judged] > delta
        speed_bin = np.digitize(execution.reference_speed_mps[judged], SPEED_EDGES_MPS[1:-1])
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
            "poses_by_speed": np.bincount(speed_bin, minlength=N_BINS).astype(np.int32),
            "unsafe_by_speed": np.bincount(speed_bin[unsafe], minlength=N_BINS).astype(np.int32),
            "touching_by_speed": np.bincount(speed_bin[touching], minlength=N_BINS).astype(np.int32),
            "min_tool_by_speed_m": np.array([tool_m[speed_bin == n].min(initial=np.inf) for n in range(N_BINS)]),
        }

    def _extrude(self, p_occupied: NDArray[np.float32]) -> OccupancyGrid:
        scene = self.scene
        return grid_from_image(p_occupied, scene.camera, scene.table_z_m, scene.hand_height_m, self.settings.field)


def _variant(method: str) -> str:
    """Return which field a method uses; the compared methods are judged by that of ours."""
    return method if method in ("single_member", "with_margin") else "ours"


class _Clock:
    """Adds the CPU time of a `with` block to a stage, without the time of stages nested in it."""

    def __init__(self, seconds: dict[str, float], stage: str) -> None:
        self.seconds, self.stage = seconds, stage

    def __enter__(self) -> None:
        self.started_s, self.others_s = time.thread_time(), sum(self.seconds.values())

    def __exit__(self, *error: object) -> None:
        spent_s = time.thread_time() - self.started_s
        inside_s = sum(self.seconds.values()) - self.others_s
        self.seconds[self.stage] += spent_s - inside_s
