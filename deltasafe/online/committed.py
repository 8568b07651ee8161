"""Committed motions: one control cycle along a path, and the braking trajectory to standstill that follows it."""

import dataclasses
import functools

import numpy as np
from numpy.typing import NDArray

from deltasafe.geometry import Pose, Trajectory
from deltasafe.online.settings import OnlineSettings

Array = NDArray[np.float64]

STILL_MPS = 1e-9


@dataclasses.dataclass(frozen=True)
class TimedPath:
    """A trajectory from rest to rest, driven at a rate between 0 and 1: the pose at path time s moves by s' = rate.

    Attributes:
        trajectory: the schedule of the path.
        number: of the plan.
        rho_max_m: converts yaw rates to speeds of the tool's fastest point.
    """

    trajectory: Trajectory
    number: int
    rho_max_m: float

    def at(self, s: Array) -> tuple[Array, Array]:
        """Poses (N, 4) and speeds (N,) of the fastest point at rate 1, at path times (N,)."""
        time_s, poses = self.trajectory.time_s, self.trajectory.poses
        columns = [np.interp(s, time_s, poses[:, n]) for n in range(4)]
        return np.stack(columns, axis=1), np.interp(s, time_s, self._speed_mps)

    def peak_mps(self, start_s: float, end_s: float) -> float:
        """Largest speed between two path times."""
        first, last = np.searchsorted(self.trajectory.time_s, (start_s, end_s))
        return float(self._speed_mps[max(first - 1, 0) : last + 1].max())

    @functools.cached_property
    def _speed_mps(self) -> Array:
        velocities = self.trajectory.velocities
        return np.asarray(np.linalg.norm(velocities[:, :3], axis=1) + self.rho_max_m * np.abs(velocities[:, 3]))


@dataclasses.dataclass(frozen=True)
class Committed:
    """A reference that ends at rest, whatever happens to the loop. It holds its last pose after its last sample.

    Attributes:
        time_s: (N,) on the control's clock.
        poses: (N, 4); straight between samples, and constant before the first and after the last one.
        speed_mps: (N,) upper bound of the reference speed of the fastest point on both sides of a sample; 0 at the end.
        progress_s, rate: (N,) path time and its derivative.
        path: None: the arm holds one pose.
        captured_s: of the image that it was verified with; NaN if it only holds a pose.
    """

    time_s: Array
    poses: Array
    speed_mps: Array
    progress_s: Array
    rate: Array
    path: TimedPath | None
    captured_s: float

    @property
    def end_pose(self) -> Pose:
        """Where the arm comes to rest."""
        return Pose(*map(float, self.poses[-1]))

    def is_moving_at(self, time_s: float) -> bool:
        """Whether the reference moves at or after a time."""
        first = max(int(np.searchsorted(self.time_s, time_s, "right")) - 1, 0)
        return bool((self.speed_mps[first:] > STILL_MPS).any())

    def at(self, time_s: float) -> tuple[Array, float]:
        """Reference pose (4,) and speed at a time."""
        pose = np.array([np.interp(time_s, self.time_s, self.poses[:, n]) for n in range(4)])
        return pose, float(np.interp(time_s, self.time_s, self.speed_mps))

    def state_at(self, time_s: float) -> tuple[float, float]:
        """Path time and rate at a time."""
        s, rate = (float(np.interp(time_s, self.time_s, column)) for column in (self.progress_s, self.rate))
        return s, rate


def standstill(pose: Array, time_s: float) -> Committed:
    """Hold a pose."""
    return Committed(
        np.array([time_s]), np.array(pose)[None], np.zeros(1), np.zeros(1), np.zeros(1), None, float("nan")
    )


def piece_and_brake(
    path: TimedPath,
    start_s: float,
    progress_s: float,
    rate: float,
    target: float,
    captured_s: float,
    settings: OnlineSettings,
) -> Committed:
    """Follow a path for one cycle toward the rate ``target``, then brake along it to standstill.

    The rate changes by at most brake / v per second, where v is the largest speed of the path that the motion can
    reach, so that braking adds at most ``brake_mps2`` to the acceleration of the schedule. The path is not left.

    Args:
        start_s: when the piece begins, on the control's clock.
        progress_s, rate: path time and rate there.
        target: rate to approach, in [0, 1].
    """
    step, cycle = settings.sample_s, settings.cycle_s
    path_end_s = path.trajectory.duration_s
    # a first window bounds the speed by that of the whole path; the second is as long as the motion at that speed
    v_all = max(path.peak_mps(0.0, path_end_s), 1e-6)
    v_peak = max(path.peak_mps(progress_s, progress_s + cycle + v_all / settings.brake_mps2), 1e-6)
    slope = min(settings.brake_mps2 / v_peak, 1.0 / step)
    n_piece = max(2, round(cycle / step))
    step = cycle / n_piece
    since = np.arange(n_piece + 1) * step
    change = np.clip(target - rate, -slope * since, slope * since)
    piece = rate + change
    n_brake = int(np.ceil(piece[-1] / (slope * step) - 1e-9))
    n_brake = max(n_brake, int(piece[-1] > 0))
    brake = np.maximum(piece[-1] - slope * step * np.arange(1, n_brake + 1), 0.0)
    brake[-1:] = 0.0
    rates = np.concatenate([piece, brake])
    progress = progress_s + np.append(0.0, np.cumsum((rates[:-1] + rates[1:]) / 2 * step))
    at_end = progress >= path_end_s
    progress = np.minimum(progress, path_end_s)
    rates = np.where(at_end, 0.0, rates)
    poses, _ = path.at(progress)
    moved = np.diff(poses, axis=0)
    speed = (np.linalg.norm(moved[:, :3], axis=1) + path.rho_max_m * np.abs(moved[:, 3])) / step
    # the reference is straight between samples; a sample has the larger speed of both sides, and the last one rests
    speeds = np.append(np.maximum(np.append(0.0, speed[:-1]), speed), 0.0)
    time_s = np.asarray(start_s + step * np.arange(len(rates)), np.float64)
    return Committed(time_s, poses, speeds, progress, rates, path, captured_s)
