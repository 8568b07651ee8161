"""Settings of the safety study, and its plan: which trial has which scenario, method and delta."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.execution.settings import ExecutionSettings
from deltasafe.planning import MotionSettings
from deltasafe.scene import FieldSettings
from deltasafe.setting_ranges import check_range
from deltasafe.studies import baselines

PARAMETRIC = ("chance_constraint", "bounding_volume", "max_probability")
"""The published methods; their obstacles are ellipsoids at Gaussian positions."""

METHODS = ("ours", "single_member", "top_speed", *PARAMETRIC, "with_margin")
"""Ours is the field of the whole ensemble with a velocity schedule. ``single_member`` and ``top_speed`` change one of
the two. ``with_margin`` also keeps the conformal margin around the unsafe set."""

LABELS = {
    "ours": "Ours (M = {members}, scheduled)",
    "single_member": "Single member (M = 1)",
    "top_speed": "Without velocity schedule",
    **baselines.LABELS,
    "with_margin": "Ours with margin, alpha = {alpha:g}",
}


@dataclasses.dataclass(frozen=True)
class CameraSettings:
    """Variation of the camera between two images of the same scene; every value is drawn anew for each image.

    Attributes:
        exposure_stops_sd: standard deviation of the exposure, in stops.
        white_balance_sd: standard deviation of the red and blue gains relative to green.
        read_noise_sd: standard deviation of the noise of a dark pixel, of 255.
        shot_noise_sd: standard deviation of the shot noise of a white pixel, of 255; it grows with sqrt(light).
        jpeg_quality: smallest and largest quality of the compression.
    """

    exposure_stops_sd: float = 0.2
    white_balance_sd: float = 0.04
    read_noise_sd: float = 2.0
    shot_noise_sd: float = 4.0
    jpeg_quality: tuple[int, ...] = (60, 95)

    def __post_init__(self) -> None:
        check_range(self, "[0, inf)", "exposure_stops_sd", "white_balance_sd", "read_noise_sd", "shot_noise_sd")
        if len(self.jpeg_quality) != 2 or not 1 <= self.jpeg_quality[0] <= self.jpeg_quality[1] <= 100:
            raise SettingsError(f"jpeg_quality must be a range within 1 and 100, got {self.jpeg_quality}")


@dataclasses.dataclass(frozen=True)
class TaskSettings:
    """How start and goal are drawn: on opposite sides of the hand.

    Attributes:
        clearance_m: smallest horizontal distance of start and goal to the true hand. It is larger than in the logged
            scenes, because the compared methods must be able to start. Their robot is a ball with the tracking error.
        border_m: smallest distance of start and goal to the border of the view, which is the radius of that ball.
        min_distance_m: smallest distance between start and goal.
        near_hand_m: the straight line between them passes the hand within this horizontal distance, so that every
            motion has something to avoid.
        z_range_m: lowest and highest start and goal above the table.
        yaw_range_rad: the yaw of start and goal is drawn within plus or minus this angle.
    """

    clearance_m: float = 0.07
    border_m: float = 0.045
    min_distance_m: float = 0.18
    near_hand_m: float = 0.02
    z_range_m: tuple[float, ...] = (0.03, 0.05)
    yaw_range_rad: float = 0.8

    def __post_init__(self) -> None:
        check_range(self, "[0, inf)", "clearance_m", "border_m", "min_distance_m", "near_hand_m", "yaw_range_rad")
        if len(self.z_range_m) != 2 or not 0 < self.z_range_m[0] <= self.z_range_m[1] < math.inf:
            raise SettingsError(f"z_range_m must be a range of positive heights, got {self.z_range_m}")


@dataclasses.dataclass(frozen=True)
class SafetyStudySettings:
    """Settings of the whole study.

    A scenario is a scene, an image of it with camera noise, start and goal, an arm and a single member. All are drawn
    from ``seed`` and the number of the scenario. Our method runs in every scenario at every delta. The compared methods
    run in every ``compared_every``-th scenario, so that all methods share these scenarios. The bounding volume has no
    delta and runs once, at the middle one.

    Attributes:
        deltas: values of delta, increasing.
        n_executions: scenarios are added until this many motions were executed.
        compared: compared methods, out of ``METHODS[1:]``.
        motion_alpha: of ``with_margin``: bound on the probability that the hand exceeds the unsafe set by more than the
            margin.
        compared_every: the compared methods run in every scenario whose number is a multiple of this.
        seed: seed of everything that is drawn.
        n_obstacles: number of ellipsoids that the compared methods get for a hand.
        n_films: number of failures that are filmed.
        camera, task, field, motion, execution: settings of every trial; each delta replaces ``motion.delta``.
    """

    deltas: tuple[float, ...] = (0.01, 0.05, 0.2)
    n_executions: int = 3000
    compared: tuple[str, ...] = METHODS[1:]
    compared_every: int = 5
    seed: int = 0
    n_obstacles: int = 8
    motion_alpha: float = 0.05
    n_films: int = 4
    camera: CameraSettings = dataclasses.field(default_factory=CameraSettings)
    task: TaskSettings = dataclasses.field(default_factory=TaskSettings)
    field: FieldSettings = dataclasses.field(default_factory=FieldSettings)
    motion: MotionSettings = dataclasses.field(default_factory=MotionSettings)
    execution: ExecutionSettings = dataclasses.field(default_factory=ExecutionSettings)

    def __post_init__(self) -> None:
        if not self.deltas or list(self.deltas) != sorted(set(self.deltas)):
            raise SettingsError(f"deltas must be increasing, got {self.deltas}")
        if set(self.compared) - set(METHODS[1:]) or len(set(self.compared)) < len(self.compared):
            raise SettingsError(f"compared must be a selection of {METHODS[1:]}, each once, got {self.compared}")
        check_range(self, "(0, 0.5)", "deltas")  # which the compared methods require
        check_range(self, "(0, 1)", "motion_alpha")
        check_range(self, "[1, inf)", "n_executions", "compared_every", "n_obstacles")
        check_range(self, "[0, inf)", "seed", "n_films")

    @property
    def methods(self) -> tuple[str, ...]:
        """Our method and the compared ones."""
        return (METHODS[0], *self.compared)

    def deltas_of(self, method: str) -> tuple[float, ...]:
        """Return the values of delta at which a method runs."""
        return self.deltas if method != "bounding_volume" else (self.deltas[len(self.deltas) // 2],)

    def trials_of(self, scenario: int) -> tuple[tuple[str, float], ...]:
        """Return method and delta of each trial of a scenario."""
        names = self.methods if scenario % self.compared_every == 0 else METHODS[:1]
        return tuple((name, delta) for name in names for delta in self.deltas_of(name))

    @property
    def trials_per_scenario(self) -> float:
        """Average number of trials of a scenario."""
        return self._trials_per_round / self.compared_every

    @property
    def _trials_per_round(self) -> int:
        """Number of trials of ``compared_every`` scenarios in a row; the compared methods run in the first of them."""
        return len(self.trials_of(0)) + (self.compared_every - 1) * len(self.deltas)

    def locate(self, trial: int) -> tuple[int, int]:
        """Return the scenario of a trial and its position in ``trials_of``; trials are numbered in order of scenarios.

        Raises:
            SettingsError: the number is negative.
        """
        if trial < 0:
            raise SettingsError(f"the number of a trial must not be negative, got {trial}")
        round_, rest = divmod(trial, self._trials_per_round)
        first = len(self.trials_of(0))
        if rest < first:
            return round_ * self.compared_every, rest
        after, position = divmod(rest - first, len(self.deltas))
        return round_ * self.compared_every + 1 + after, position
