"""Bones of one person's arm in the frame of the hand, and forward kinematics.

Frame of the hand: origin at the wrist, +x to the middle knuckle, +z out of the back of the hand; the thumb of the
(left) arm lies at -y.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.arm import ArmModel
from generator.pose import Pose
from generator.surface_mesh import unit, vertex_normals

__all__ = ["FINGERS", "Skeleton", "forward_kinematics", "local_rotations", "relative_to", "rotation"]

Array = NDArray[np.float64]
Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
FINGERS = (2, 3, 4, 5)
DIGITS = (1, *FINGERS)
RING_CUPPING = 0.35
PARENTS: dict[str, str | None] = {
    "upperarm02": None,
    "lowerarm01": "upperarm02",
    "lowerarm02": "lowerarm01",
    "wrist": "lowerarm02",
    **{f"metacarpal{i}": "wrist" for i in (1, 2, 3, 4)},
    **{f"finger{f}-1": "wrist" if f == 1 else f"metacarpal{f - 1}" for f in DIGITS},
    **{f"finger{f}-{k}": f"finger{f}-{k - 1}" for f in DIGITS for k in (2, 3)},
}


def rotation(axis: Array, angle_rad: float) -> Array:
    """(3, 3) rotation about a unit axis."""
    return np.asarray(Rotation.from_rotvec(np.asarray(axis) * angle_rad).as_matrix())


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """Bones at rest, by name, in metres in the frame of the hand.

    Attributes:
        vertices_m: (V, 3) coarse mesh at rest.
        joints_m: position of each joint.
        heads_m: where each bone begins.
        directions: unit vector along each bone.
        flexion_axes: unit axis about which a bone of a finger bends towards the palm.
        rest_flexion_rad: flexion that the mesh at rest already has.
    """

    vertices_m: Array
    joints_m: dict[str, Array]
    heads_m: dict[str, Array]
    directions: dict[str, Array]
    flexion_axes: dict[str, Array]
    rest_flexion_rad: dict[str, float]

    @classmethod
    def of(cls, arm: ArmModel, points_m: Array) -> "Skeleton":
        """Bones of the arm whose points (P, 3), in any frame, are given."""
        joints = {name: points_m[part].mean(axis=0) for name, part in arm.joints.items()}
        origin, axes = _hand_frame(joints)
        vertices = (points_m[: arm.n_vertices] - origin) @ axes
        joints = {name: (joint - origin) @ axes for name, joint in joints.items()}
        ends = _bone_ends(joints)
        directions = {bone: unit(tail - head) for bone, (head, tail) in ends.items()}
        flexion = _flexion_axes(directions, _thumb_nail_normal(arm, vertices))
        rest = {
            bone: _angle_about(axis, directions[parent], directions[bone])
            for bone, axis in flexion.items()
            if bone.startswith("finger") and bone != "finger1-1" and (parent := PARENTS[bone]) is not None
        }
        heads = {bone: head for bone, (head, _) in ends.items()}
        return cls(vertices, joints, heads, directions, flexion, rest)

    def back_of(self, bone: str) -> Array:
        """Unit vector out of the back of a finger's bone."""
        return np.cross(self.directions[bone], self.flexion_axes[bone])


def local_rotations(skeleton: Skeleton, pose: Pose) -> dict[str, Array]:
    """Rotation (3, 3) of each bone against its parent, in the frame of the hand at rest."""
    axes, along, rest = skeleton.flexion_axes, skeleton.directions, skeleton.rest_flexion_rad
    local = {bone: np.eye(3) for bone in PARENTS}
    local["wrist"] = rotation(Y, -pose.wrist_extension) @ rotation(Z, pose.wrist_deviation)
    local["lowerarm02"] = rotation(along["lowerarm02"], pose.forearm_twist)
    local["metacarpal3"] = rotation(axes["metacarpal3"], RING_CUPPING * pose.cupping)
    local["metacarpal4"] = rotation(axes["metacarpal4"], pose.cupping)
    for finger, angles, spread in zip(FINGERS, pose.fingers, pose.spread, strict=True):
        for k, angle in enumerate(angles, start=1):
            bone = f"finger{finger}-{k}"
            local[bone] = rotation(axes[bone], angle - rest[bone])
        local[f"finger{finger}-1"] = rotation(Z, spread) @ local[f"finger{finger}-1"]
    base, (flexion, abduction, twist) = "finger1-1", pose.thumb_base
    across = np.cross(along[base], axes[base])
    local[base] = rotation(along[base], twist) @ rotation(axes[base], flexion) @ rotation(across, abduction)
    for bone, angle in zip(("finger1-2", "finger1-3"), pose.thumb, strict=True):
        local[bone] = rotation(axes[bone], angle - rest[bone])
    return local


