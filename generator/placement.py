"""The posed hand in the world frame: on the table or in the air, left or right."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from generator.aliases import Array, Mask, Quads
from generator.arm import ArmModel
from generator.person import shaped_points_m
from generator.recipe import AirPlacement, Recipe, TablePlacement
from generator.skeleton import Skeleton, rotation_matrix
from generator.skinning import posed_vertices_m
from generator.surface_mesh import closed_triangles

X, Y, Z = np.eye(3)
UPRIGHT = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, 1.0], [1.0, 0.0, 0.0]])  # fingers up, back of the hand along +y
FOREARM_X_M = -0.06  # behind the wrist, in the hand frame of the rest pose
# percentage of vertices that may be below the table, because soft skin yields; counted without the upper forearm
SUNK_PERCENT, CONTACT_X_M = 0.3, -0.20


@dataclasses.dataclass(frozen=True)
class PlacedHand:
    """A posed hand in the world frame.

    Attributes:
        arm, skeleton: model and bones of the person.
        posed_m: (V, 3) coarse mesh in the hand frame.
        rotation: (3, 3) from the hand frame to the world frame; a reflection for a right hand.
        offset_m: (3,) position of the wrist.
        is_hand: (N,) vertices of the fine mesh that are hand, not forearm.
    """

    arm: ArmModel
    skeleton: Skeleton
    posed_m: Array
    rotation: Array
    offset_m: Array
    is_hand: Mask

    def to_world(self, points_m: Array) -> Array:
        """Transform points (N, 3) from the hand frame to the world frame."""
        return np.asarray(points_m @ self.rotation.T + self.offset_m)

    def outward_quads(self, quads: Quads) -> Quads:
        """Reverse the faces of a mirrored hand, so that their normals point outwards in the world frame."""
        return quads[:, ::-1] if np.linalg.det(self.rotation) < 0 else quads

    def surface_m(self, levels: int) -> tuple[Array, Quads]:
        """Return vertices in the world frame and faces of the mesh refined ``levels`` times."""
        vertices = self.to_world(self.arm.refine(self.posed_m, levels))
        return vertices, self.outward_quads(self.arm.refined_quads(levels))

    def mesh_m(self) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
        """Return the watertight mesh that is stored with a scene: vertices (V, 3) and triangles (F, 3)."""
        vertices, triangles = closed_triangles(*self.surface_m(levels=1))
        return vertices.astype(np.float32), triangles.astype(np.int32)

    @property
    def hand_points_m(self) -> Array:
        """Vertices (N, 3) of the fine mesh in the world frame, without the forearm."""
        return self.surface_m(levels=3)[0][self.is_hand]


def place_hand(recipe: Recipe) -> PlacedHand:
    """Shape, pose and place the hand of a recipe."""
    arm = ArmModel.load()
    skeleton = Skeleton.from_points(arm, shaped_points_m(arm, recipe.person.body))
    posed = posed_vertices_m(arm, skeleton, recipe.pose)
    rest_x = arm.refine(skeleton.vertices_m)[:, 0]
    mirror = np.diag([1.0, -1.0 if recipe.right_hand else 1.0, 1.0])
    rotation = _rotation_of(recipe.placement) @ mirror
    hand = PlacedHand(arm, skeleton, posed, rotation, np.zeros(3), rest_x > FOREARM_X_M)
    points = hand.surface_m(levels=3)[0]
    middle = points[hand.is_hand].mean(axis=0)
    if isinstance(recipe.placement, AirPlacement):
        return dataclasses.replace(hand, offset_m=-middle)
    lowest = np.percentile(points[rest_x > CONTACT_X_M, 2], SUNK_PERCENT)
    x, y = recipe.placement.offset_m
    offset = np.array([x - middle[0], y - middle[1], recipe.placement.hover_m - lowest])
    return dataclasses.replace(hand, offset_m=offset)


def _rotation_of(placement: TablePlacement | AirPlacement) -> Array:
    if isinstance(placement, AirPlacement):
        roll, pitch = rotation_matrix(Y, placement.roll_rad), rotation_matrix(X, placement.pitch_rad)
        return roll @ pitch @ rotation_matrix(Z, placement.yaw_rad) @ UPRIGHT
    roll = rotation_matrix(X, placement.roll_rad + (math.pi if placement.palm_up else 0.0))
    return rotation_matrix(Z, placement.yaw_rad) @ roll @ rotation_matrix(Y, placement.pitch_rad)
