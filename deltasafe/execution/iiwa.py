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
from collections.abc import Iterator
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmState, Dynamics
from deltasafe.execution.kinematics import IIWA14_LIMITS, ArmMount, IiwaKinematics, JointLimits
from deltasafe.planning.body import ToolBody

__all__ = ["IiwaArm", "JointFriction", "World"]

Array = NDArray[np.float64]

JOINTS = tuple(range(7))
TOOL_LINK = 7
FLANGE_IN_LINK_7_M = 0.045
MARGIN_M = 1e-4
TOOL_DENSITY_KGPM3 = 1200.0  # printed plastic
SKIN_RGBA = (0.85, 0.62, 0.50, 1.0)
TABLE_RGBA = (0.72, 0.70, 0.66, 1.0)
PEDESTAL_RGBA = (0.35, 0.37, 0.40, 1.0)
TOOL_RGBA = (0.05, 0.50, 0.42, 1.0)
LINK_RGBA = (0.82, 0.83, 0.85, 1.0)


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
    """

    def __init__(
        self,
        body: ToolBody,
        mount: ArmMount,
        table_z_m: float = 0.0,
        mesh: tuple[NDArray[Any], NDArray[Any]] | None = None,
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
                self._build(meshes, body, mount, table_z_m, mesh)
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
    ) -> None:
        p, client = self.bullet, self.client
        p.setGravity(0, 0, -9.81, physicsClientId=client)
        with tempfile.TemporaryDirectory(prefix="deltasafe-iiwa-") as folder:
            urdf = _write_urdf(pathlib.Path(folder), kuka, body)
            self.arm = p.loadURDF(
                str(urdf),
                (mount.base_x_m, mount.base_y_m, mount.base_z_m),
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

    def _box(self, centre: tuple[float, ...], half: tuple[float, ...], rgba: tuple[float, ...]) -> int:
        p, client = self.bullet, self.client
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
        visual = p.createVisualShape(p.GEOM_BOX, halfExtents=half, rgbaColor=rgba, physicsClientId=client)
        return int(p.createMultiBody(0, shape, visual, centre, physicsClientId=client))


class IiwaArm:
    """An ``Arm`` at 1 kHz torque control. A fresh world each time makes a run a function of its seed."""

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
    ) -> None:
        mount, friction = mount or ArmMount.beside(table_z_m), friction or JointFriction()
        self.kinematics = IiwaKinematics(mount, body.shaft_length_m)
        self._world = World(body, mount, table_z_m, mesh)
        self._bullet, self._client, self._arm = self._world.bullet, self._world.client, self._world.arm
        rng = np.random.default_rng(seed)
        spread = 1 + friction.variation * rng.uniform(-1, 1, size=(2, len(JOINTS)))
        self._coulomb_nm = np.array(friction.coulomb_nm) * spread[0]
        self._viscous_nms = np.array(friction.viscous_nms) * spread[1]
        self._gain = 1 + friction.torque_gain_sd * rng.standard_normal(len(JOINTS))
        self._links = _link_surfaces(self._bullet, self._client, self._arm)
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

    def state(self) -> ArmState:
        joints = self._bullet.getJointStates(self._arm, JOINTS, physicsClientId=self._client)
        tool = self._bullet.getLinkState(self._arm, TOOL_LINK, computeForwardKinematics=1, physicsClientId=self._client)
        return ArmState(
            np.array([joint[0] for joint in joints]),
            np.array([joint[1] for joint in joints]),
            np.array(tool[4]),
            np.array(tool[5]),
        )

    def dynamics(self, state: ArmState) -> Dynamics:
        q, q_dot = state.joint_positions_rad, state.joint_velocities_radps
        positions = q.tolist()
        mass = self._bullet.calculateMassMatrix(self._arm, positions, physicsClientId=self._client)
        bias = self._bullet.calculateInverseDynamics(
            self._arm, positions, q_dot.tolist(), [0.0] * len(JOINTS), physicsClientId=self._client
        )
        jacobian, drift = self.kinematics.differential(q, q_dot)
        return Dynamics(np.array(mass), np.array(bias), jacobian, drift)

    def step(self, torques_nm: Array) -> int:
        limit = np.array(self.limits.torque_nm)
        torques = self._gain * np.clip(torques_nm, -limit, limit)
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
            # PyBullet's velocity motor at target 0 with a small force is dry friction, solved implicitly
            p.setJointMotorControl2(
                self._arm,
                joint,
                p.VELOCITY_CONTROL,
                targetVelocity=0.0,
                force=float(self._coulomb_nm[joint]),
                physicsClientId=client,
            )


def _write_urdf(folder: pathlib.Path, kuka: pathlib.Path, body: ToolBody) -> pathlib.Path:
    """PyBullet's iiwa with real limits, absolute meshes and the tool as an eighth link."""
    tree = ET.parse(kuka / "model.urdf")
    robot = tree.getroot()
    for mesh in robot.iter("mesh"):
        mesh.set("filename", str(kuka / str(mesh.get("filename"))))
    for colour in robot.findall("material[@name='Blue']/color"):
        colour.set("rgba", " ".join(map(str, LINK_RGBA)))
    for index, joint in enumerate(robot.findall("joint")):
        limit = joint.find("limit")
        assert limit is not None
        reach = IIWA14_LIMITS.position_rad[index]
        limit.set("lower", repr(-reach))
        limit.set("upper", repr(reach))
        limit.set("effort", repr(IIWA14_LIMITS.torque_nm[index]))
        limit.set("velocity", repr(IIWA14_LIMITS.velocity_radps[index]))
    disc = folder / "disc.obj"
    disc.write_text(_elliptic_cylinder(body), encoding="utf-8")
    half = body.thickness_m / 2
    shaft_m = body.shaft_length_m - half
    shaft_kg = TOOL_DENSITY_KGPM3 * math.pi * body.shaft_radius_m**2 * shaft_m
    disc_kg = TOOL_DENSITY_KGPM3 * math.pi * body.semi_axis_x_m * body.semi_axis_y_m * body.thickness_m
    mass = shaft_kg + disc_kg
    height = shaft_kg * (half + shaft_m / 2) / mass
    across = (
        shaft_kg * (shaft_m**2 / 12 + (half + shaft_m / 2 - height) ** 2)
        + disc_kg * height**2
        + disc_kg * body.rho_max_m**2 / 4
    )
    about = (shaft_kg * body.shaft_radius_m**2) / 2 + disc_kg * (body.semi_axis_x_m**2 + body.semi_axis_y_m**2) / 4
    shapes = ""
    for kind in ("visual", "collision"):
        paint = f'<material name="Tool"><color rgba="{" ".join(map(str, TOOL_RGBA))}"/></material>'
        paint = paint if kind == "visual" else ""
        shapes += (
            f'<{kind}><geometry><mesh filename="{disc}"/></geometry>{paint}</{kind}>'
            f'<{kind}><origin xyz="0 0 {half + shaft_m / 2!r}"/><geometry>'
            f'<cylinder radius="{body.shaft_radius_m!r}" length="{shaft_m!r}"/></geometry>{paint}</{kind}>'
        )
    robot.append(
        ET.fromstring(
            f'<link name="tool"><inertial><origin xyz="0 0 {height!r}"/><mass value="{mass!r}"/>'
            f'<inertia ixx="{across!r}" iyy="{across!r}" izz="{about!r}" ixy="0" ixz="0" iyz="0"/></inertial>'
            f"{shapes}</link>"
        )
    )
    robot.append(
        ET.fromstring(
            '<joint name="tool_mount" type="fixed"><parent link="lbr_iiwa_link_7"/><child link="tool"/>'
            f'<origin xyz="0 0 {FLANGE_IN_LINK_7_M + body.shaft_length_m!r}" rpy="{math.pi!r} 0 0"/></joint>'
        )
    )
    path = folder / "iiwa14.urdf"
    tree.write(path)
    return path


def _elliptic_cylinder(body: ToolBody, corners: int = 64) -> str:
    """Wavefront text of the disc: a convex prism inscribed in the elliptic cylinder."""
    angles = 2 * np.pi * np.arange(corners) / corners
    rim = np.stack([body.semi_axis_x_m * np.cos(angles), body.semi_axis_y_m * np.sin(angles)], axis=1)
    lines = [f"v {x:.9f} {y:.9f} {z:.9f}" for z in (-body.thickness_m / 2, body.thickness_m / 2) for x, y in rim]
    for i in range(1, corners + 1):
        j = i % corners + 1
        lines += [f"f {i} {j} {j + corners}", f"f {i} {j + corners} {i + corners}"]
    for i in range(2, corners):
        lines += [f"f 1 {i + 1} {i}", f"f {corners + 1} {corners + i} {corners + i + 1}"]
    return "\n".join(lines) + "\n"


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
