"""Settings of the planner study: of the search, of Fig. 5 and of Fig. 6."""

import dataclasses
import math

from deltasafe.errors import SettingsError
from deltasafe.setting_ranges import check_range
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
        check_range(self, "[1, inf)", "n_iterations", "n_samples")
        check_range(self, "[0, inf)", "first_seed")
        check_range(self, "(0, 0.5)", "delta")
        check_range(self, "(0, inf)", "delta_p_m", "voxel_m", "rotation_weight_m2", "steering_range_m", "near_factor")


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
        check_range(self, "[2, inf)", "n_levels", "n_runs")
        check_range(self, f"[2, {self.n_runs}]", "n_runs_reference")
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
        check_range(self, "[1, inf)", "counts", "n_runs", "few_samples")
        check_range(self, "(0, inf)", "level_m", "radius_m")
        check_range(self, "[0, inf)", "scene_seed")
        if list(self.counts) != sorted(set(self.counts)):
            raise SettingsError(f"counts must be increasing, got {self.counts}")