def forward_kinematics(
    skeleton: Skeleton, local: dict[str, Array], root: Array | None = None
) -> dict[str, tuple[Array, Array]]:
    """For each bone the rotation M (3, 3) and offset t (3,) that take rest to posed points: x -> M x + t.

    Args:
        local: rotation of each bone against its parent, about its head.
        root: rotation (3, 3) of everything about the origin.
    """
    root = np.eye(3) if root is None else root
    posed: dict[str, tuple[Array, Array]] = {}
    for bone, parent in PARENTS.items():
        turn, offset = posed[parent] if parent else (root, np.zeros(3))
        head = skeleton.heads_m[bone]
        posed[bone] = turn @ local[bone], turn @ (head - local[bone] @ head) + offset
    return posed


def relative_to(posed: dict[str, tuple[Array, Array]], bone: str) -> dict[str, tuple[Array, Array]]:
    """The same motion seen from ``bone``, which then does not move."""
    turn, offset = posed[bone]
    return {name: (turn.T @ m, turn.T @ (t - offset)) for name, (m, t) in posed.items()}


def _hand_frame(joints: dict[str, Array]) -> tuple[Array, Array]:
    x = unit(joints["finger-3-1"] - joints["hand"])
    z = np.cross(x, joints["finger-2-1"] - joints["finger-5-1"])
    z = unit(z - x * (z @ x))
    curl = sum(
        unit(joints[f"finger-{f}-4"] - joints[f"finger-{f}-3"])
        - unit(joints[f"finger-{f}-2"] - joints[f"finger-{f}-1"])
        for f in FINGERS
    )
    z = -z if curl @ z > 0 else z  # fingers curl away from the back of the hand
    return joints["hand"], np.stack([x, np.cross(z, x), z], axis=1)


def _bone_ends(joints: dict[str, Array]) -> dict[str, tuple[Array, Array]]:
    middle = 0.5 * (joints["elbow"] + joints["hand"])
    ends = {
        "upperarm02": (0.5 * (joints["shoulder"] + joints["elbow"]), joints["elbow"]),
        "lowerarm01": (joints["elbow"], middle),
        "lowerarm02": (middle, joints["hand"]),
        "wrist": (joints["hand"], joints["hand-3"]),
    }
    for i, carpal in ((1, "hand-3"), (2, "hand-3"), (3, "hand-2"), (4, "hand-2")):
        ends[f"metacarpal{i}"] = joints[carpal], joints[f"finger-{i + 1}-1"]
    for f in DIGITS:
        for k in (1, 2, 3):
            ends[f"finger{f}-{k}"] = joints[f"finger-{f}-{k}"], joints[f"finger-{f}-{k + 1}"]
    return ends


def _flexion_axes(directions: dict[str, Array], nail_normal: Array) -> dict[str, Array]:
    axes = {}
    for f in FINGERS:
        chain = [f"metacarpal{f - 1}", *(f"finger{f}-{k}" for k in (1, 2, 3))]
        first, last = directions[chain[1]], directions[chain[3]]
        anatomical, observed = unit(np.cross(Z, first)), unit(np.cross(first, last))
        axis = unit(0.4 * anatomical + 0.6 * observed * np.sign(observed @ anatomical))
        for bone in chain:
            axes[bone] = unit(axis - directions[bone] * (axis @ directions[bone]))
    for k in (1, 2, 3):
        bone = f"finger1-{k}"
        axes[bone] = unit(np.cross(nail_normal, directions[bone]))
    return axes


def _thumb_nail_normal(arm: ArmModel, vertices_m: Array) -> Array:
    nail = (arm.nails > 0.5) & (arm.weights[:, arm.bone("finger1-3")] > 0.5)
    return unit(vertex_normals(vertices_m, arm.quads)[nail].mean(axis=0))


def _angle_about(axis: Array, start: Array, end: Array) -> float:
    flat = unit(start - axis * (start @ axis))
    return float(np.arctan2(np.cross(flat, end) @ axis, flat @ end))
