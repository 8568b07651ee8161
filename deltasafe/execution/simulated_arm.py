"""A simulated arm under torque control at 1 kHz.

Joint ranges, speeds and torques are those of the data sheet (decision 26) or of the arm's URDF file. The torque at a
link differs from the commanded one as on an arm whose torque sensors compensate most of the friction, but not all:
``JointFriction``.
"""

from typing import Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics, JointLimits
from deltasafe.execution.arm_models import ArmModel, ArmSettings, InverseKinematics, JointFriction
from deltasafe.execution.chain_kinematics import ChainKinematics
from deltasafe.execution.dynamics import forward_kinematics, rigid_body_dynamics
from deltasafe.execution.workcell import Workcell
from deltasafe.execution.world import World

Array = NDArray[np.float64]


class SimulatedArm:
    """An ``Arm`` in a new PyBullet world, so that a run is a function of its seed.

    Args:
        cell: tool, hand and table.
        seed: draws friction and torque sensor gains.
        arm: which arm; None: the iiwa 14.
        friction: distribution of the joint friction; None: that of the arm.

    Raises:
        DataError: the arm's URDF file is unusable.
        SettingsError: the settings do not fit the number of its joints.
    """

    control_period_s = 1e-3

    def __init__(
        self,
        cell: Workcell,
        seed: int = 0,
        arm: ArmSettings | None = None,
        friction: JointFriction | None = None,
    ) -> None:
        chosen = ArmModel.of(arm or ArmSettings())
        self._world = World(cell, chosen)
        try:
            self.kinematics = _kinematics(cell, chosen, self._world)
            self._draw_friction(friction or chosen.friction or JointFriction.of(self.limits), seed)
        except BaseException:
            self._world.close()
            raise
        self._model = self._world.model
        self._bullet, self._client, self._arm = self._world.bullet, self._world.client, self._world.arm
        self._links = self._world.link_surfaces()
        self._torque_limit_nm = np.array(self.limits.torque_nm)
        self._braked = False
        self._configure()

    @property
    def limits(self) -> JointLimits:
        return self._world.limits

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
        joints = self._bullet.getJointStates(self._arm, self._world.joints, physicsClientId=self._client)
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
            self._arm, self._world.joints, p.TORQUE_CONTROL, forces=torques.tolist(), physicsClientId=client
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

    def _draw_friction(self, friction: JointFriction, seed: int) -> None:
        count = len(self._world.joints)
        if len(friction.coulomb_nm) != count:
            raise SettingsError(f"friction must have values for {count} joints, got {len(friction.coulomb_nm)}")
        rng = np.random.default_rng(seed)
        factors = 1 + friction.variation * rng.uniform(-1, 1, size=(2, count))
        self._coulomb_nm = np.array(friction.coulomb_nm) * factors[0]
        self._viscous_nms = np.array(friction.viscous_nms) * factors[1]
        self._gain = 1 + friction.torque_gain_sd * rng.standard_normal(count)

    def _configure(self) -> None:
        p, client = self._bullet, self._client
        p.setTimeStep(self.control_period_s, physicsClientId=client)
        p.setPhysicsEngineParameter(deterministicOverlappingPairs=1, physicsClientId=client)
        p.changeDynamics(self._arm, -1, linearDamping=0.0, angularDamping=0.0, physicsClientId=client)
        for joint, damping in zip(self._world.joints, self._viscous_nms, strict=True):
            p.changeDynamics(self._arm, joint, jointDamping=float(damping), physicsClientId=client)
        self._hold_joints(self._coulomb_nm)

    def _hold_joints(self, torques_nm: Array) -> None:
        """Apply dry friction or brakes: PyBullet's velocity motor, target 0, with a torque limit; solved implicitly."""
        p = self._bullet
        for joint, torque_nm in zip(self._world.joints, torques_nm, strict=True):
            p.setJointMotorControl2(
                self._arm,
                joint,
                p.VELOCITY_CONTROL,
                targetVelocity=0.0,
                force=float(torque_nm),
                physicsClientId=self._client,
            )


def _kinematics(cell: Workcell, arm: ArmModel, world: World) -> InverseKinematics:
    if arm.closed_form is not None:
        return arm.closed_form(world.mount, cell.body.shaft_length_m, cell.body.is_symmetric)
    return ChainKinematics(world.model, world.limits, arm.rest_rad, cell.body.is_symmetric)
