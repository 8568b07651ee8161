"""Anatomical regions of the skin: palm and back, digits and joints. Millimeters, hand frame."""

import dataclasses

import numpy as np

from generator.aliases import Array
from generator.arm import ArmModel
from generator.noise import smoothstep
from generator.skeleton import DIGIT_BONES, DIGITS, PARENTS, Skeleton
from generator.surface_mesh import normalized, vertex_normals

FOREARM_BONES = ("lowerarm01", "lowerarm02", "upperarm02")


@dataclasses.dataclass(frozen=True)
class Regions:
    """Attributes of the V vertices of the fine mesh in the rest pose.

    Attributes:
        points_mm: (V, 3).
        normals: (V, 3).
        bone_weights: (V,) skinning weight of each bone, by name.
        digit_weights: (V,) skinning weight of all bones of each digit, by number.
        all_digits_weight: (V,) skinning weight of all digits.
        hand_weight: (V,) 1 on the hand, 0 on the forearm.
        palm_facing: (V,) cosine to the palm's normal, on fingers to the palmar side of the bone; -1 on the back.
        palmar, dorsal: (V,) blend weights of palm skin and of skin on the back of the hand.
        joints_mm: position of each joint.
        dorsal_directions: unit vector out of the back of each bone of a digit.
        bone_directions: unit vector along each bone of a digit.
        joint_plane_normals: for each bone of a digit, unit bisector of its direction and its parent's direction.
        nails: (V,) 1 on the model's fingernails.
    """

    points_mm: Array
    normals: Array
    bone_weights: dict[str, Array]
    digit_weights: dict[int, Array]
    all_digits_weight: Array
    hand_weight: Array
    palm_facing: Array
    palmar: Array
    dorsal: Array
    joints_mm: dict[str, Array]
    dorsal_directions: dict[str, Array]
    bone_directions: dict[str, Array]
    joint_plane_normals: dict[str, Array]
    nails: Array

    @classmethod
    def from_skeleton(cls, arm: ArmModel, skeleton: Skeleton) -> "Regions":
        """Compute the regions of one person's hand."""
        points = arm.refine(skeleton.vertices_m)
        normals = vertex_normals(points, arm.refined_quads())
        weights = dict(zip(arm.bones, arm.refine(arm.weights).T, strict=True))
        digits = {d: np.sum([weights[f"finger{d}-{k}"] for k in (1, 2, 3)], axis=0) for d in DIGITS}
        all_digits = np.sum(list(digits.values()), axis=0)
        hand = np.clip(1 - sum(weights[bone] for bone in FOREARM_BONES), 0, 1)
        dorsal = {bone: skeleton.dorsal_direction(bone) for bone in DIGIT_BONES}
        directions = skeleton.directions
        facing = -np.clip(1 - all_digits, 0, 1) * normals[:, 2]
        facing = facing - sum(weights[bone] * (normals @ dorsal[bone]) for bone in DIGIT_BONES)
        return cls(
            points_mm=points * 1000,
            normals=normals,
            bone_weights=weights,
            digit_weights=digits,
            all_digits_weight=all_digits,
            hand_weight=hand,
            palm_facing=facing,
            palmar=smoothstep(-0.25, 0.45, facing) * smoothstep(0.15, 0.8, hand),
            dorsal=1 - smoothstep(-0.3, 0.3, facing),
            joints_mm={name: joint * 1000 for name, joint in skeleton.joints_m.items()},
            dorsal_directions=dorsal,
            bone_directions={bone: directions[bone] for bone in DIGIT_BONES},
            joint_plane_normals={
                bone: normalized(directions[bone] + directions[str(PARENTS[bone])]) for bone in DIGIT_BONES
            },
            nails=arm.refine(arm.nails),
        )
