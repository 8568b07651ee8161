"""Rigid-body model of a serial arm with a tool at its end, compiled: what its controller knows of it.

All of it in one pass over the joints, in world coordinates about the base's origin, where twists, wrenches and
inertias of different links add up without transforms (Featherstone 2008, chapters 5 and 6). The model is read from
the same URDF that the simulator loads and agrees with it to rounding (a test), at a tenth of the time.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Sequence
from typing import NamedTuple, Self

import numba
import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import SettingsError

__all__ = ["ChainModel", "forward_kinematics", "rigid_body"]

Array = NDArray[np.float64]


class ChainModel(NamedTuple):
    """n revolute joints, one after the other; frames as in URDF, fixed links merged into the link that carries them.

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
        """The chain that begins at the link without a parent; its last link's frame is the tool's.

        Raises:
            SettingsError: the robot branches, or has joints that neither turn nor are fixed.
        """
        links = {link.get("name"): link for link in robot.findall("link")}
        joints = {_name(joint, "parent"): joint for joint in robot.findall("joint")}
        if len(joints) != len(robot.findall("joint")):
            raise SettingsError("the robot branches: a chain has one joint at each link")
        name = next(iter(set(links) - {_name(joint, "child") for joint in joints.values()}))
        rotations, offsets, axes = [], [], []
        bodies: list[list[tuple[float, Array, Array]]] = []
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
                raise SettingsError(f"joint {joint.get('name')} is {joint.get('type')}, only revolute joints turn here")
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


def _name(joint: ET.Element, end: str) -> str:
    link = joint.find(end)
    assert link is not None
    return str(link.get("link"))


def _numbers(element: ET.Element | None, attribute: str, default: str) -> Array:
    text = default if element is None else element.get(attribute, default)
    return np.array([float(word) for word in text.split()])


def _origin(element: ET.Element) -> tuple[Array, Array]:
    """Rotation (3, 3) and offset (3,) of the element's ``origin``: roll, pitch, yaw about fixed axes."""
    origin = element.find("origin")
    (sr, sp, sy), (cr, cp, cy) = (f(_numbers(origin, "rpy", "0 0 0")) for f in (np.sin, np.cos))
    rotation = np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )
    return rotation, _numbers(origin, "xyz", "0 0 0")


