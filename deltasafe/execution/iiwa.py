"""The KUKA LBR iiwa 14 in PyBullet, with the planner's own tool at its flange. The only importer of pybullet.

Where it stands. Of base heights 0 to 0.3 m, distances 0.45 to 0.75 m behind the working area (hands come from the
other side) and arm angles -90 to 90 degrees, the mount of ``ArmMount``'s defaults has the largest product of the
smallest manipulability and the smallest relative margin to a joint limit, over tool poses with |x| <= 0.17,
|y| <= 0.12, z 0.02 to 0.2 m and any yaw: 0.085 and 17 % (of joint 4). Its elbow is up and, with the tool at start or
goal, the links stay out of the camera's view.

What is real. Joint ranges, speeds and torques are the data sheet's (decision 26). The torque that reaches the links
differs from the command as on an arm whose torque sensors compensate most, not all, of the friction: ``JointFriction``.

The camera hangs where the wrist passes, as any camera does that looks straight down on a tool under an arm: it
has taken its picture before the arm moves, and is no obstacle here.
"""

import contextlib
import dataclasses
import math
import os
import pathlib
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics
from deltasafe.execution.disturbances import Disturbance, Payload, Push
from deltasafe.execution.dynamics import ChainModel, forward_kinematics, rigid_body
from deltasafe.execution.iiwa_urdf import add_payload, iiwa_with_tool
from deltasafe.execution.kinematics import IIWA14_LIMITS, ArmMount, IiwaKinematics, JointLimits
from deltasafe.planning.body import ToolBody

__all__ = ["IiwaArm", "JointFriction", "World"]

Array = NDArray[np.float64]

JOINTS = tuple(range(7))
TOOL_LINK = 7
MARGIN_M = 1e-4
GRAVITY_MPS2 = (0.0, 0.0, -9.81)
SKIN_RGBA = (0.85, 0.62, 0.50, 1.0)
TABLE_RGBA = (0.72, 0.70, 0.66, 1.0)
PEDESTAL_RGBA = (0.35, 0.37, 0.40, 1.0)


