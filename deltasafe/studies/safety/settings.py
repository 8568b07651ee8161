"""Settings of the safety study, and its plan: which trial is what, as a pure function of settings and number."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.execution.simulate import ExecutionSettings
from deltasafe.planning import MotionSettings
from deltasafe.scene import FieldSettings

__all__ = ["CONTENDERS", "LABELS", "PARAMETRIC", "CameraSettings", "SafetyStudySettings", "TaskSettings"]

PARAMETRIC = ("chance_constraint", "bounding_volume", "max_probability")
"""The compared methods, which are told of ellipsoids at Gaussian positions."""

CONTENDERS = ("ours", "single_member", "top_speed", *PARAMETRIC)
"""Ours: the field of the whole ensemble and a velocity schedule. Each of the others differs in one thing."""

LABELS = {
    "ours": "Ours (M = {members}, scheduled)",
    "single_member": "Single member (M = 1)",
    "top_speed": "Without velocity schedule",
    "chance_constraint": "Chance constraint",
    "bounding_volume": "Bounding volume",
    "max_probability": "Max. prob. approx.",
}


@dataclasses.dataclass(frozen=True)
class CameraSettings:
    """What a camera changes from one picture of the same scene to the next; everything is drawn anew each time.

    Attributes:
        exposure_stops_sd: standard deviation of the exposure, in stops.
        white_balance_sd: standard deviation of the gain of red and of blue against green.
        read_noise_sd: noise of a dark pixel, of 255.
        shot_noise_sd: noise that light adds to a white pixel, of 255; it grows with the root of the light.
        jpeg_quality: range of the quality of the compression.
    """

    exposure_stops_sd: float = 0.2
    white_balance_sd: float = 0.04
    read_noise_sd: float = 2.0
    shot_noise_sd: float = 4.0
    jpeg_quality: tuple[int, ...] = (60, 95)

    def __post_init__(self) -> None:
        for name in ("exposure_stops_sd", "white_balance_sd", "read_noise_sd", "shot_noise_sd"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name} must be finite and not negative, got {value}")
        if len(self.jpeg_quality) != 2 or not 1 <= self.jpeg_quality[0] <= self.jpeg_quality[1] <= 100:
            raise SettingsError(f"jpeg_quality must be a range within 1 and 100, got {self.jpeg_quality}")


@dataclasses.dataclass(frozen=True)
class TaskSettings:
    """How start and goal are drawn: one on either side, with the hand in between.

    Attributes:
        clearance_m: least distance of both ends to the true hand, seen from above. A little more than in the logged
            scenes: the compared methods, whose robot is a ball with the tracking error in it, must be able to begin.
        border_m: of the view, kept free around both ends: that ball's reach.
        least_way_m: least distance between them.
        close_m: the straight line between them comes this near to the hand, seen from above; a motion that has nothing
            to avoid would be no evidence.
        z_range_m: heights of the ends above the table.
        yaw_range_rad: yaw of either end is drawn within +- this.
    """

    clearance_m: float = 0.07
    border_m: float = 0.045
    least_way_m: float = 0.18
    close_m: float = 0.02
    z_range_m: tuple[float, ...] = (0.03, 0.05)
    yaw_range_rad: float = 0.8

    def __post_init__(self) -> None:
        for name in ("clearance_m", "border_m", "least_way_m", "close_m", "yaw_range_rad"):
            value = getattr(self, name)
            if not (math.isfinite(value) and value >= 0):
                raise SettingsError(f"{name} must be finite and not negative, got {value}")
        if len(self.z_range_m) != 2 or not 0 < self.z_range_m[0] <= self.z_range_m[1] < math.inf:
            raise SettingsError(f"z_range_m must be a range of positive heights, got {self.z_range_m}")


@dataclasses.dataclass(frozen=True)
class SafetyStudySettings:
    """The whole study.

    A situation is a scene, a picture of it (camera noise), start and goal, an arm and a single member, all drawn from
    ``seed`` and its number. Ours meets every situation at every delta, the other contenders every ``beside_every``-th:
    all of them meet the same situations. The bounding volume, which has no delta, meets them once, at the middle one.

    Attributes:
        deltas: levels.
        beside: the contenders beside ours, out of ``CONTENDERS``.
        n_executions: situations are added until this many motions were executed.
        beside_every: see above.
        seed: of all that is drawn.
        n_obstacles: ellipsoids that the compared methods are told of.
        n_bootstrap: resamples of scenes behind an interval.
        n_films: failures that are filmed.
        camera, task, field, motion, execution: of every trial; ``motion.delta`` is replaced by each level.
    """

    deltas: tuple[float, ...] = (0.01, 0.05, 0.2)
    n_executions: int = 3000
    beside: tuple[str, ...] = CONTENDERS[1:]
    beside_every: int = 5
    seed: int = 0
    n_obstacles: int = 8
    n_bootstrap: int = 2000
    n_films: int = 4
    camera: CameraSettings = dataclasses.field(default_factory=CameraSettings)
    task: TaskSettings = dataclasses.field(default_factory=TaskSettings)
    field: FieldSettings = dataclasses.field(default_factory=FieldSettings)
    motion: MotionSettings = dataclasses.field(default_factory=MotionSettings)
    execution: ExecutionSettings = dataclasses.field(default_factory=ExecutionSettings)

    def __post_init__(self) -> None:
        if not self.deltas or list(self.deltas) != sorted(set(self.deltas)):
            raise SettingsError(f"deltas must be increasing, got {self.deltas}")
        if set(self.beside) - set(CONTENDERS[1:]) or len(set(self.beside)) < len(self.beside):
            raise SettingsError(f"beside must be some of {CONTENDERS[1:]}, each once, got {self.beside}")
        if not 0 < self.deltas[0] <= self.deltas[-1] < 0.5:
            raise SettingsError(f"deltas must lie in (0, 0.5), where the compared methods have them, got {self.deltas}")
        for name in ("n_executions", "beside_every", "n_obstacles", "n_bootstrap"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.seed < 0 or self.n_films < 0:
            raise SettingsError(f"seed and n_films must not be negative, got {self.seed} and {self.n_films}")

    @property
    def contenders(self) -> tuple[str, ...]:
        """Ours and those beside it."""
        return (CONTENDERS[0], *self.beside)

    def deltas_of(self, contender: str) -> tuple[float, ...]:
        """The levels that a contender is run at."""
        return self.deltas if contender != "bounding_volume" else (self.deltas[len(self.deltas) // 2],)

    def trials_of(self, situation: int) -> tuple[tuple[str, float], ...]:
        """Method and delta of each trial of a situation."""
        names = self.contenders if situation % self.beside_every == 0 else CONTENDERS[:1]
        return tuple((name, delta) for name in names for delta in self.deltas_of(name))

    @property
    def trials_per_situation(self) -> float:
        """On average."""
        few, many = len(self.trials_of(1)) if self.beside_every > 1 else 0, len(self.trials_of(0))
        return (many + (self.beside_every - 1) * few) / self.beside_every

    def situation_and_place(self, trial: int) -> tuple[int, int]:
        """Situation of trial number ``trial``, and its place in it; trials are counted situation by situation."""
        if trial < 0:
            raise SettingsError(f"a trial's number is not negative, got {trial}")
        few = len(self.deltas)
        many = len(self.trials_of(0))
        round_, rest = divmod(trial, many + (self.beside_every - 1) * few)
        if rest < many:
            return round_ * self.beside_every, rest
        after, place = divmod(rest - many, few)
        return round_ * self.beside_every + 1 + after, place
