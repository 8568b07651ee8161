"""Compared methods: chance constraints for obstacles of known shape at Gaussian positions."""

from deltasafe.studies.baselines.obstacles import GaussianObstacle, enclosing_obstacle
from deltasafe.studies.baselines.segment_tests import GaussianCheckSettings, GaussianTestInView, gaussian_test

__all__ = [
    "COLORS",
    "LABELS",
    "GaussianCheckSettings",
    "GaussianObstacle",
    "GaussianTestInView",
    "enclosing_obstacle",
    "gaussian_test",
]

LABELS = {
    "chance_constraint": "Chance constraint",
    "bounding_volume": "Bounding volume",
    "max_probability": "Max. prob. approx.",
}
"""Names of the compared methods in figures and tables."""

COLORS = {
    "ours": "#C8102E",
    "chance_constraint": "#1b1f24",
    "bounding_volume": "#2a9d4a",
    "max_probability": "#1f5fbf",
}
"""Colors of the four methods in the paper's figures: red, black, green, blue."""
