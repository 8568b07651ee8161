"""The simulated LBR iiwa 14 under torque control at 1 kHz.

Joint ranges, speeds and torques are those of the data sheet (decision 26). The torque at a link differs from the
commanded one as on an arm whose torque sensors compensate most of the friction, but not all: ``JointFriction``.
"""

import dataclasses
import math
from typing import Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics
from deltasafe.execution.dynamics import forward_kinematics, rigid_body_dynamics
from deltasafe.execution.iiwa import JOINTS, World
from deltasafe.execution.kinematics import IIWA14_LIMITS, ArmMount, IiwaKinematics, JointLimits
from deltasafe.execution.workcell import Workcell

Array = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class JointFriction:
    """Friction that the drives do not compensate. Each seed draws its own values.

    Attributes:
        coulomb_nm: (7) residual dry friction of each joint, about 0.1 % of the rated torque: with it the arm tracks
            within 0.5 mm at 0.01 m/s, as the paper reports for the real one.
        viscous_nms: (7) damping of each joint in N m s/rad.
        variation: relative variation (uniform, +-) of both between seeds.
        torque_gain_sd: standard deviation of each torque sensor's gain about 1.
    """

    coulomb_nm: tuple[float, ...] = (0.2, 0.2, 0.12, 0.12, 0.08, 0.04, 0.04)
    viscous_nms: tuple[float, ...] = (0.5, 0.5, 0.3, 0.3, 0.2, 0.1, 0.1)
    variation: float = 0.3
    torque_gain_sd: float = 0.003

    def __post_init__(self) -> None:
        for name in ("coulomb_nm", "viscous_nms"):
            values = getattr(self, name)
            if len(values) != len(JOINTS) or not all(f >= 0 and math.isfinite(f) for f in values):
                raise SettingsError(f"{name} must hold seven finite values >= 0, got {values}")
        if not 0 <= self.variation < 1:
            raise SettingsError(f"variation must lie in [0, 1), got {self.variation}")
        if not 0 <= self.torque_gain_sd <= 0.1:
            raise SettingsError(f"torque_gain_sd must lie in [0, 0.1], got {self.torque_gain_sd}")


class IiwaArm:
    """An ``Arm`` in a new PyBullet world, so that a run is a function of its seed.

    Args:
        cell: tool, hand and table.
        seed: draws friction and torque sensor gains.
        friction: distribution of the joint friction.
    """

    control_period_s = 1e-3

    def __init__(self, cell: Workcell, seed: int = 0, friction: JointFriction | None = None) -> None:
        mount, friction = ArmMount.beside(cell.table_z_m), friction or JointFriction()
        self.kinematics = IiwaKinematics(mount, cell.body.shaft_length_m, cell.body.is_symmetric)
        self._world = World(cell, mount)
        self._model = self._world.model
        self._bullet, self._client, self._arm = self._world.bullet, self._world.client, self._world.arm
        rng = np.random.default_rng(seed)
        factors = 1 + friction.variation * rng.uniform(-1, 1, size=(2, len(JOINTS)))
        self._coulomb_nm = np.array(friction.coulomb_nm) * factors[0]
        self._viscous_nms = np.array(friction.viscous_nms) * factors[1]
        self._gain = 1 + friction.torque_gain_sd * rng.standard_normal(len(JOINTS))
        self._links = self._world.link_surfaces()
        self._torque_limit_nm = np.array(self.limits.torque_nm)
        self._braked = False
        self._configure()

    @property
    def limits(self) -> JointLimits:
        return IIWA14_LIMITS

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *exception: object) -> None:
        self._world.close()

    def inverse(self, poses: Array) -> Array:
        return self.kinematics.inverse(poses)

    def reset(self, joint_positions_rad: Array) -> None:
        self._world.place(joint_positions_rad)
        if self._braked:
            self._hold_joints(self._coulomb_nm)
            self._braked = False

    def state(self) -> ArmState:
        joints = self._bullet.getJointStates(self._arm, JOINTS, physicsClientId=self._client)
        q = np.array([joint[0] for joint in joints])
        return ArmState(q, np.array([joint[1] for joint in joints]), *forward_kinematics(self._model, q))

    def dynamics(self, state: ArmState) -> Dynamics:
        model: Dynamics = rigid_body_dynamics(self._model, state.joint_positions_rad, state.joint_velocities_radps)
        return model

    def step(self, torques_nm: Array) -> int:
        limit = self._torque_limit_nm
        torques = self._gain * np.minimum(np.maximum(torques_nm, -limit), limit)
        if self._braked:
            torques = np.zeros_like(torques)
        p, client = self._bullet, self._client
        p.setJointMotorControlArray(
            self._arm, JOINTS, p.TORQUE_CONTROL, forces=torques.tolist(), physicsClientId=client
        )
        p.stepSimulation(physicsClientId=client)
        contacts = 0
        for other in (self._world.hand, self._world.table):
            if other is not None:
                points = p.getContactPoints(self._arm, other, physicsClientId=client)
                contacts += sum(point[8] <= 0.0 for point in points)
        return contacts

    def brake(self) -> None:
        if not self._braked:
            self._hold_joints(self._torque_limit_nm)
            self._braked = True

    def link_points_m(self) -> Array:
        frames = self._bullet.getLinkStates(
            self._arm, list(self._links), computeForwardKinematics=1, physicsClientId=self._client
        )
        placed = []
        for points, frame in zip(self._links.values(), frames, strict=True):
            rotation = np.reshape(self._bullet.getMatrixFromQuaternion(frame[5]), (3, 3))
            placed.append(points @ rotation.T + frame[4])
        return np.concatenate(placed)

    def _configure(self) -> None:
        p, client = self._bullet, self._client
        p.setTimeStep(self.control_period_s, physicsClientId=client)
        p.setPhysicsEngineParameter(deterministicOverlappingPairs=1, physicsClientId=client)
        p.changeDynamics(self._arm, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
        for joint in JOINTS:
            p.changeDynamics(self._arm, joint, jointDamping=float(self._viscous_nms[joint]), physicsClientId=client)
        self._hold_joints(self._coulomb_nm)

    def _hold_joints(self, torques_nm: Array) -> None:
        """Apply dry friction or brakes: PyBullet's velocity motor, target 0, with a torque limit; solved implicitly."""
        p = self._bullet
        for joint in JOINTS:
            p.setJointMotorControl2(
                self._arm,
                joint,
                p.VELOCITY_CONTROL,
                targetVelocity=0.0,
                force=float(torques_nm[joint]),
                physicsClientId=self._client,
            )
