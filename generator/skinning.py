"""From moving bones to a moving surface: linear blending, dual quaternions, and their mean."""

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from generator.arm import ArmModel
from generator.pose import Pose
from generator.skeleton import Skeleton, forward_kinematics, local_rotations, relative_to

__all__ = ["dual_quaternion_skinning", "linear_blend_skinning", "posed_vertices_m"]

Array = NDArray[np.float64]


def posed_vertices_m(arm: ArmModel, skeleton: Skeleton, pose: Pose) -> Array:
    """Coarse mesh (V, 3) in the given pose, in the frame of the hand: the wrist stays, the forearm moves.

    Linear blending loses volume in a bent joint and dual quaternions gain some: the mean of both is nearest to skin.
    """
    motion = relative_to(forward_kinematics(skeleton, local_rotations(skeleton, pose)), "wrist")
    turns = np.stack([motion[bone][0] for bone in arm.bones])
    offsets = np.stack([motion[bone][1] for bone in arm.bones])
    linear = linear_blend_skinning(skeleton.vertices_m, arm.weights, turns, offsets)
    dual = dual_quaternion_skinning(skeleton.vertices_m, arm.weights, turns, offsets, arm.bone("wrist"))
    return 0.5 * (linear + dual)


def linear_blend_skinning(vertices: Array, weights: Array, turns: Array, offsets: Array) -> Array:
    """Vertices (V, 3) moved by the weighted (V, B) mean of the bones' motions, turns (B, 3, 3) and offsets (B, 3)."""
    return np.asarray(np.einsum("vb,bij,vj->vi", weights, turns, vertices, optimize=True) + weights @ offsets)


def dual_quaternion_skinning(vertices: Array, weights: Array, turns: Array, offsets: Array, pivot: int = 0) -> Array:
    """Vertices (V, 3) moved by the blended dual quaternions of the bones (Kavan et al. 2008).

    Args:
        pivot: bone on whose side of the double cover all the others are taken.
    """
    real = np.roll(Rotation.from_matrix(turns).as_quat(), 1, axis=1)
    real *= np.where(real @ real[pivot] < 0, -1, 1)[:, None]
    dual = 0.5 * _product(np.column_stack([np.zeros(len(offsets)), offsets]), real)
    blended = np.hstack([weights @ real, weights @ dual])
    blended /= np.linalg.norm(blended[:, :4], axis=1, keepdims=True)
    w, v, dual_w, dual_v = np.split(blended, [1, 4, 5], axis=1)
    turned = vertices + 2 * np.cross(v, np.cross(v, vertices) + w * vertices)
    return np.asarray(turned + 2 * (w * dual_v - dual_w * v + np.cross(v, dual_v)))


def _product(a: Array, b: Array) -> Array:
    scalar = a[:, :1] * b[:, :1] - (a[:, 1:] * b[:, 1:]).sum(axis=1, keepdims=True)
    return np.hstack([scalar, a[:, :1] * b[:, 1:] + b[:, :1] * a[:, 1:] + np.cross(a[:, 1:], b[:, 1:])])
