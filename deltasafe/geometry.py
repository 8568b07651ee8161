"""Poses, paths and trajectories of the tool: meters, radians and seconds in the world frame (z up)."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

Array = NDArray[np.float64]

MAX_COORDINATE = 1000.0
"""Largest coordinate, in meters and radians: compiled code converts coordinates to integer indices."""

MAX_DURATION_S = 1e5
"""Longest trajectory, more than a day: all samples of the controller are held in memory."""


def as_rows(values: object, columns: int, name: str) -> Array:
    """Copy ``values`` to a contiguous float64 array (N, ``columns``), finite and within ``MAX_COORDINATE``.

    Compiled code converts coordinates to indices without a check, and NaN or 1e300 would read outside the arrays. Each
    public function that calls such code validates its input here.

    Raises:
        SettingsError: wrong shape, not numeric, or a value that is not finite or too large; names the row.
    """
    try:
        rows = np.array(values, dtype=np.float64, order="C")
    except (TypeError, ValueError) as error:
        raise SettingsError(f"{name} must be numbers of shape (N, {columns}): {error}") from error
    if rows.ndim != 2 or rows.shape[1] != columns:
        raise SettingsError(f"{name} must have shape (N, {columns}), got {rows.shape}")
    if not np.abs(rows).max(initial=0.0) <= MAX_COORDINATE:  # false for NaN
        row = int(np.flatnonzero(~(np.abs(rows) <= MAX_COORDINATE).all(axis=1))[0])
        raise SettingsError(
            f"{name} must be finite and within {MAX_COORDINATE:g} meters and radians, "
            f"got {rows[row].tolist()} in row {row}"
        )
    return rows


def wrap_to_pi(angle_rad: Array | float) -> Array:
    """Map angles to [-pi, pi), modulo a full turn."""
    return np.asarray((np.asarray(angle_rad) + math.pi) % (2 * math.pi) - math.pi)


def yaw_of(quaternions: Array) -> Array:
    """Return the yaw in [-pi, pi] of quaternions (..., 4), ordered x, y, z, w."""
    x, y, z, w = np.moveaxis(np.asarray(quaternions), -1, 0)
    return np.asarray(np.arctan2(2 * (w * z + x * y), 1 - 2 * (y * y + z * z)))


@dataclasses.dataclass(frozen=True)
class Pose:
    """Position of the tool center and its rotation about the vertical axis (section V-B of the paper)."""

    x_m: float
    y_m: float
    z_m: float
    yaw_rad: float = 0.0

    def __post_init__(self) -> None:
        if not all(abs(value) <= MAX_COORDINATE for value in self.as_tuple()):  # false for NaN
            raise SettingsError(
                f"a pose must be finite and within {MAX_COORDINATE:g} meters and radians, got {self.as_tuple()}"
            )

    def as_tuple(self) -> tuple[float, float, float, float]:
        """x, y, z in meters, yaw in radians."""
        return (self.x_m, self.y_m, self.z_m, self.yaw_rad)

    def as_array(self) -> Array:
        """(4,) float64: x, y, z in meters, yaw in radians."""
        return np.array(self.as_tuple())


@dataclasses.dataclass(frozen=True)
class PosePath:
    """A polyline of K >= 1 poses; yaw is continuous (unwrapped) along it.

    Attributes:
        poses: (K, 4) float64, read-only: x, y, z in meters, yaw in radians.
    """

    poses: Array

    def __post_init__(self) -> None:
        object.__setattr__(self, "poses", _frozen(self.poses, "poses"))
        if len(self.poses) == 0:
            raise SettingsError("a path needs at least one pose")

    def __len__(self) -> int:
        return len(self.poses)

    @property
    def length_m(self) -> float:
        """Length of the polyline of positions; rotation adds nothing."""
        return float(np.linalg.norm(np.diff(self.poses[:, :3], axis=0), axis=1).sum())


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """Reference motion sampled at the controller's rate.

    Attributes:
        time_s: (N,) strictly increasing, starting at 0.
        poses: (N, 4) x, y, z in meters, yaw in radians (continuous).
        velocities: (N, 4) time derivatives of ``poses`` in m/s and rad/s.
    """

    time_s: Array
    poses: Array
    velocities: Array

    def __post_init__(self) -> None:
        time_s = np.array(self.time_s, dtype=np.float64)
        if time_s.ndim != 1 or len(time_s) == 0 or not np.isfinite(time_s).all():
            raise SettingsError(f"time_s must be a finite vector of at least one sample, got {time_s.shape}")
        if time_s[0] != 0.0 or (np.diff(time_s) <= 0).any():
            raise SettingsError("time_s must start at 0 and increase strictly")
        if time_s[-1] > MAX_DURATION_S:
            raise SettingsError(f"time_s must end within {MAX_DURATION_S:g} s, got {time_s[-1]:g}")
        time_s.setflags(write=False)
        object.__setattr__(self, "time_s", time_s)
        object.__setattr__(self, "poses", _frozen(self.poses, "poses"))
        object.__setattr__(self, "velocities", _frozen(self.velocities, "velocities"))
        if not len(self.time_s) == len(self.poses) == len(self.velocities):
            raise SettingsError(
                f"time_s, poses and velocities must be equally long, got "
                f"{len(self.time_s)}, {len(self.poses)}, {len(self.velocities)}"
            )

    @property
    def duration_s(self) -> float:
        """Time of the last sample."""
        return float(self.time_s[-1])

    @property
    def speed_mps(self) -> Array:
        """(N,) speed of the tool center in m/s."""
        return np.asarray(np.linalg.norm(self.velocities[:, :3], axis=1))


def _frozen(values: Array, name: str) -> Array:
    rows = as_rows(values, 4, name)
    rows.setflags(write=False)
    return rows
