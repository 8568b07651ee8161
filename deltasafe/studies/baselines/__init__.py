"""The compared methods: collision chance constraints for obstacles of known shape at a Gaussian position."""

from deltasafe.studies.baselines.in_view import GaussianTestInView
from deltasafe.studies.baselines.obstacles import GaussianObstacle, enclosing_obstacle
from deltasafe.studies.baselines.probability import (
    JOINT_RISKS,
    METHODS,
    collision_probability,
    collision_probability_of_ball,
    joint_probability,
)
from deltasafe.studies.baselines.segment_tests import GaussianCheckSettings, GaussianTest, gaussian_test, keep_out_m

__all__ = [
    "JOINT_RISKS",
    "METHODS",
    "GaussianCheckSettings",
    "GaussianObstacle",
    "GaussianTest",
    "GaussianTestInView",
    "collision_probability",
    "collision_probability_of_ball",
    "enclosing_obstacle",
    "gaussian_test",
    "joint_probability",
    "keep_out_m",
]
