"""Fingernails: a super-ellipse fitted to the model's nail area, with lunula, free edge or polish."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from generator.noise import smoothstep
from generator.skeleton import DIGITS
from generator.skin.palette import linear
from generator.skin.regions import Regions

__all__ = ["Nails", "nails"]

Array = NDArray[np.float64]
BED, LUNULA, FREE_EDGE = linear((236, 184, 170)), linear((244, 222, 212)), linear((238, 226, 214))


@dataclasses.dataclass(frozen=True)
class Nails:
    """At V vertices: the share of nail (V,), its albedo (V, 3), the fold around it (V,)."""

    share: Array
    albedo: Array
    fold: Array


def nails(regions: Regions, base: Array, dark: float, polish: tuple[int, int, int] | None) -> Nails:
    """All five nails, for skin of albedo ``base`` (3,) and darkness ``dark``, painted in sRGB ``polish`` or bare."""
    n = len(regions.points_mm)
    share, albedo, fold = np.zeros(n), np.tile(base, (n, 1)), np.zeros(n)
    for digit in DIGITS:
        bone = f"finger{digit}-3"
        upward = regions.normals @ regions.backs[bone]
        u, v = _nail_coordinates(regions, bone, (regions.nails > 0.5) & (regions.bone_share[bone] > 0.5) & (upward > 0))
        on_finger = (regions.finger_share[digit] > 0.5) & (upward > 0.05)
        radius = (np.abs(u) ** 3 + np.abs(v) ** 3) ** (1 / 3) * np.where(u < 0, 1.04, 1.0)
        here = smoothstep(1.05, 0.93, radius) * on_finger
        colour = _bare(0.5 + 0.5 * u, v, base, dark) if polish is None else np.tile(linear(polish), (n, 1))
        albedo = np.where((here > share)[:, None], colour, albedo)
        share = np.maximum(share, here)
        fold = fold + np.exp(-(((radius - 1.02) / 0.07) ** 2)) * on_finger
    return Nails(share, albedo, fold)


def _nail_coordinates(regions: Regions, bone: str, area: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Along and across the nail, -1 to 1 over its area; u grows towards the tip."""
    points, along = regions.points_mm, regions.along[bone]
    across = np.cross(regions.backs[bone], along)
    u, v = points @ along, points @ across
    u0, u1 = np.percentile(u[area], [2, 99])
    v0, v1 = np.percentile(v[area], [2, 98])
    return (2 * u - u0 - u1) / (u1 - u0), (2 * v - v0 - v1) / (v1 - v0)


def _bare(place: Array, across: Array, base: Array, dark: float) -> Array:
    lunula = 0.35 * smoothstep(0.26, 0.06, place - 0.12 * across**2)[:, None]
    free = 0.6 * smoothstep(0.86, 0.93, place)[:, None]
    colour = 0.35 * base + 0.65 * (1 - 0.35 * dark) * BED
    colour = colour * (1 - lunula) + LUNULA * lunula
    return np.asarray(colour * (1 - free) + FREE_EDGE * free)