def _body(inertial: ET.Element, rotation: Array, center_m: Array) -> tuple[float, Array, Array]:
    mass, inertia = inertial.find("mass"), inertial.find("inertia")
    assert mass is not None
    assert inertia is not None
    xx, xy, xz, yy, yz, zz = (float(inertia.get(name, "0")) for name in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"))
    tensor = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    return float(mass.get("value", "0")), center_m, rotation @ tensor @ rotation.T


def _merged(parts: list[tuple[float, Array, Array]]) -> tuple[float, Array, Array]:
    """Mass, center and inertia about it of bodies that are one (Huygens and Steiner)."""
    mass = sum(part[0] for part in parts)
    center = sum((part[0] * part[1] for part in parts), np.zeros(3)) / mass
    inertia = np.zeros((3, 3))
    for own_kg, own_m, tensor in parts:
        away = own_m - center
        inertia += tensor + own_kg * (away @ away * np.eye(3) - np.outer(away, away))
    return mass, center, inertia


@numba.njit(cache=True)
def forward_kinematics(model, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Position (3,) and quaternion (4,) x, y, z, w of the tool at joint positions (n,)."""
    n = len(q)
    rotation, point = model.base_rotation, model.base_m.copy()
    for joint in range(n):
        _add(point, 1.0, _apply(rotation, model.offsets_m[joint]))
        rotation = _times(_times(rotation, model.rotations[joint]), _turn(model.axes[joint], q[joint]))
    _add(point, 1.0, _apply(rotation, model.offsets_m[n]))
    return point, _quaternion(_times(rotation, model.rotations[n]))


@numba.njit(cache=True)
def rigid_body(model, q, q_dot):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Mass matrix (n, n), bias (n,), Jacobian (6, n) and drift (6,) of the tool, as ``Dynamics`` wants them.

    Spatial vectors are (angular, linear at the base's origin); joint j moves by ``screws[j]``.
    """
    n = len(q)
    screws, inertias, wrenches = np.zeros((n, 6)), np.zeros((n, 6, 6)), np.zeros((n, 6))
    points = np.zeros((n, 3))
    twist, rate, felt, moving = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    rotation, point = model.base_rotation, np.zeros(3)
    for joint in range(n):
        _add(point, 1.0, _apply(rotation, model.offsets_m[joint]))
        frame = _times(rotation, model.rotations[joint])
        points[joint] = point
        screws[joint, :3] = _apply(frame, model.axes[joint])
        screws[joint, 3:] = _cross(point, screws[joint, :3])
        for i in range(6):
            moving[i] = screws[joint, i] * q_dot[joint]
        _add(rate[:3], 1.0, _cross(twist[:3], moving[:3]))
        _add(rate[3:], 1.0, _cross(twist[:3], moving[3:]))
        _add(rate[3:], 1.0, _cross(twist[3:], moving[:3]))
        _add(twist, 1.0, moving)
        rotation = _times(frame, _turn(model.axes[joint], q[joint]))
        center = _apply(rotation, model.centers_m[joint])
        _add(center, 1.0, point)
        tensor = _times(_times(rotation, model.inertias_kgm2[joint]), rotation.T)
        _spatial_inertia(inertias[joint], model.masses_kg[joint], center, tensor)
        felt[:] = rate
        _add(felt[3:], -1.0, model.gravity_mps2)
        momentum = _apply(inertias[joint], twist)
        wrenches[joint] = _apply(inertias[joint], felt)
        _add(wrenches[joint, :3], 1.0, _cross(twist[:3], momentum[:3]))
        _add(wrenches[joint, :3], 1.0, _cross(twist[3:], momentum[3:]))
        _add(wrenches[joint, 3:], 1.0, _cross(twist[:3], momentum[3:]))
    tool = _apply(rotation, model.offsets_m[n])
    _add(tool, 1.0, point)
    mass, bias, jacobian, drift = np.zeros((n, n)), np.zeros(n), np.zeros((6, n)), np.zeros(6)
    for joint in range(n - 1, -1, -1):
        bias[joint] = _dot(screws[joint], wrenches[joint])
        carried = _apply(inertias[joint], screws[joint])
        for other in range(joint + 1):
            mass[joint, other] = mass[other, joint] = _dot(screws[other], carried)
        if joint > 0:
            _add(wrenches[joint - 1], 1.0, wrenches[joint])
            _add(inertias[joint - 1].ravel(), 1.0, inertias[joint].ravel())
        _add(points[joint], -1.0, tool)
        jacobian[:3, joint] = _cross(points[joint], screws[joint, :3])
        jacobian[3:, joint] = screws[joint, :3]
    at_tool = _cross(twist[:3], tool)
    _add(at_tool, 1.0, twist[3:])
    drift[:3] = rate[3:]
    _add(drift[:3], 1.0, _cross(rate[:3], tool))
    _add(drift[:3], 1.0, _cross(twist[:3], at_tool))
    drift[3:] = rate[:3]
    return mass, bias, jacobian, drift


@numba.njit(cache=True)
def _spatial_inertia(out, mass, center, about_center):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the (6, 6) inertia about the origin into ``out``."""
    x, y, z = center[0], center[1], center[2]
    square = x * x + y * y + z * z
    for i in range(3):
        for k in range(3):
            out[i, k] = about_center[i, k] - mass * center[i] * center[k]
        out[i, i] += mass * square
        out[3 + i, 3 + i] = mass
    out[0, 4], out[0, 5], out[1, 5] = -mass * z, mass * y, -mass * x
    out[1, 3], out[2, 3], out[2, 4] = mass * z, -mass * y, mass * x
    for i in range(3):
        for k in range(3):
            out[3 + k, i] = out[i, 3 + k]


@numba.njit(cache=True)
def _turn(axis, angle):  # type: ignore[no-untyped-def]  # pragma: no cover
    """(3, 3) rotation about a unit axis (Rodrigues)."""
    c, s = math.cos(angle), math.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    t = 1.0 - c
    return np.array(
        [
            [t * x * x + c, t * x * y - s * z, t * x * z + s * y],
            [t * x * y + s * z, t * y * y + c, t * y * z - s * x],
            [t * x * z - s * y, t * y * z + s * x, t * z * z + c],
        ]
    )


@numba.njit(cache=True)
def _quaternion(r):  # type: ignore[no-untyped-def]  # pragma: no cover
    """x, y, z, w of a rotation matrix, by the largest of the four (Shepperd 1978)."""
    trace = r[0, 0] + r[1, 1] + r[2, 2]
    out = np.empty(4)
    largest, best = 3, trace
    for i in range(3):
        if r[i, i] > best:
            largest, best = i, r[i, i]
    if largest == 3:
        out[0], out[1], out[2] = r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1]
        out[3] = 1.0 + trace
    else:
        i, j, k = largest, (largest + 1) % 3, (largest + 2) % 3
        out[i] = 1.0 + r[i, i] - r[j, j] - r[k, k]
        out[j], out[k] = r[i, j] + r[j, i], r[i, k] + r[k, i]
        out[3] = r[k, j] - r[j, k]
    return out / math.sqrt(out @ out)


@numba.njit(cache=True)
def _add(out, factor, a):  # type: ignore[no-untyped-def]  # pragma: no cover
    for i in range(len(out)):
        out[i] += factor * a[i]


@numba.njit(cache=True)
def _dot(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@numba.njit(cache=True)
def _apply(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    out = np.empty(len(a))
    for i in range(len(a)):
        out[i] = _dot(a[i], b)
    return out


@numba.njit(cache=True)
def _times(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    out = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            out[i, k] = a[i, 0] * b[0, k] + a[i, 1] * b[1, k] + a[i, 2] * b[2, k]
    return out


@numba.njit(cache=True)
def _cross(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
