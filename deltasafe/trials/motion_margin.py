"""The margin that a motion keeps around the unsafe set, from calibration and camera (decision 75)."""

import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.conformal_margin import ConformalMargin
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.planning import MotionSettings
from deltasafe.scene import Camera, OccupancyGrid

_SAMPLES = 33
"""Points along each edge of the grid at which the ground sampling distance is evaluated, borders included."""

_BORDER = 0.05
"""Fraction of the image by which a point may lie outside of it: the grid is at most a voxel larger than the view."""


def require_supported_alpha(delta: float, alpha: float, calibration: Calibration) -> ConformalMargin | None:
    """Return the margin of the calibration for ``delta`` and ``alpha``; None for alpha = 0, which needs none.

    Raises:
        SettingsError: the calibration has no margins, too few images for ``alpha``, or no finite margin; names the
            smallest alpha that it allows.
    """
    if alpha == 0.0:
        return None
    if calibration.conformal_margins is None:
        raise SettingsError(
            f"motion_alpha = {alpha:g} needs margins, which the calibration of this ensemble does not state: it was "
            "frozen by an earlier version. Freeze it again, or plan with motion_alpha = 0 (pointwise delta-safety only)"
        )
    margin = calibration.conformal_margins.margin(delta, alpha)
    if math.isinf(margin.fraction_of_width):
        raise SettingsError(
            f"motion_alpha = {alpha:g} has no finite margin at delta = {delta:g}: in too many of the {margin.n_images} "
            "calibration images no pixel of the obstacle exceeds delta; use a smaller delta or a larger alpha"
        )
    return margin


def motion_margin_m(calibration: Calibration, settings: MotionSettings, camera: Camera, grid: OccupancyGrid) -> float:
    """Return the horizontal margin in meters that a motion keeps; 0 if ``settings.motion_alpha`` is 0.

    The margin of the calibration is a fraction of the image's width. A pixel covers at most the largest ground sampling
    distance at the table inside of the grid, and less at every height above it.

    Raises:
        SettingsError: see `require_supported_alpha`.
    """
    margin = require_supported_alpha(settings.delta, settings.motion_alpha, calibration)
    if margin is None:
        return 0.0
    x, y = np.linspace(grid.origin_m, grid.upper_m, _SAMPLES).T[:2]
    table = np.stack([*np.meshgrid(x, y), np.full((_SAMPLES, _SAMPLES), grid.origin_m[2])], axis=-1).reshape(-1, 3)
    return margin.fraction_of_width * camera.width * camera.ground_sampling_distance_m(_seen(camera, table))


def _seen(camera: Camera, points_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Points (N, 3) of the table that the camera sees; an oblique one sees a part of the grid, the rest is occupied."""
    uv, _ = camera.project(points_m)
    size = np.array([camera.width, camera.height])
    seen = points_m[((uv > -_BORDER * size) & (uv < (1 + _BORDER) * size)).all(axis=1)]  # false for NaN
    if len(seen):
        return np.asarray(seen)
    lower_m, upper_m = points_m.min(axis=0), points_m.max(axis=0)
    corners = camera.view_on_plane(float(lower_m[2]), lower_m[:2], upper_m[:2])
    return np.column_stack([corners, np.full(len(corners), lower_m[2])])
