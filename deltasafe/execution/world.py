"""PyBullet world with an arm, the planner's tool, a table and a hand. The only importer of pybullet.

The mount of the iiwa was chosen among base heights of 0 to 0.3 m, distances of 0.45 to 0.75 m behind the working
area (hands come from the other side) and arm angles of -90 to 90 degrees. It has the largest product of smallest
manipulability (0.085) and smallest relative margin to a joint limit (17 %, joint 4) over all tool poses with
|x| <= 0.17 m, |y| <= 0.12 m, z from 0.02 to 0.2 m and any yaw. The elbow points up. With the tool at start or goal, no
link is in the camera's view.

The camera is not an obstacle, although the wrist passes through its place: it takes its image before the arm moves.
"""

import contextlib
import os
import pathlib
import sys
import tempfile
import xml.etree.ElementTree as ET
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError
from deltasafe.execution.arm import ArmMount, JointLimits
from deltasafe.execution.arm_models import ArmModel
from deltasafe.execution.arm_urdf import TOOL_LINK, add_tool, limits_of, read_chain
from deltasafe.execution.chain_model import ChainModel
from deltasafe.execution.workcell import Mesh, Workcell

Array = NDArray[np.float64]

MARGIN_M = 1e-4
GRAVITY_MPS2 = (0.0, 0.0, -9.81)
SKIN_RGBA = (0.85, 0.62, 0.50, 1.0)
TABLE_RGBA = (0.72, 0.70, 0.66, 1.0)
PEDESTAL_RGBA = (0.35, 0.37, 0.40, 1.0)
LINK_SPACING_M = 0.008


