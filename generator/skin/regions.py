"""Where on the hand a point lies: palm or back, which finger, where the joints are. Millimetres, frame of the hand."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from generator.arm import ArmModel
from generator.noise import smoothstep
from generator.skeleton import DIGITS, PARENTS, Skeleton
from generator.surface_mesh import unit, vertex_normals

__all__ = ["Regions"]

Array = NDArray[np.float64]
FOREARM = ("lowerarm01", "lowerarm02", "upperarm02")


@dataclasses.dataclass(frozen=True)
class Regions:
    """Attributes of the V vertices of the fine mesh at rest.

    Attributes:
        points_mm: (V, 3).
        normals: (V, 3).
        bone_share: (V,) weight of each bone, by name.
        finger_share: (V,) weight of all bones of each digit, by number.
        fingers_share: (V,) weight of all digits.
        hand_share: (V,) 1 on the hand, 0 on the forearm.
        palm_facing: (V,) about 1 where the skin faces the way the palm does, -1 on the back, on fingers too.
        palmar, dorsal: (V,) shares of palm skin and of the back.
        joints_mm: position of each joint.
        backs: unit vector out of the back of each bone of a digit.
        along: unit vector along each bone of a digit.
        bisector: unit vector halfway between a bone of a digit and its parent: normal of the plane of their joint.
        nails: (V,) where the model has fingernails.
    """

    points_mm: Array
    normals: Array
    bone_share: dict[str, Array]
    finger_share: dict[int, Array]
    fingers_share: Array
    hand_share: Array
    palm_facing: Array
    palmar: Array
    dorsal: Array
    joints_mm: dict[str, Array]
    backs: dict[str, Array]
    along: dict[str, Array]
    bisector: dict[str, Array]
    nails: Array

    @classmethod
    def of(cls, arm: ArmModel, skeleton: Skeleton) -> "Regions":
        """Regions of one person's hand."""
        points = arm.refine(skeleton.vertices_m)
        normals = vertex_normals(points, arm.refined_quads())
        weights = arm.refine(arm.weights)
        share = {bone: weights[:, i] for i, bone in enumerate(arm.bones)}
        finger = {f: np.sum([share[f"finger{f}-{k}"] for k in (1, 2, 3)], axis=0) for f in DIGITS}
        fingers = np.sum(list(finger.values()), axis=0)
        hand = np.clip(1 - sum(share[bone] for bone in FOREARM), 0, 1)
        bones = [f"finger{f}-{k}" for f in DIGITS for k in (1, 2, 3)]
        backs = {bone: skeleton.back_of(bone) for bone in bones}
        facing = -np.clip(1 - fingers, 0, 1) * normals[:, 2] - sum(share[b] * (normals @ backs[b]) for b in bones)
        return cls(
            points_mm=points * 1000,
            normals=normals,
            bone_share=share,
            finger_share=finger,
            fingers_share=fingers,
            hand_share=hand,
            palm_facing=facing,
            palmar=smoothstep(-0.25, 0.45, facing) * smoothstep(0.15, 0.8, hand),
            dorsal=1 - smoothstep(-0.3, 0.3, facing),
            joints_mm={name: joint * 1000 for name, joint in skeleton.joints_m.items()},
            backs=backs,
            along={bone: skeleton.directions[bone] for bone in bones},
            bisector={
                bone: unit(skeleton.directions[bone] + skeleton.directions[str(PARENTS[bone])]) for bone in bones
            },
            nails=arm.refine(arm.nails),
        )
