"""Inverse kinematics of any chain of six or more revolute joints, by Newton steps along the path.

Of all joint positions that reach a pose, those nearest to the posture of rest are taken, each joint measured in halves
of its range. They are a function of the pose, so a path that returns to a pose returns to the joint positions. Each
step solves the linearized problem in closed form (sequential quadratic programming with the metric as Hessian). The
path is followed in small steps, so that the solution cannot jump to another branch unnoticed.
"""

import math

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import compiled
from deltasafe.errors import PlanningError, SettingsError
from deltasafe.execution.arm import JointLimits
from deltasafe.execution.chain_model import ChainModel
from deltasafe.execution.dynamics import tool_jacobian
from deltasafe.execution.impedance import pose_error
from deltasafe.geometry import as_rows

Array = NDArray[np.float64]

MIN_JOINTS = 6
_STEP_M, _STEP_RAD = 0.004, 0.02
"""Largest motion of the tool between two solutions; longer ones of a path are divided."""
_MAX_JOINT_STEP_RAD = 0.15
"""Larger joint steps during such a motion mean a singularity or another branch."""
_EXACT, _SETTLED = 1e-9, 1e-7
"""Largest remaining error of a pose in m and rad, and largest last step of a joint in rad."""
_FIRST_STEP_RAD = 0.3
_ITERATIONS, _FULL_STEPS = 200, 15
"""Largest number of steps; after the first ones, steps toward rest are shortened: full ones may overshoot forever."""


class ChainKinematics:
    """Inverse kinematics of a ``ChainModel`` whose last frame is that of the tool, as in ``IiwaKinematics``.

    Args:
        rest_rad: posture that the arm stays near; empty for the middle of each range.
        is_symmetric: the tool may be held turned by half a turn.

    Raises:
        SettingsError: the chain has fewer than six joints, or ``rest_rad`` does not lie within its limits.
    """

    def __init__(
        self, model: ChainModel, limits: JointLimits, rest_rad: tuple[float, ...] = (), is_symmetric: bool = True
    ) -> None:
        count, self._model, self.limits = len(model.axes), model, limits
        self._lower, self._upper = np.array(limits.lower_rad), np.array(limits.upper_rad)
        if count < MIN_JOINTS:
            raise SettingsError(f"the arm has {count} joints; a pose of the tool needs at least {MIN_JOINTS}")
        self._half = (self._upper - self._lower) / 2
        self._rest = np.array(rest_rad) if rest_rad else self._lower + self._half
        if len(self._rest) != count or not ((self._rest >= self._lower) & (self._rest <= self._upper)).all():
            raise SettingsError(f"rest_rad must hold {count} angles within the limits of the joints, got {rest_rad}")
        self._turns_rad = (0.0, math.pi) if is_symmetric else (0.0,)

    def inverse(self, poses: Array) -> Array:
        """Return joint positions (N, n), continuous along the path, for tool poses (N, 4) with a vertical shaft.

        A symmetric tool is held in that of two ways that keeps the larger distance to a joint limit. The error of each
        pose is at most 1e-9 m and rad.

        Raises:
            PlanningError: a pose is out of reach or near a singularity, or a joint limit is exceeded; names the pose.
            SettingsError: a pose is not finite, or farther than 1000 m or 1000 rad from 0.
        """
        poses = as_rows(poses, 4, "poses")
        tried = [self._follow(np.add(poses, [0.0, 0.0, 0.0, turn_rad])) for turn_rad in self._turns_rad]
        paths = [joints for joints, failed in tried if failed < 0]
        if not paths:
            pose = poses[max(failed for _, failed in tried)]
            raise PlanningError(
                f"the arm cannot take the pose {_text(pose)}: it is out of reach or near a singularity of the arm; "
                "move the path or the base of the arm"
            )
        margins = [np.minimum(joints - self._lower, self._upper - joints) / self._half for joints in paths]
        best = int(np.argmax([margin.min() for margin in margins]))
        if margins[best].min() < 0:
            sample, joint = np.unravel_index(np.argmin(margins[best]), margins[best].shape)
            low, high = np.degrees([self._lower[joint], self._upper[joint]])
            raise PlanningError(
                f"the arm cannot take the pose {_text(poses[sample])}: joint {joint + 1} would need "
                f"{math.degrees(paths[best][sample, joint]):.0f} degrees, its limits are {low:.0f} and {high:.0f}; "
                "shorten the turn of the path or move the base of the arm"
            )
        return paths[best]

    def _follow(self, poses: Array) -> tuple[Array, int]:
        try:
            joints, failed = _follow(self._model, poses, self._rest, self._half**2)
        except np.linalg.LinAlgError:
            return poses, 0
        return joints, int(failed)


@compiled
def _follow(model, poses, rest, weights):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return joint positions (N, n), and the index of the first pose that has none, or -1."""
    joints = np.empty((len(poses), len(rest)))
    now, velocity = rest.copy(), np.zeros(len(rest))
    if not _solve(model, poses[0], now, rest, weights, _FIRST_STEP_RAD):
        return joints, 0
    joints[0] = now
    for index in range(1, len(poses)):
        change = poses[index] - poses[index - 1]
        length_m = math.sqrt(change[0] ** 2 + change[1] ** 2 + change[2] ** 2)
        count = max(1, math.ceil(max(length_m / _STEP_M, abs(change[3]) / _STEP_RAD)))
        for step in range(1, count + 1):
            before = now.copy()
            if count == 1:
                now += velocity
            if not _solve(model, poses[index - 1] + step / count * change, now, rest, weights, _MAX_JOINT_STEP_RAD):
                return joints, index
            if np.abs(now - before).max() > _MAX_JOINT_STEP_RAD:
                return joints, index
            velocity = now - before
        joints[index] = now
    return joints, -1


@compiled
def _solve(model, pose, joints, rest, weights, largest_rad):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Move ``joints`` to the solution of a pose (4,); return whether it was found."""
    quaternion = np.array([0.0, 0.0, math.sin(pose[3] / 2), math.cos(pose[3] / 2)])
    for iteration in range(_ITERATIONS):
        at, turned, jacobian = tool_jacobian(model, joints)
        error = pose_error(pose[:3], quaternion, at, turned)
        back = (1.0 if iteration < _FULL_STEPS else 0.25) * (rest - joints)
        scaled = jacobian * weights
        dual = np.linalg.solve(scaled @ jacobian.T, error - jacobian @ back)
        step = back + scaled.T @ dual
        largest = np.abs(step).max()
        if np.abs(error).max() <= _EXACT and largest <= _SETTLED:
            return True
        if not largest < 1e6:  # true for NaN
            return False
        joints += step * min(1.0, largest_rad / largest)
    return False


def _text(pose: Array) -> str:
    return f"({pose[0]:.3f}, {pose[1]:.3f}, {pose[2]:.3f}) m, yaw {pose[3]:.2f} rad"
