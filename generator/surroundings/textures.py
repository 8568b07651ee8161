"""Procedural textures: plain, wood, stone, woven fabric, tiles."""

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike

from generator.aliases import Array
from generator.noise import fractal_noise, smoothstep, value_noise

SIZE = 256


def _grid() -> Array:
    rows, columns = np.mgrid[:SIZE, :SIZE]
    return np.column_stack([rows.ravel(), columns.ravel(), np.zeros(SIZE * SIZE)]).astype(float)


def _plain(points: Array, seed: int) -> Array:
    return 1 + 0.035 * fractal_noise(points / 60, seed, 4) + 0.02 * value_noise(points * [0.12, 1.1, 1], seed + 7)


def _wood(points: Array, seed: int) -> Array:
    distorted = points[:, 0] / 9 + 2.5 * fractal_noise(points * [0.02, 0.006, 1], seed, 3)
    rings = 0.5 + 0.5 * np.sin(2 * np.pi * distorted)
    pores = value_noise(points * [0.7, 0.03, 1], seed + 5)
    return 0.72 + 0.25 * rings + 0.12 * pores


def _stone(points: Array, seed: int) -> Array:
    skewed = points @ np.array([[0.8, 0.5, 0.3], [-0.5, 0.7, -0.4], [0, 0, 1]])  # a skewed lattice is less visible
    grains = smoothstep(-0.25, 0.25, fractal_noise(skewed / 5, seed)) * smoothstep(
        -0.5, 0.2, value_noise(skewed / 11, seed + 1)
    )
    return 0.45 + 0.5 * grains + 0.15 * fractal_noise(points / 30, seed + 2)


def _woven(points: Array, seed: int) -> Array:
    threads = np.sin(points[:, 0] * 0.7) * np.sin(points[:, 1] * 0.7)
    return 0.8 + 0.18 * threads + 0.08 * fractal_noise(points / 20, seed) + 0.06 * value_noise(points, seed + 3)


def _tiles(points: Array, seed: int) -> Array:
    size = 48
    joint = np.minimum(points[:, 0] % size, points[:, 1] % size)
    tile_shade = value_noise(np.floor(points / size) * 7.3 + 0.5, seed)
    return (0.85 + 0.12 * tile_shade + 0.05 * fractal_noise(points / 15, seed)) * (
        0.45 + 0.55 * smoothstep(0.5, 2, joint)
    )


TEXTURES: dict[str, Callable[[Array, int], Array]] = {
    "plain": _plain,
    "wood": _wood,
    "stone": _stone,
    "woven": _woven,
    "tiles": _tiles,
}


def procedural_texture(kind: str, color: ArrayLike, seed: int) -> Array:
    """Return a linear texture (256, 256, 3) of a kind in ``TEXTURES``, varied around a linear color (3,)."""
    shade = TEXTURES[kind](_grid(), seed).reshape(SIZE, SIZE, 1)
    return np.clip(np.asarray(color) * shade, 0.005, 0.95)