@dataclasses.dataclass(frozen=True)
class JointFriction:
    """What the drive leaves uncompensated, drawn anew for each seed.

    Attributes:
        coulomb_nm: (7) dry friction of each joint that the torque sensors' loop leaves over: about 0.1 % of
            the rated torque, so small that the arm holds 0.5 mm at 0.01 m/s, as the paper says that the real one did.
        viscous_nms: (7) damping of each joint in N m s/rad.
        variation: relative spread (uniform, +-) of both from one seed to the next.
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


class World:
    """A physics client of its own with arm, tool, table and, if there is one, the hand. Closed on exit.

    Args:
        body: the tool.
        mount: where the arm stands.
        table_z_m: height of the table.
        mesh: the hand's (vertices_m (V, 3), triangles (F, 3)) or None.
        payload_kg: a mass at the flange that ``model`` does not know of.

    Attributes:
        model: the arm with its tool, as its controller knows it.
    """

    def __init__(
        self,
        body: ToolBody,
        mount: ArmMount,
        table_z_m: float = 0.0,
        mesh: tuple[NDArray[Any], NDArray[Any]] | None = None,
        payload_kg: float = 0.0,
    ) -> None:
        with _quiet():
            import pybullet
            import pybullet_data

            self.bullet = pybullet
            self.client = pybullet.connect(pybullet.DIRECT)
            if self.client < 0:
                raise RuntimeError("PyBullet offers no further physics client: close arms that are not in use")
            try:
                meshes = pathlib.Path(pybullet_data.getDataPath()) / "kuka_iiwa"
                self._build(meshes, body, mount, table_z_m, mesh, payload_kg)
            except BaseException:
                pybullet.disconnect(self.client)
                raise

    def close(self) -> None:
        """Free the physics client; a second call does nothing."""
        if self.client >= 0:
            self.bullet.disconnect(self.client)
            self.client = -1

    def place(self, joint_positions_rad: Array) -> None:
        """Move the arm to a posture, at rest."""
        for joint in JOINTS:
            self.bullet.resetJointState(
                self.arm, joint, float(joint_positions_rad[joint]), 0.0, physicsClientId=self.client
            )

    def _build(
        self,
        kuka: pathlib.Path,
        body: ToolBody,
        mount: ArmMount,
        table_z_m: float,
        mesh: tuple[NDArray[Any], NDArray[Any]] | None,
        payload_kg: float,
    ) -> None:
        p, client = self.bullet, self.client
        p.setGravity(*GRAVITY_MPS2, physicsClientId=client)
        base_m = np.array([mount.base_x_m, mount.base_y_m, mount.base_z_m])
        with tempfile.TemporaryDirectory(prefix="deltasafe-iiwa-") as folder:
            robot = iiwa_with_tool(pathlib.Path(folder), kuka, body)
            self.model = ChainModel.from_urdf(robot, _yaw_matrix(mount.base_yaw_rad), base_m, GRAVITY_MPS2)
            if payload_kg > 0:
                add_payload(robot, payload_kg)
            urdf = pathlib.Path(folder) / "iiwa14.urdf"
            ET.ElementTree(robot).write(urdf)
            self.arm = p.loadURDF(
                str(urdf),
                base_m.tolist(),
                p.getQuaternionFromEuler((0, 0, mount.base_yaw_rad)),
                useFixedBase=True,
                flags=p.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=client,
            )
        self.table = self._box((0.0, -0.15, table_z_m - 0.02), (0.6, 0.55, 0.02), TABLE_RGBA)
        height = mount.base_z_m - table_z_m + 0.04
        self.pedestal = self._box(
            (mount.base_x_m, mount.base_y_m, mount.base_z_m - height / 2), (0.14, 0.14, height / 2), PEDESTAL_RGBA
        )
        p.setCollisionFilterPair(self.arm, self.pedestal, -1, -1, 0, physicsClientId=client)
        self.hand: int | None = None
        if mesh is not None:
            vertices = np.asarray(mesh[0], dtype=np.float64).tolist()
            indices = np.asarray(mesh[1]).ravel().tolist()
            shape = p.createCollisionShape(
                p.GEOM_MESH,
                vertices=vertices,
                indices=indices,
                flags=p.GEOM_FORCE_CONCAVE_TRIMESH,
                physicsClientId=client,
            )
            visual = p.createVisualShape(
                p.GEOM_MESH,
                vertices=vertices,
                indices=indices,
                normals=_normals(np.asarray(mesh[0], dtype=np.float64), np.asarray(mesh[1])).tolist(),
                rgbaColor=SKIN_RGBA,
                physicsClientId=client,
            )
            self.hand = p.createMultiBody(0, shape, visual, physicsClientId=client)
            # PyBullet pads hand and tool by 1 mm each; only the tool's pad stays, so that a touch counts 1 mm early
            p.changeDynamics(self.hand, -1, collisionMargin=MARGIN_M, physicsClientId=client)

    def _box(self, center: tuple[float, ...], half: tuple[float, ...], rgba: tuple[float, ...]) -> int:
        p, client = self.bullet, self.client
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
        visual = p.createVisualShape(p.GEOM_BOX, halfExtents=half, rgbaColor=rgba, physicsClientId=client)
        return int(p.createMultiBody(0, shape, visual, center, physicsClientId=client))


class IiwaArm:
    """An ``Arm`` at 1 kHz torque control. A fresh world each time makes a run a function of its seed.

    Args:
        body, mesh, table_z_m: of the world.
        mount: where the arm stands, beside the table if None.
        friction: of its joints; each seed draws its own.
        disturbances: what happens to the arm without its controller's knowledge; times count from the last reset.
    """

    control_period_s = 1e-3

    def __init__(
        self,
        body: ToolBody,
        mesh: tuple[NDArray[Any], NDArray[Any]] | None = None,
        *,
        mount: ArmMount | None = None,
        friction: JointFriction | None = None,
        table_z_m: float = 0.0,
        seed: int = 0,
        disturbances: Sequence[Disturbance] = (),
    ) -> None:
        mount, friction = mount or ArmMount.beside(table_z_m), friction or JointFriction()
        self.kinematics = IiwaKinematics(mount, body.shaft_length_m)
        self._pushes = [each for each in disturbances if isinstance(each, Push)]
        payload_kg = sum(each.mass_kg for each in disturbances if isinstance(each, Payload))
        self._world = World(body, mount, table_z_m, mesh, payload_kg)
        self._model = self._world.model
        self._bullet, self._client, self._arm = self._world.bullet, self._world.client, self._world.arm
        rng = np.random.default_rng(seed)
        spread = 1 + friction.variation * rng.uniform(-1, 1, size=(2, len(JOINTS)))
        self._coulomb_nm = np.array(friction.coulomb_nm) * spread[0]
        self._viscous_nms = np.array(friction.viscous_nms) * spread[1]
        self._gain = 1 + friction.torque_gain_sd * rng.standard_normal(len(JOINTS))
        self._links = _link_surfaces(self._bullet, self._client, self._arm)
        self._torque_limit_nm = np.array(self.limits.torque_nm)
        self._steps, self._braked = 0, False
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
        self._steps = 0
        if self._braked:
            self._hold_joints(self._coulomb_nm)
            self._braked = False

    def state(self) -> ArmState:
        joints = self._bullet.getJointStates(self._arm, JOINTS, physicsClientId=self._client)
        q = np.array([joint[0] for joint in joints])
        return ArmState(q, np.array([joint[1] for joint in joints]), *forward_kinematics(self._model, q))

    def dynamics(self, state: ArmState) -> Dynamics:
        return Dynamics(*rigid_body(self._model, state.joint_positions_rad, state.joint_velocities_radps))

    def step(self, torques_nm: Array) -> int:
        limit = self._torque_limit_nm
        torques = self._gain * np.minimum(np.maximum(torques_nm, -limit), limit)
        if self._braked:
            torques = np.zeros_like(torques)
        p, client = self._bullet, self._client
        p.setJointMotorControlArray(
            self._arm, JOINTS, p.TORQUE_CONTROL, forces=torques.tolist(), physicsClientId=client
        )
        self._push(self._steps * self.control_period_s)
        p.stepSimulation(physicsClientId=client)
        self._steps += 1
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
        """PyBullet's velocity motor at target 0 is dry friction, or a brake, solved implicitly."""
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

    def _push(self, time_s: float) -> None:
        for push in self._pushes:
            if push.start_s <= time_s < push.start_s + push.duration_s:
                p = self._bullet
                center = p.getLinkState(self._arm, push.link - 1, physicsClientId=self._client)[0]
                p.applyExternalForce(
                    self._arm, push.link - 1, push.force_n, center, p.WORLD_FRAME, physicsClientId=self._client
                )


def _yaw_matrix(angle_rad: float) -> Array:
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def _normals(vertices: Array, triangles: NDArray[Any]) -> Array:
    """(V, 3) unit normals, each triangle weighted by its area."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], np.cross(b - a, c - a))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


def _link_surfaces(bullet: Any, client: int, arm: int) -> dict[int, Array]:
    """Vertices of the links' meshes, thinned to one per 8 mm cell: link index -> (P, 3) in the link's frame."""
    surfaces = {}
    for link in range(1, TOOL_LINK):
        _, vertices = bullet.getMeshData(arm, link, physicsClientId=client)
        points = np.array(vertices)
        _, first = np.unique(np.floor(points / 0.008), axis=0, return_index=True)
        surfaces[link] = points[np.sort(first)]
    return surfaces


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """PyBullet's C code writes to file descriptors 1 and 2 on import, connection and load; nobody asked."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    kept = [os.dup(1), os.dup(2)]
    try:
        with pathlib.Path(os.devnull).open("w", encoding="utf-8") as sink:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        for number, handle in enumerate(kept, start=1):
            os.dup2(handle, number)
            os.close(handle)
