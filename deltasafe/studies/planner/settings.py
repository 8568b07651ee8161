"""Settings of the study; what both figures share is the search itself."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.studies.planner.scenes import PAPER_UNIT_M

__all__ = ["ComparisonSettings", "SearchSettings", "TimingSettings"]


@dataclasses.dataclass(frozen=True)
class SearchSettings:
    """One search of the study: the paper's RRT*, neither informed nor refined.

    Attributes:
        n_iterations: N_iter.
        n_samples: N_x of our method.
        delta: of every method that has one.
        margin_m: gamma at the smallest speed, part of the body of every method.
        delta_p_m: largest motion between two tested poses.
        voxel_m: of the field; a voxel takes the upper bound of its points, on the cost of our method.
        rotation_weight_m2: r of the line cost.
        steering_range_m, goal_bias, near_factor: see ``grow_tree``.
        first_seed: run k of every method uses ``first_seed`` + k.
    """

    n_iterations: int = 2000
    n_samples: int = 100
    delta: float = 0.05
    margin_m: float = 0.0005
    delta_p_m: float = 0.01
    voxel_m: float = 0.005
    rotation_weight_m2: float = 0.01
    steering_range_m: float = 0.2
    goal_bias: float = 0.05
    near_factor: float = 1.1
    first_seed: int = 0

    def __post_init__(self) -> None:
        for name in ("n_iterations", "n_samples"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} must be at least 1, got {getattr(self, name)}")
        if not 0 < self.delta < 0.5:
            raise SettingsError(f"delta must be in (0, 0.5), got {self.delta}")
        for name in ("delta_p_m", "voxel_m", "rotation_weight_m2", "steering_range_m", "near_factor"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) > 0):
                raise SettingsError(f"{name} must be positive, got {getattr(self, name)}")


@dataclasses.dataclass(frozen=True)
class ComparisonSettings(SearchSettings):
    """Fig. 5.

    Attributes:
        n_levels: levels of uncertainty, evenly from 0 to ``largest_level_m``.
        largest_level_m: largest d-tilde = 2 sigma; the paper's 0.5 of its units.
        least_level_m: what a Gaussian gets at level 0, where it would have no density (the paper's 0.002 units).
        n_runs: runs of each of the four methods, a scene and a level.
        n_runs_beside: runs of each reference and of the squared cost.
    """

    n_levels: int = 26
    largest_level_m: float = 0.5 * PAPER_UNIT_M
    least_level_m: float = 0.002 * PAPER_UNIT_M
    n_runs: int = 100
    n_runs_beside: int = 25

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_levels < 2 or self.n_runs < 2 or not 2 <= self.n_runs_beside <= self.n_runs:
            raise SettingsError(
                f"a comparison needs two levels and two runs, and no more runs beside than in it, "
                f"got {self.n_levels}, {self.n_runs} and {self.n_runs_beside}"
            )
        if not 0 < self.least_level_m < self.largest_level_m < math.inf:
            raise SettingsError(f"levels need 0 < least < largest, got {self.least_level_m} and {self.largest_level_m}")

    @property
    def levels_m(self) -> tuple[float, ...]:
        """d-tilde = 2 sigma of each level."""
        return tuple(self.largest_level_m * n / (self.n_levels - 1) for n in range(self.n_levels))


@dataclasses.dataclass(frozen=True)
class TimingSettings(SearchSettings):
    """Fig. 6.

    Attributes:
        counts: numbers of obstacles.
        n_runs: runs of each method and count; each in turn, so that a busy moment meets all methods.
        level_m: d-tilde = 2 sigma.
        radius_m: of the spheres.
        scene_seed: places of the spheres; each count adds to the one before.
        few_samples: the smaller N_x.
    """

    counts: tuple[int, ...] = (*range(1, 11), *range(15, 101, 5))
    n_runs: int = 20
    level_m: float = 0.01
    radius_m: float = 0.02
    scene_seed: int = 0
    few_samples: int = 20

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.counts or min(self.counts) < 1 or list(self.counts) != sorted(set(self.counts)):
            raise SettingsError(f"counts must be increasing and at least 1, got {self.counts}")
        if self.n_runs < 1 or self.few_samples < 1:
            raise SettingsError(f"n_runs and few_samples must be at least 1, got {self.n_runs}, {self.few_samples}")
        if not (self.level_m > 0 and self.radius_m > 0):
            raise SettingsError(f"level_m and radius_m must be positive, got {self.level_m} and {self.radius_m}")
