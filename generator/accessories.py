"""Sleeve, watch strap and ring: parts of the posed surface, offset outwards."""

import numpy as np

from generator.aliases import Array, Mask, Quads, Rgb
from generator.noise import fractal_noise, value_noise
from generator.placement import PlacedHand
from generator.recipe import Sleeve
from generator.stage import ClothMesh, Material, SkinMesh
from generator.surface_mesh import vertex_normals

GOLD = (0.85, 0.62, 0.25)


def sleeve_mesh(hand: PlacedHand, sleeve: Sleeve) -> ClothMesh:
    """Build a sleeve with cloth folds around the forearm."""
    rest_m = hand.arm.refine(hand.skeleton.vertices_m, 2)
    rest_mm = rest_m * 1000
    period = np.random.default_rng(sleeve.seed).uniform(14, 30)
    phase = rest_mm[:, 0] + 9 * value_noise(rest_mm / 25, sleeve.seed)
    folds = np.sin(2 * np.pi * phase / period) + 1.2 * fractal_noise(rest_mm / 22, sleeve.seed + 1) + 0.9
    shell = _offset_shell(hand, 2, rest_m[:, 0] < -sleeve.wrist_distance_m, 0.005 + 0.0022 * folds)
    return ClothMesh(*shell, Material(color=sleeve.color, roughness=0.9, specular=0.1))


def strap_mesh(hand: PlacedHand, color: Rgb) -> SkinMesh:
    """Build a watch strap, 26 to 46 mm behind the wrist."""
    rest_x = hand.arm.refine(hand.skeleton.vertices_m, 2)[:, 0]
    shell = _offset_shell(hand, 2, (rest_x > -0.046) & (rest_x < -0.026), 0.0025)
    return _uniform_mesh(*shell, color, roughness=0.35)


def ring_mesh(hand: PlacedHand) -> SkinMesh:
    """Build a gold ring on the ring finger, 19 mm beyond the knuckle."""
    knuckle, direction = hand.skeleton.joints_m["finger-4-1"], hand.skeleton.directions["finger4-1"]
    bones = [hand.arm.bone_index("finger4-1"), hand.arm.bone_index("finger4-2")]
    on_finger = hand.arm.refine(hand.arm.weights, 3)[:, bones].sum(axis=1) > 0.6
    on_ring = np.abs((hand.arm.refine(hand.skeleton.vertices_m, 3) - knuckle) @ direction - 0.019) < 0.0026
    return _uniform_mesh(*_offset_shell(hand, 3, on_finger & on_ring, 0.0012), GOLD, roughness=0.22)


def _uniform_mesh(vertices_m: Array, quads: Quads, color: Rgb, roughness: float) -> SkinMesh:
    return SkinMesh(vertices_m, quads, np.tile(color, (len(vertices_m), 1)), np.full(len(vertices_m), roughness))


def _offset_shell(hand: PlacedHand, levels: int, selected: Mask, offset_m: Array | float) -> tuple[Array, Quads]:
    """Offset the ``selected`` (N,) vertices of the surface, refined ``levels`` times, by ``offset_m`` (scalar or (N,)).

    Returns:
        Vertices in the world frame and faces.
    """
    quads, surface = hand.arm.refined_quads(levels), hand.arm.refine(hand.posed_m, levels)
    moved = surface + vertex_normals(surface, quads) * np.broadcast_to(offset_m, len(surface))[:, None]
    kept, renumbered = np.unique(quads[selected[quads].all(axis=1)], return_inverse=True)
    return hand.to_world(moved[kept]), hand.outward_quads(renumbered.reshape(-1, 4))
