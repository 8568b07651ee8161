"""Fingernails: a superellipse fitted to the model's nail area, with lunula and free edge, or with polish."""

import dataclasses

import numpy as np

from generator.aliases import Array, Mask
from generator.noise import smoothstep
from generator.skeleton import DIGITS
from generator.skin.palette import srgb_to_linear
from generator.skin.regions import Regions

BED, LUNULA, FREE_EDGE = (srgb_to_linear(c) for c in ((236, 184, 170), (244, 222, 212), (238, 226, 214)))


@dataclasses.dataclass(frozen=True)
class Nails:
    """Attributes at V vertices: blend weight of the nail (V,), its albedo (V, 3), the nail fold around it (V,)."""

    weight: Array
    albedo: Array
    fold: Array


def compute_nails(regions: Regions, skin_albedo: Array, darkness: float, polish: tuple[int, int, int] | None) -> Nails:
    """Compute all five nails.

    Args:
        skin_albedo: (3,) albedo of the back of the hand.
        darkness: as of `tone_darkness`.
        polish: sRGB 0 to 255, or None for bare nails.
    """
    n_vertices = len(regions.points_mm)
    weight, albedo, fold = np.zeros(n_vertices), np.tile(skin_albedo, (n_vertices, 1)), np.zeros(n_vertices)
    for digit in DIGITS:
        bone = f"finger{digit}-3"
        dorsal = regions.normals @ regions.dorsal_directions[bone]
        u, v = _nail_coordinates(
            regions, bone, (regions.nails > 0.5) & (regions.bone_weights[bone] > 0.5) & (dorsal > 0)
        )
        on_digit = (regions.digit_weights[digit] > 0.5) & (dorsal > 0.05)
        radius = (np.abs(u) ** 3 + np.abs(v) ** 3) ** (1 / 3) * np.where(u < 0, 1.04, 1.0)
        digit_weight = smoothstep(1.05, 0.93, radius) * on_digit
        color = _bare_albedo(0.5 + 0.5 * u, v, skin_albedo, darkness) if polish is None else srgb_to_linear(polish)
        albedo = np.where((digit_weight > weight)[:, None], color, albedo)
        weight = np.maximum(weight, digit_weight)
        fold = fold + np.exp(-(((radius - 1.02) / 0.07) ** 2)) * on_digit
    return Nails(weight, albedo, fold)


def _nail_coordinates(regions: Regions, bone: str, area: Mask) -> tuple[Array, Array]:
    """Return coordinates along and across the nail, in [-1, 1] inside ``area``; u increases towards the tip."""
    points, along = regions.points_mm, regions.bone_directions[bone]
    u, v = points @ along, points @ np.cross(regions.dorsal_directions[bone], along)
    u0, u1 = np.percentile(u[area], [2, 99])
    v0, v1 = np.percentile(v[area], [2, 98])
    return (2 * u - u0 - u1) / (u1 - u0), (2 * v - v0 - v1) / (v1 - v0)


def _bare_albedo(length: Array, across: Array, skin_albedo: Array, darkness: float) -> Array:
    """Return the albedo (V, 3) of an unpainted nail; ``length`` is 0 at the root and 1 at the tip."""
    lunula = 0.35 * smoothstep(0.26, 0.06, length - 0.12 * across**2)[:, None]
    free_edge = 0.6 * smoothstep(0.86, 0.93, length)[:, None]
    color = 0.35 * skin_albedo + 0.65 * (1 - 0.35 * darkness) * BED
    color = color * (1 - lunula) + LUNULA * lunula
    return np.asarray(color * (1 - free_edge) + FREE_EDGE * free_edge)
