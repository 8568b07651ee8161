"""An in-memory fake arm for tests of the controller and the monitor."""

import numpy as np

from deltasafe.execution.arm import ArmState, Dynamics, JointLimits


class FloatingTool:
    """The tool as a free unit mass without gravity or friction: x, y, z and yaw move.

    Its six "joints" are x, y, z [m] and three angles [rad], of which only the last one (yaw) may move.
    """

    def __init__(self, control_period_s=1e-3, drag_ns_per_m=0.0):
        self.control_period_s = control_period_s
        self.limits = JointLimits((-10.0,) * 6, (10.0,) * 6, (10.0,) * 6, (100.0,) * 6)
        self._drag = drag_ns_per_m
        self._q, self._q_dot = np.zeros(6), np.zeros(6)
        self._braked = False

    def __enter__(self):
        return self

    def __exit__(self, *exception):
        return None

    def inverse(self, poses):
        return np.insert(np.asarray(poses, dtype=np.float64), [3, 3], 0.0, axis=1)

    def reset(self, joint_positions_rad):
        self._q, self._q_dot = np.array(joint_positions_rad, dtype=np.float64), np.zeros(6)
        self._braked = False

    def state(self):
        half = self._q[5] / 2
        quaternion = np.array([0.0, 0.0, np.sin(half), np.cos(half)])
        return ArmState(self._q.copy(), self._q_dot.copy(), self._q[:3].copy(), quaternion)

    def dynamics(self, state):
        return Dynamics(np.eye(6), np.zeros(6), np.eye(6), np.zeros(6))

    def step(self, torques_nm):
        acceleration = np.asarray(torques_nm) - self._drag * self._q_dot
        acceleration[3:5] = 0.0
        if self._braked:
            acceleration = -self._q_dot / self.control_period_s
        self._q_dot = self._q_dot + self.control_period_s * acceleration
        self._q = self._q + self.control_period_s * self._q_dot
        return 0

    def brake(self):
        self._braked = True

    def link_points_m(self):
        return np.zeros((0, 3))
