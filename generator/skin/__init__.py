"""Skin as vertex attributes of the fine mesh: albedo, roughness and relief."""

import dataclasses

import numpy as np

from generator.aliases import Array
from generator.noise import fractal_noise, smoothstep, value_noise
from generator.person import Skin
from generator.pose import Pose
from generator.skin.folds import add_joint_folds, add_palm_lines, add_wrist_lines
from generator.skin.marks import Marks
from generator.skin.nails import compute_nails
from generator.skin.palette import palm_albedo, tone_albedo, tone_darkness
from generator.skin.regions import Regions
from generator.skin.veins_and_tendons import add_tendons, add_veins

__all__ = ["PaintedSkin", "Regions", "paint_skin"]


@dataclasses.dataclass(frozen=True)
class PaintedSkin:
    """Attributes at V vertices: linear albedo (V, 3), roughness (V,), relief (V,) along the normal in meters."""

    albedo: Array
    roughness: Array
    relief_m: Array


def paint_skin(regions: Regions, skin: Skin, pose: Pose) -> PaintedSkin:
    """Compute a person's skin; the pose matters because bending a joint flattens its wrinkles."""
    rng = np.random.default_rng(skin.seed)
    seed = int(rng.integers(1 << 20))
    darkness = tone_darkness(skin.tone)
    marks = Marks.none(len(regions.points_mm))
    add_joint_folds(marks, regions, pose, skin.wrinkles, darkness, seed)
    add_palm_lines(marks, regions, rng)
    add_wrist_lines(marks, regions, seed)
    add_veins(marks, regions, skin.veins, darkness, rng)
    add_tendons(marks, regions, pose, skin.wrinkles)
    _add_mottling(marks, regions, seed)
    _add_freckles_and_hair(marks, regions, skin, seed)

    dorsal_albedo, palmar = tone_albedo(skin.tone), regions.palmar[:, None]
    albedo = dorsal_albedo * (1 - palmar) + palm_albedo(skin.tone) * palmar
    redness = skin.redness * (1 - 0.55 * darkness)
    albedo = marks.apply_to(albedo, redness)
    nails = compute_nails(regions, dorsal_albedo, darkness, skin.nail_polish)
    weight = nails.weight[:, None]
    albedo = (albedo * (1 - weight) + nails.albedo * weight) * (1 - 0.3 * nails.fold[:, None])
    roughness = 0.47 + 0.06 * fractal_noise(regions.points_mm / 6, seed + 30, 2) - 0.06 * redness * marks.redness
    roughness = roughness - nails.weight * (0.2 if skin.nail_polish is None else 0.3)
    relief_mm = marks.relief_mm + 0.25 * nails.weight - 0.3 * nails.fold
    return PaintedSkin(np.clip(albedo, 0.003, 0.95), np.clip(roughness, 0.12, 0.7), relief_mm * 1e-3)


def _add_mottling(marks: Marks, regions: Regions, seed: int) -> None:
    points = regions.points_mm
    blotches = 0.25 * smoothstep(0.1, 0.6, fractal_noise(points / 22, seed + 5, 2)) * regions.hand_weight
    marks.add(regions.palmar * (0.25 + 0.25 * fractal_noise(points / 14, seed + 9)) + blotches, redness=1.0)
    grain = 0.055 * fractal_noise(points / 9, seed + 1) + 0.045 * value_noise(points / 1.6, seed + 2)
    marks.albedo_factor *= (1 + grain + 0.05 * value_noise(points / 0.8, seed + 7))[:, None]
    marks.absorb(-0.05 * fractal_noise(points / 18, seed + 4, 2), (1.0, 0.2, -0.6))
    pores = 0.05 * value_noise(points / 1.2, seed + 20) + 0.12 * fractal_noise(points / 7, seed + 21, 2)
    marks.add(pores, relief_mm=1.0)


def _add_freckles_and_hair(marks: Marks, regions: Regions, skin: Skin, seed: int) -> None:
    points, normals = regions.points_mm, regions.normals
    if skin.freckles:
        spots = smoothstep(0.55, 0.8, value_noise(points / 2.6, seed + 11)) * regions.dorsal
        marks.absorb(spots * skin.freckles, (0.18, 0.3, 0.34))
    if skin.hair:
        strands = points * [0.13, 1.1, 1.1] + 0.9 * value_noise(points / 12, seed + 14)[:, None]
        hair = smoothstep(0.35, 0.7, value_noise(strands, seed + 12))
        hair = hair * smoothstep(-0.2, 0.5, normals[:, 2] + 0.5 * normals[:, 1]) * smoothstep(25, -25, points[:, 0])
        marks.absorb(hair * skin.hair, (0.5, 0.5, 0.5))