class World:
    """A PyBullet client with arm, tool, table and hand.

    Args:
        cell: tool, hand and table.
        arm: what the arm is.

    Raises:
        SettingsError: the hand's mesh is larger than PyBullet takes.
        DataError: the arm's URDF file is unusable.

    Attributes:
        bullet, client: the module pybullet and the number of its client.
        arm, table, hand: numbers of the bodies; ``hand`` is None without a hand.
        joints: numbers of the arm's joints; ``tool_link``: number of the tool's link.
        mount, limits: of the arm.
        model: arm and tool, as the controller models them.
    """

    def __init__(self, cell: Workcell, arm: ArmModel) -> None:
        self.mount = arm.mount.on_table(cell.table_z_m)
        with _without_output():
            import pybullet
            import pybullet_data

            self.bullet = pybullet
            self.client = pybullet.connect(pybullet.DIRECT)
            if self.client < 0:
                raise RuntimeError("PyBullet offers no further physics client: close arms that are not in use")
            try:
                pybullet.setGravity(*GRAVITY_MPS2, physicsClientId=self.client)
                self.model, self.limits, self.arm = self._load_arm(
                    pathlib.Path(pybullet_data.getDataPath()) / arm.urdf, cell, arm
                )
                self.joints, self.tool_link = self._find_links()
                self.table = self._add_table(cell, self.mount)
                self.hand = None if cell.mesh is None else self._add_hand(cell.mesh)
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
        for joint, position_rad in zip(self.joints, joint_positions_rad, strict=True):
            self.bullet.resetJointState(self.arm, joint, float(position_rad), 0.0, physicsClientId=self.client)

    def link_surfaces(self) -> dict[int, Array]:
        """Vertices of the links' meshes, one per cell of 8 mm: link number -> (P, 3) in the frame of the link."""
        surfaces = {}
        for link in range(1, self.tool_link):
            _, vertices = self.bullet.getMeshData(self.arm, link, physicsClientId=self.client)
            points = np.array(vertices).reshape(-1, 3)
            _, first = np.unique(np.floor(points / LINK_SPACING_M), axis=0, return_index=True)
            surfaces[link] = points[np.sort(first)]
        return surfaces

    def _load_arm(self, path: pathlib.Path, cell: Workcell, arm: ArmModel) -> tuple[ChainModel, JointLimits, int]:
        p, mount = self.bullet, self.mount
        robot = read_chain(path, arm.flange_link)
        limits = arm.limits or limits_of(path, robot)
        with tempfile.TemporaryDirectory(prefix="deltasafe-arm-") as folder:
            add_tool(robot, pathlib.Path(folder), arm, limits, cell.body)
            model = ChainModel.from_urdf(robot, mount.base_rotation, mount.base_m, GRAVITY_MPS2)
            urdf = pathlib.Path(folder) / "arm.urdf"
            ET.ElementTree(robot).write(urdf)
            number = p.loadURDF(
                str(urdf),
                mount.base_m.tolist(),
                p.getQuaternionFromEuler((0, 0, mount.base_yaw_rad)),
                useFixedBase=True,
                flags=p.URDF_USE_INERTIA_FROM_FILE,
                physicsClientId=self.client,
            )
        return model, limits, int(number)

    def _find_links(self) -> tuple[list[int], int]:
        p = self.bullet
        count = p.getNumJoints(self.arm, physicsClientId=self.client)
        found = [p.getJointInfo(self.arm, number, physicsClientId=self.client) for number in range(count)]
        tool = next(number for number, info in enumerate(found) if info[12].decode() == TOOL_LINK)
        return [number for number, info in enumerate(found) if info[2] == p.JOINT_REVOLUTE], tool

    def _add_table(self, cell: Workcell, mount: ArmMount) -> int:
        table = self._box((0.0, -0.15, cell.table_z_m - 0.02), (0.6, 0.55, 0.02), TABLE_RGBA)
        height = mount.base_z_m - cell.table_z_m + 0.04
        pedestal = self._box(
            (mount.base_x_m, mount.base_y_m, mount.base_z_m - height / 2), (0.14, 0.14, height / 2), PEDESTAL_RGBA
        )
        self.bullet.setCollisionFilterPair(self.arm, pedestal, -1, -1, 0, physicsClientId=self.client)
        return table

    def _add_hand(self, mesh: Mesh) -> int:
        p, client = self.bullet, self.client
        vertices, triangles = np.asarray(mesh[0], dtype=np.float64), np.asarray(mesh[1])
        geometry = {"vertices": vertices.tolist(), "indices": triangles.ravel().tolist()}
        try:
            shape = p.createCollisionShape(
                p.GEOM_MESH, flags=p.GEOM_FORCE_CONCAVE_TRIMESH, physicsClientId=client, **geometry
            )
            visual = p.createVisualShape(
                p.GEOM_MESH,
                normals=_normals(vertices, triangles).tolist(),
                rgbaColor=SKIN_RGBA,
                physicsClientId=client,
                **geometry,
            )
        except (SystemError, p.error) as error:
            raise SettingsError(
                f"PyBullet cannot hold the hand's mesh of {len(vertices)} vertices and {len(triangles)} triangles; "
                "simplify it (for example by quadric decimation)"
            ) from error
        hand = int(p.createMultiBody(0, shape, visual, physicsClientId=client))
        # PyBullet pads hand and tool by 1 mm each. Only the tool keeps its margin, so contacts count 1 mm early.
        p.changeDynamics(hand, -1, collisionMargin=MARGIN_M, physicsClientId=client)
        return hand

    def _box(self, center: tuple[float, ...], half: tuple[float, ...], rgba: tuple[float, ...]) -> int:
        p, client = self.bullet, self.client
        shape = p.createCollisionShape(p.GEOM_BOX, halfExtents=half, physicsClientId=client)
        visual = p.createVisualShape(p.GEOM_BOX, halfExtents=half, rgbaColor=rgba, physicsClientId=client)
        return int(p.createMultiBody(0, shape, visual, center, physicsClientId=client))


def _normals(vertices: Array, triangles: NDArray[Any]) -> Array:
    """(V, 3) unit normals, each triangle weighted by its area."""
    a, b, c = (vertices[triangles[:, corner]] for corner in range(3))
    normals = np.zeros_like(vertices)
    for corner in range(3):
        np.add.at(normals, triangles[:, corner], np.cross(b - a, c - a))
    return np.asarray(normals / np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300))


@contextlib.contextmanager
def _without_output() -> Iterator[None]:
    """Discard what PyBullet's C code writes to file descriptors 1 and 2 on import, connection and load."""
    for stream in (sys.stdout, sys.stderr):
        stream.flush()
    saved = [os.dup(1), os.dup(2)]
    try:
        with pathlib.Path(os.devnull).open("w", encoding="utf-8") as sink:
            os.dup2(sink.fileno(), 1)
            os.dup2(sink.fileno(), 2)
        yield
    finally:
        for number, handle in enumerate(saved, start=1):
            os.dup2(handle, number)
            os.close(handle)
