"""Forward kinematics and rigid-body dynamics of a serial arm with a tool, compiled.

One pass over the joints in world coordinates about the origin of the base: there twists, wrenches and inertias of
different links add up without transforms (Featherstone 2008, chapters 5 and 6). A test compares the results with
PyBullet's; decision 54 compares the time with PyBullet's and Pinocchio's.
"""

import math

import numpy as np

from deltasafe.compute.numba_cache import compiled
from deltasafe.execution.arm import Dynamics


@compiled
def forward_kinematics(model, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return position (3,) and quaternion (4,) x, y, z, w of the tool of a ``ChainModel`` at joint positions (n,)."""
    n = len(q)
    rotation, point = model.base_rotation, model.base_m.copy()
    for joint in range(n):
        _add_scaled(point, 1.0, _matvec(rotation, model.offsets_m[joint]))
        rotation = _matmul(_matmul(rotation, model.rotations[joint]), _rotation(model.axes[joint], q[joint]))
    _add_scaled(point, 1.0, _matvec(rotation, model.offsets_m[n]))
    return point, _quaternion(_matmul(rotation, model.rotations[n]))


@compiled
def tool_jacobian(model, q):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return position (3,), quaternion (4,) x, y, z, w and Jacobian (6, n), linear then angular, of the tool."""
    n = len(q)
    jacobian, points, axes = np.empty((6, n)), np.empty((n, 3)), np.empty((n, 3))
    rotation, point = model.base_rotation, model.base_m.copy()
    for joint in range(n):
        _add_scaled(point, 1.0, _matvec(rotation, model.offsets_m[joint]))
        frame = _matmul(rotation, model.rotations[joint])
        points[joint], axes[joint] = point, _matvec(frame, model.axes[joint])
        rotation = _matmul(frame, _rotation(model.axes[joint], q[joint]))
    _add_scaled(point, 1.0, _matvec(rotation, model.offsets_m[n]))
    for joint in range(n):
        jacobian[:3, joint] = _cross(axes[joint], point - points[joint])
        jacobian[3:, joint] = axes[joint]
    return point, _quaternion(_matmul(rotation, model.rotations[n])), jacobian


@compiled
def rigid_body_dynamics(model, q, q_dot):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Return the ``Dynamics`` of a ``ChainModel`` at joint positions (n,) and velocities (n,).

    Spatial vectors are (angular, linear at the base's origin). ``screws[j]`` is the twist of joint j at unit speed.
    """
    n = len(q)
    screws, inertias, wrenches, points = np.zeros((n, 6)), np.zeros((n, 6, 6)), np.zeros((n, 6)), np.zeros((n, 3))
    twist, joint_twist, acceleration, net_acceleration = np.zeros(6), np.zeros(6), np.zeros(6), np.zeros(6)
    rotation, point = model.base_rotation, np.zeros(3)
    for joint in range(n):
        _add_scaled(point, 1.0, _matvec(rotation, model.offsets_m[joint]))
        frame = _matmul(rotation, model.rotations[joint])
        points[joint] = point
        screws[joint, :3] = _matvec(frame, model.axes[joint])
        screws[joint, 3:] = _cross(point, screws[joint, :3])
        for i in range(6):
            joint_twist[i] = screws[joint, i] * q_dot[joint]
        _add_scaled(acceleration[:3], 1.0, _cross(twist[:3], joint_twist[:3]))
        _add_scaled(acceleration[3:], 1.0, _cross(twist[:3], joint_twist[3:]))
        _add_scaled(acceleration[3:], 1.0, _cross(twist[3:], joint_twist[:3]))
        _add_scaled(twist, 1.0, joint_twist)
        rotation = _matmul(frame, _rotation(model.axes[joint], q[joint]))
        center = _matvec(rotation, model.centers_m[joint])
        _add_scaled(center, 1.0, point)
        tensor = _matmul(_matmul(rotation, model.inertias_kgm2[joint]), rotation.T)
        _spatial_inertia(inertias[joint], model.masses_kg[joint], center, tensor)
        net_acceleration[:] = acceleration
        _add_scaled(net_acceleration[3:], -1.0, model.gravity_mps2)
        momentum = _matvec(inertias[joint], twist)
        wrenches[joint] = _matvec(inertias[joint], net_acceleration)
        _add_scaled(wrenches[joint, :3], 1.0, _cross(twist[:3], momentum[:3]))
        _add_scaled(wrenches[joint, :3], 1.0, _cross(twist[3:], momentum[3:]))
        _add_scaled(wrenches[joint, 3:], 1.0, _cross(twist[:3], momentum[3:]))
    tool = _matvec(rotation, model.offsets_m[n])
    _add_scaled(tool, 1.0, point)
    mass, bias, jacobian = np.zeros((n, n)), np.zeros(n), np.zeros((6, n))
    for joint in range(n - 1, -1, -1):
        bias[joint] = _dot(screws[joint], wrenches[joint])
        momentum = _matvec(inertias[joint], screws[joint])
        for other in range(joint + 1):
            mass[joint, other] = mass[other, joint] = _dot(screws[other], momentum)
        if joint > 0:
            _add_scaled(wrenches[joint - 1], 1.0, wrenches[joint])
            _add_scaled(inertias[joint - 1].ravel(), 1.0, inertias[joint].ravel())
        _add_scaled(points[joint], -1.0, tool)
        jacobian[:3, joint] = _cross(points[joint], screws[joint, :3])
        jacobian[3:, joint] = screws[joint, :3]
    return Dynamics(mass, bias, jacobian, _acceleration_at(tool, twist, acceleration))


@compiled
def _acceleration_at(point, twist, acceleration):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Convert a spatial acceleration to (linear at a body-fixed ``point``, angular)."""
    velocity = _cross(twist[:3], point)
    _add_scaled(velocity, 1.0, twist[3:])
    at_point = np.zeros(6)
    at_point[:3] = acceleration[3:]
    _add_scaled(at_point[:3], 1.0, _cross(acceleration[:3], point))
    _add_scaled(at_point[:3], 1.0, _cross(twist[:3], velocity))
    at_point[3:] = acceleration[:3]
    return at_point


@compiled
def _spatial_inertia(out, mass, center, about_center):  # type: ignore[no-untyped-def]  # pragma: no cover
    """Write the spatial inertia (6, 6) about the origin into ``out``."""
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


@compiled
def _rotation(axis, angle):  # type: ignore[no-untyped-def]  # pragma: no cover
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


@compiled
def _quaternion(r):  # type: ignore[no-untyped-def]  # pragma: no cover
    """x, y, z, w of a rotation matrix; divides by the largest component (Shepperd 1978)."""
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


@compiled
def _add_scaled(out, factor, a):  # type: ignore[no-untyped-def]  # pragma: no cover
    for i in range(len(out)):
        out[i] += factor * a[i]


@compiled
def _dot(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    total = 0.0
    for i in range(len(a)):
        total += a[i] * b[i]
    return total


@compiled
def _matvec(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    out = np.empty(len(a))
    for i in range(len(a)):
        out[i] = _dot(a[i], b)
    return out


@compiled
def _matmul(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    out = np.empty((3, 3))
    for i in range(3):
        for k in range(3):
            out[i, k] = a[i, 0] * b[0, k] + a[i, 1] * b[1, k] + a[i, 2] * b[2, k]
    return out


@compiled
def _cross(a, b):  # type: ignore[no-untyped-def]  # pragma: no cover
    return np.array([a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]])
