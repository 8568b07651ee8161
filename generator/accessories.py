"""Things worn: sleeve, watch strap and ring, each a piece of the skin moved outwards."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from generator.arm import ArmModel
from generator.noise import fractal_noise, value_noise
from generator.recipe import Sleeve
from generator.skeleton import Skeleton
from generator.surface_mesh import vertex_normals

__all__ = ["offset_shell", "ring_shell", "sleeve_shell", "strap_shell"]

Array = NDArray[np.float64]
Quads = NDArray[np.int64]
Selection = Callable[[Array, Array], NDArray[np.bool_]]


def offset_shell(
    arm: ArmModel, rest_m: Array, posed_m: Array, levels: int, selection: Selection, outwards_m: Array | float
) -> tuple[Array, Quads]:
    """Vertices and faces of the part of the posed surface that ``selection`` picks, moved along its normals.

    Args:
        rest_m, posed_m: (V, 3) coarse mesh.
        levels: steps of refinement.
        selection: from rest positions (N, 3) and bone weights (N, B) of the refined mesh to (N,).
        outwards_m: one number, or (N,).
    """
    quads, surface = arm.refined_quads(levels), arm.refine(posed_m, levels)
    chosen = selection(arm.refine(rest_m, levels), arm.refine(arm.weights, levels))
    moved = surface + vertex_normals(surface, quads) * np.broadcast_to(outwards_m, len(surface))[:, None]
    kept, renumbered = np.unique(quads[chosen[quads].all(axis=1)], return_inverse=True)
    return moved[kept], renumbered.reshape(-1, 4)


def sleeve_shell(arm: ArmModel, skeleton: Skeleton, posed_m: Array, sleeve: Sleeve) -> tuple[Array, Quads]:
    """A sleeve with folds around the forearm."""
    rest_mm = arm.refine(skeleton.vertices_m, 2) * 1000
    period = np.random.default_rng(sleeve.seed).uniform(14, 30)
    phase = rest_mm[:, 0] + 9 * value_noise(rest_mm / 25, sleeve.seed)
    folds = np.sin(2 * np.pi * phase / period) + 1.2 * fractal_noise(rest_mm / 22, sleeve.seed + 1) + 0.9
    return offset_shell(
        arm, skeleton.vertices_m, posed_m, 2, lambda rest, _: rest[:, 0] < -sleeve.starts_m, 0.005 + 0.0022 * folds
    )


def strap_shell(arm: ArmModel, skeleton: Skeleton, posed_m: Array) -> tuple[Array, Quads]:
    """The strap of a watch, 26 to 46 mm behind the wrist."""
    return offset_shell(
        arm, skeleton.vertices_m, posed_m, 2, lambda rest, _: (rest[:, 0] > -0.046) & (rest[:, 0] < -0.026), 0.0025
    )


def ring_shell(arm: ArmModel, skeleton: Skeleton, posed_m: Array) -> tuple[Array, Quads]:
    """A ring on the ring finger, 19 mm beyond its knuckle."""
    knuckle, along = skeleton.joints_m["finger-4-1"], skeleton.directions["finger4-1"]
    bones = [arm.bone("finger4-1"), arm.bone("finger4-2")]

    def on_ring(rest: Array, weights: Array) -> NDArray[np.bool_]:
        on_finger = weights[:, bones].sum(axis=1) > 0.6
        return np.asarray(on_finger & (np.abs((rest - knuckle) @ along - 0.019) < 0.0026))

    return offset_shell(arm, skeleton.vertices_m, posed_m, 3, on_ring, 0.0012)
