"""Bones of one person's arm in the hand frame, and forward kinematics.

Hand frame: origin at the wrist, +x to the middle knuckle, +z out of the back of the hand. The thumb of the (left) arm
lies at -y.
"""

import dataclasses

import numpy as np
from scipy.spatial.transform import Rotation

from generator.aliases import Array
from generator.arm import ArmModel
from generator.pose import Pose
from generator.surface_mesh import normalized, vertex_normals

RigidMotions = dict[str, tuple[Array, Array]]
Y, Z = np.array([0.0, 1.0, 0.0]), np.array([0.0, 0.0, 1.0])
THUMB, FINGERS = 1, (2, 3, 4, 5)
DIGITS = (THUMB, *FINGERS)
DIGIT_BONES = tuple(f"finger{digit}-{k}" for digit in DIGITS for k in (1, 2, 3))
RING_CUPPING = 0.35
PARENTS: dict[str, str | None] = {
    "upperarm02": None,
    "lowerarm01": "upperarm02",
    "lowerarm02": "lowerarm01",
    "wrist": "lowerarm02",
    **{f"metacarpal{i}": "wrist" for i in (1, 2, 3, 4)},
    **{f"finger{f}-1": "wrist" if f == THUMB else f"metacarpal{f - 1}" for f in DIGITS},
    **{f"finger{f}-{k}": f"finger{f}-{k - 1}" for f in DIGITS for k in (2, 3)},
}


def rotation_matrix(axis: Array, angle_rad: float) -> Array:
    """Return the (3, 3) rotation about a unit axis."""
    return np.asarray(Rotation.from_rotvec(axis * angle_rad).as_matrix())


@dataclasses.dataclass(frozen=True)
class Skeleton:
    """Bones in the rest pose, by name, in meters in the hand frame.

    Attributes:
        vertices_m: (V, 3) coarse mesh in the rest pose.
        joints_m: position of each joint.
        heads_m: start of each bone.
        directions: unit vector along each bone.
        flexion_axes: unit axis of flexion towards the palm, for fingers and their metacarpals.
        rest_flexion_rad: flexion of each finger bone in the rest pose.
    """

    vertices_m: Array
    joints_m: dict[str, Array]
    heads_m: dict[str, Array]
    directions: dict[str, Array]
    flexion_axes: dict[str, Array]
    rest_flexion_rad: dict[str, float]

    @classmethod
    def from_points(cls, arm: ArmModel, points_m: Array) -> "Skeleton":
        """Build the skeleton of the arm with the given points (P, 3), which may be in any frame."""
        joints = {name: points_m[part].mean(axis=0) for name, part in arm.joints.items()}
        origin, axes = _hand_frame(joints)
        vertices = (points_m[: arm.n_vertices] - origin) @ axes
        joints = {name: (joint - origin) @ axes for name, joint in joints.items()}
        ends = _bone_ends(joints)
        directions = {bone: normalized(tail - head) for bone, (head, tail) in ends.items()}
        flexion_axes = _flexion_axes(directions, _thumb_nail_normal(arm, vertices))
        rest = {
            bone: _angle_about(flexion_axes[bone], directions[str(PARENTS[bone])], directions[bone])
            for bone in DIGIT_BONES
            if bone != "finger1-1"
        }
        heads = {bone: head for bone, (head, _) in ends.items()}
        return cls(vertices, joints, heads, directions, flexion_axes, rest)

    def dorsal_direction(self, bone: str) -> Array:
        """Return the unit vector out of the back of a finger bone."""
        return np.cross(self.directions[bone], self.flexion_axes[bone])


def local_rotations(skeleton: Skeleton, pose: Pose) -> dict[str, Array]:
    """Return the rotation (3, 3) of each bone relative to its parent, in the hand frame of the rest pose."""
    axes, directions, rest = skeleton.flexion_axes, skeleton.directions, skeleton.rest_flexion_rad
    local = {bone: np.eye(3) for bone in PARENTS}
    local["wrist"] = rotation_matrix(Y, -pose.wrist_extension) @ rotation_matrix(Z, pose.wrist_deviation)
    local["lowerarm02"] = rotation_matrix(directions["lowerarm02"], pose.forearm_twist)
    local["metacarpal3"] = rotation_matrix(axes["metacarpal3"], RING_CUPPING * pose.cupping)
    local["metacarpal4"] = rotation_matrix(axes["metacarpal4"], pose.cupping)
    for finger, angles, spread in zip(FINGERS, pose.fingers, pose.spread, strict=True):
        for k, angle in enumerate(angles, start=1):
            bone = f"finger{finger}-{k}"
            local[bone] = rotation_matrix(axes[bone], angle - rest[bone])
        local[f"finger{finger}-1"] = rotation_matrix(Z, spread) @ local[f"finger{finger}-1"]
    base, (flexion, abduction, twist) = "finger1-1", pose.thumb_base
    flex, abduct = rotation_matrix(axes[base], flexion), rotation_matrix(skeleton.dorsal_direction(base), abduction)
    local[base] = rotation_matrix(directions[base], twist) @ flex @ abduct
    for bone, angle in zip(("finger1-2", "finger1-3"), pose.thumb, strict=True):
        local[bone] = rotation_matrix(axes[bone], angle - rest[bone])
    return local


