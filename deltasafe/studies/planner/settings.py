"""Settings of the planner study: of the search, of Fig. 5 and of Fig. 6."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.studies.planner.scenes import PAPER_UNIT_M


@dataclasses.dataclass(frozen=True)
class SearchSettings:
    """Settings of one search: the paper's RRT*, without informed sampling and refinement.

    Attributes:
        n_iterations: number of iterations N_iter.
        n_samples: number of samples N_x of our method.
        delta: largest probability of collision; the bounding volume ignores it.
        margin_m: tracking error at the smallest speed, added to the body by every method.
        delta_p_m: largest distance between two tested poses.
        voxel_m: edge of a voxel of the field. A voxel takes the upper bound of its points, which makes our method
            more conservative.
        rotation_weight_m2: rotation weight r of the line cost.
        steering_range_m, goal_bias, near_factor: parameters of RRT*, see ``RrtStar``.
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
    """Settings of Fig. 5, path cost over uncertainty.

    Attributes:
        n_levels: number of levels of uncertainty, evenly spaced from 0 to ``largest_level_m``.
        largest_level_m: largest d-tilde = 2 sigma, 0.5 units of the paper.
        least_level_m: d-tilde of a Gaussian at level 0, where it would have no density; 0.002 units of the paper.
        n_runs: runs of each of the four methods, per scene and level.
        n_runs_reference: runs of each reference and of each method with the squared cost, per scene and level.
    """

    n_levels: int = 26
    largest_level_m: float = 0.5 * PAPER_UNIT_M
    least_level_m: float = 0.002 * PAPER_UNIT_M
    n_runs: int = 100
    n_runs_reference: int = 25

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.n_levels < 2 or self.n_runs < 2 or not 2 <= self.n_runs_reference <= self.n_runs:
            raise SettingsError(
                f"n_levels and n_runs must be at least 2, n_runs_reference between 2 and n_runs, "
                f"got {self.n_levels}, {self.n_runs} and {self.n_runs_reference}"
            )
        if not 0 < self.least_level_m < self.largest_level_m < math.inf:
            raise SettingsError(
                f"levels need 0 < least_level_m < largest_level_m, got {self.least_level_m} and {self.largest_level_m}"
            )

    @property
    def levels_m(self) -> tuple[float, ...]:
        """d-tilde = 2 sigma of each level, in meters."""
        return tuple(self.largest_level_m * n / (self.n_levels - 1) for n in range(self.n_levels))

    def runs_of(self, is_main: bool) -> int:
        """Number of runs of one of the four methods (``is_main``), or of another one."""
        return self.n_runs if is_main else self.n_runs_reference


@dataclasses.dataclass(frozen=True)
class TimingSettings(SearchSettings):
    """Settings of Fig. 6, search time over the number of obstacles.

    Attributes:
        counts: numbers of obstacles.
        n_runs: runs of each method and number of obstacles.
        level_m: uncertainty d-tilde = 2 sigma.
        radius_m: radius of the spheres.
        scene_seed: seed of the positions of the spheres; each scene contains the smaller ones.
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
