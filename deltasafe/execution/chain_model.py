"""Rigid-body model of a serial arm, read from URDF."""

import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple, Self, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

Array = NDArray[np.float64]
_Body: TypeAlias = tuple[float, Array, Array]
"""Mass in kg, center of mass (3,) in m and inertia (3, 3) about it, in the frame of the link."""


class ChainModel(NamedTuple):
    """A chain of n revolute joints with frames as in URDF; fixed links are merged into the link that carries them.

    Attributes:
        rotations: (n + 1, 3, 3) and offsets_m (n + 1, 3): frame of joint j in that of link j - 1, at position 0;
            the last one is the tool's frame in the last link.
        axes: (n, 3) in the joint's frame.
        masses_kg: (n,); centers_m: (n, 3) of mass in the link's frame.
        inertias_kgm2: (n, 3, 3) about the center of mass, in the link's frame.
        base_rotation: (3, 3), base_m: (3,) of the base in the world.
        gravity_mps2: (3,) in the world.
    """

    rotations: Array
    offsets_m: Array
    axes: Array
    masses_kg: Array
    centers_m: Array
    inertias_kgm2: Array
    base_rotation: Array
    base_m: Array
    gravity_mps2: Array

    @classmethod
    def from_urdf(cls, robot: ET.Element, base_rotation: Array, base_m: Array, gravity_mps2: Sequence[float]) -> Self:
        """Build the chain from the link without a parent to the last link, whose frame is the tool frame.

        Raises:
            SettingsError: the robot branches, or has joints that are neither revolute nor fixed.
        """
        links = {link.get("name"): link for link in robot.findall("link")}
        joints = {_name(joint, "parent"): joint for joint in robot.findall("joint")}
        if len(joints) != len(robot.findall("joint")):
            raise SettingsError("the robot branches: a chain has one joint at each link")
        name = next(iter(set(links) - {_name(joint, "child") for joint in joints.values()}))
        rotations, offsets, axes = [], [], []
        bodies: list[list[_Body]] = []
        rotation, offset = np.eye(3), np.zeros(3)
        while name in joints:
            joint = joints[name]
            turn, shift = _origin(joint)
            offset, rotation = offset + rotation @ shift, rotation @ turn
            name = _name(joint, "child")
            if joint.get("type") == "revolute":
                rotations.append(rotation)
                offsets.append(offset)
                axes.append(_numbers(joint.find("axis"), "xyz", "1 0 0"))
                bodies.append([])
                rotation, offset = np.eye(3), np.zeros(3)
            elif joint.get("type") != "fixed":
                raise SettingsError(
                    f"joint {joint.get('name')} is {joint.get('type')}, only revolute and fixed joints are modeled"
                )
            inertial = links[name].find("inertial")
            if bodies and inertial is not None:
                turn, shift = _origin(inertial)
                bodies[-1].append(_body(inertial, rotation @ turn, offset + rotation @ shift))
        masses, centers, inertias = zip(*(_merged(parts) for parts in bodies), strict=True)
        return cls(
            np.array([*rotations, rotation]),
            np.array([*offsets, offset]),
            np.array(axes),
            np.array(masses),
            np.array(centers),
            np.array(inertias),
            np.array(base_rotation, dtype=np.float64),
            np.array(base_m, dtype=np.float64),
            np.array(gravity_mps2, dtype=np.float64),
        )


def rotation_of(rpy_rad: Sequence[float] | Array) -> Array:
    """Rotation (3, 3) of roll, pitch and yaw about fixed axes."""
    (sr, sp, sy), (cr, cp, cy) = (f(np.asarray(rpy_rad)) for f in (np.sin, np.cos))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _name(joint: ET.Element, end: str) -> str:
    link = joint.find(end)
    assert link is not None
    return str(link.get("link"))


def _numbers(element: ET.Element | None, attribute: str, default: str) -> Array:
    text = default if element is None else element.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def _origin(element: ET.Element) -> tuple[Array, Array]:
    """Rotation (3, 3) and offset (3,) of the element's ``origin`` (roll, pitch, yaw about fixed axes)."""
    origin = element.find("origin")
    return rotation_of(_numbers(origin, "rpy", "0 0 0")), _numbers(origin, "xyz", "0 0 0")


def _body(inertial: ET.Element, rotation: Array, center_m: Array) -> _Body:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None
    assert inertia is not None
    xx, xy, xz, yy, yz, zz = (float(inertia.get(name, "0")) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(mass.get("value", "0")), center_m, rotation @ tensor @ rotation.T


def _merged(parts: list[_Body]) -> _Body:
    """Join rigidly connected bodies (parallel axis theorem)."""
    mass = sum(part[0] for part in parts)
    center = sum((part[0] * part[1] for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for part_kg, part_m, tensor in parts:
        offset = part_m - center
        inertia += tensor + part_kg * (offset @ offset * np.eye(3) - np.outer(offset, offset))
    return mass, center, inertia