def forward_kinematics(skeleton: Skeleton, local: dict[str, Array]) -> RigidMotions:
    """Return the rotation R (3, 3) and translation t (3,) of each bone, which move a rest point x to R x + t.

    Args:
        local: rotation of each bone relative to its parent, about the bone's head.
    """
    posed: RigidMotions = {}
    for bone, parent in PARENTS.items():
        rotation, translation = posed[parent] if parent else (np.eye(3), np.zeros(3))
        head = skeleton.heads_m[bone]
        posed[bone] = rotation @ local[bone], rotation @ (head - local[bone] @ head) + translation
    return posed


def relative_to(posed: RigidMotions, bone: str) -> RigidMotions:
    """Express the motions in the frame of ``bone``, whose own motion becomes the identity."""
    rotation, translation = posed[bone]
    return {name: (rotation.T @ r, rotation.T @ (t - translation)) for name, (r, t) in posed.items()}


def _hand_frame(joints: dict[str, Array]) -> tuple[Array, Array]:
    x = normalized(joints["finger-3-1"] - joints["hand"])
    z = np.cross(x, joints["finger-2-1"] - joints["finger-5-1"])
    z = normalized(z - x * (z @ x))
    curl = sum(
        normalized(joints[f"finger-{f}-4"] - joints[f"finger-{f}-3"])
        - normalized(joints[f"finger-{f}-2"] - joints[f"finger-{f}-1"])
        for f in FINGERS
    )
    z = -z if curl @ z > 0 else z  # fingers curl away from the back of the hand
    return joints["hand"], np.stack([x, np.cross(z, x), z], axis=1)


def _bone_ends(joints: dict[str, Array]) -> dict[str, tuple[Array, Array]]:
    mid_forearm = 0.5 * (joints["elbow"] + joints["hand"])
    ends = {
        "upperarm02": (0.5 * (joints["shoulder"] + joints["elbow"]), joints["elbow"]),
        "lowerarm01": (joints["elbow"], mid_forearm),
        "lowerarm02": (mid_forearm, joints["hand"]),
        "wrist": (joints["hand"], joints["hand-3"]),
    }
    for i, carpal in ((1, "hand-3"), (2, "hand-3"), (3, "hand-2"), (4, "hand-2")):
        ends[f"metacarpal{i}"] = joints[carpal], joints[f"finger-{i + 1}-1"]
    for f in DIGITS:
        for k in (1, 2, 3):
            ends[f"finger{f}-{k}"] = joints[f"finger-{f}-{k}"], joints[f"finger-{f}-{k + 1}"]
    return ends


def _flexion_axes(directions: dict[str, Array], thumb_nail_normal: Array) -> dict[str, Array]:
    axes = {}
    for f in FINGERS:
        chain = [f"metacarpal{f - 1}", *(f"finger{f}-{k}" for k in (1, 2, 3))]
        first, last = directions[chain[1]], directions[chain[3]]
        anatomical, observed = normalized(np.cross(Z, first)), normalized(np.cross(first, last))
        axis = normalized(0.4 * anatomical + 0.6 * observed * np.sign(observed @ anatomical))
        for bone in chain:
            axes[bone] = normalized(axis - directions[bone] * (axis @ directions[bone]))
    for bone in ("finger1-1", "finger1-2", "finger1-3"):
        axes[bone] = normalized(np.cross(thumb_nail_normal, directions[bone]))
    return axes


def _thumb_nail_normal(arm: ArmModel, vertices_m: Array) -> Array:
    nail = (arm.nails > 0.5) & (arm.weights[:, arm.bone_index("finger1-3")] > 0.5)
    return normalized(vertex_normals(vertices_m, arm.quads)[nail].mean(axis=0))


def _angle_about(axis: Array, start: Array, end: Array) -> float:
    in_plane = normalized(start - axis * (start @ axis))
    return float(np.arctan2(np.cross(in_plane, end) @ axis, in_plane @ end))
