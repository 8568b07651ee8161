"""Skinning: linear blending, dual quaternions, and their mean."""

import numpy as np
from scipy.spatial.transform import Rotation

from generator.aliases import Array
from generator.arm import ArmModel
from generator.pose import Pose
from generator.skeleton import Skeleton, forward_kinematics, local_rotations, relative_to


def posed_vertices_m(arm: ArmModel, skeleton: Skeleton, pose: Pose) -> Array:
    """Return the coarse mesh (V, 3) in the given pose, in the hand frame; the wrist is fixed, the forearm moves.

    Linear blending loses volume at a bent joint and dual quaternions add volume, so the mean of both is used.
    """
    motions = relative_to(forward_kinematics(skeleton, local_rotations(skeleton, pose)), "wrist")
    rotations, translations = (np.stack(parts) for parts in zip(*(motions[bone] for bone in arm.bones), strict=True))
    linear = linear_blend_skinning(skeleton.vertices_m, arm.weights, rotations, translations)
    pivot = arm.bone_index("wrist")
    dual = dual_quaternion_skinning(skeleton.vertices_m, arm.weights, rotations, translations, pivot)
    return 0.5 * (linear + dual)


def linear_blend_skinning(vertices: Array, weights: Array, rotations: Array, translations: Array) -> Array:
    """Move vertices (V, 3) by the mean motion of the bones, weighted by ``weights`` (V, B).

    Args:
        rotations: (B, 3, 3).
        translations: (B, 3).
    """
    rotated = np.einsum("vb,bij,vj->vi", weights, rotations, vertices, optimize=True)
    return np.asarray(rotated + weights @ translations)


def dual_quaternion_skinning(
    vertices: Array, weights: Array, rotations: Array, translations: Array, pivot: int = 0
) -> Array:
    """Move vertices (V, 3) by the blended dual quaternions of the bones (Kavan et al. 2008).

    Args:
        weights, rotations, translations: as in `linear_blend_skinning`.
        pivot: bone whose hemisphere of the double cover all quaternions are flipped to.
    """
    real = np.roll(Rotation.from_matrix(rotations).as_quat(), 1, axis=1)  # scalar first
    real *= np.where(real @ real[pivot] < 0, -1, 1)[:, None]
    # product of the pure quaternion of the translation with the rotation
    scalar = -(translations * real[:, 1:]).sum(axis=1, keepdims=True)
    dual = 0.5 * np.hstack([scalar, real[:, :1] * translations + np.cross(translations, real[:, 1:])])
    blended = np.hstack([weights @ real, weights @ dual])
    blended /= np.linalg.norm(blended[:, :4], axis=1, keepdims=True)
    w, v, dual_w, dual_v = np.split(blended, [1, 4, 5], axis=1)
    rotated = vertices + 2 * np.cross(v, np.cross(v, vertices) + w * vertices)
    return np.asarray(rotated + 2 * (w * dual_v - dual_w * v + np.cross(v, dual_v)))
