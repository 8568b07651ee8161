"""Light from all around without a download: a room with windows, an open sky, a studio, as (H, W, 3) radiance."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from generator.noise import fractal_noise, smoothstep
from generator.surface_mesh import unit

__all__ = ["MAPS", "procedural_map"]

Array = NDArray[np.float64]
HEIGHT, WIDTH = 256, 512
# grass, asphalt, sand, earth, concrete
GROUNDS = np.array([(0.07, 0.14, 0.03), (0.06, 0.06, 0.06), (0.34, 0.25, 0.15), (0.14, 0.08, 0.04), (0.25, 0.24, 0.22)])


def _directions() -> Array:
    """(H * W, 3) unit vectors, z up; row 0 looks to the zenith."""
    polar = np.pi * (np.arange(HEIGHT) + 0.5) / HEIGHT
    azimuth = 2 * np.pi * (np.arange(WIDTH) + 0.5) / WIDTH
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    axes = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    return np.stack(axes, axis=-1).reshape(-1, 3)


def _room(look: Array, rng: np.random.Generator) -> Array:
    """A box seen from inside: coloured walls with pictures, a floor, lit windows in one wall, lamps in the ceiling."""
    half, seed = np.array([*rng.uniform(1.8, 4.0, 2), 1.3]), int(rng.integers(1 << 20))
    walls, floor = (
        rng.uniform(0.15, 0.75, 3) * 0.3 + rng.uniform(0.2, 0.6),
        rng.uniform(0.05, 0.4) * np.array([1, 0.75, 0.5]),
    )
    reach = half / np.maximum(np.abs(look), 1e-9)
    axis = np.argmin(reach, axis=1)
    point = look * reach.min(axis=1, keepdims=True)
    across = np.where(axis == 0, point[:, 1], point[:, 0])
    height = point[:, 2]
    radiance = np.tile(walls, (len(look), 1)) * (0.8 + 0.2 * height / half[2])[:, None]
    for _ in range(8):  # pictures, shelves, doors
        side, sign = rng.integers(2), rng.choice([-1.0, 1.0])
        middle, low, wide, high = rng.uniform(-2.5, 2.5), rng.uniform(-1.3, 0.2), *rng.uniform(0.2, 0.9, 2)
        inside = (axis == side) & (np.sign(point[:, side]) == sign) & (np.abs(across - middle) < wide)
        inside &= (height > low) & (height < low + high)
        radiance[inside] = rng.uniform(0.02, 0.6, 3)
    down = axis == 2
    boards = (1 + 0.25 * fractal_noise(point * [9, 1.2, 1], seed))[:, None]
    radiance = np.where((down & (height < 0))[:, None], floor * boards, radiance)
    radiance = np.where((down & (height > 0))[:, None], 0.55, radiance)
    window = (axis == 0) & (point[:, 0] > 0) & (np.abs(height - 0.15) < 0.75) & (np.abs(across) < 1.3)
    bars = (np.abs(across % 0.65) < 0.05) | (np.abs(height % 0.6) < 0.04)
    radiance[window & ~bars] = rng.uniform(4, 12) * np.array([0.9, 1.0, 1.1])
    lamp = down & (height > 0) & (np.abs(point[:, 0] % 1.6 - 0.8) < 0.25) & (np.abs(point[:, 1] % 1.6 - 0.8) < 0.25)
    radiance[lamp] = rng.uniform(3, 15) * np.array([1.0, 0.9, 0.75])
    return radiance * (1 + 0.05 * fractal_noise(look * 9, seed + 3))[:, None]


def _outside(look: Array, rng: np.random.Generator) -> Array:
    """Sky with clouds and a sun, ground, and a horizon of hills or trees."""
    seed, up = int(rng.integers(1 << 20)), look[:, 2]
    sun = unit(np.array([*rng.normal(0, 1, 2), rng.uniform(0.1, 1.2)]))
    blue, warm = np.array([0.25, 0.5, 1.0]), np.array([1.0, 0.75, 0.5])
    haze = np.exp(-np.maximum(up, 0) * 4)[:, None]
    sky = blue * rng.uniform(0.4, 1) * (1 - haze) + rng.uniform(0.6, 1.2) * (0.6 + 0.4 * warm) * haze
    clouds = smoothstep(
        0.0, 0.5, fractal_noise(look / np.maximum(up, 0.08)[:, None] * 1.3, seed, 5) + rng.uniform(-0.3, 0.3)
    )
    sky = sky * (1 - 0.8 * clouds[:, None]) + 0.85 * clouds[:, None]
    near_sun = look @ sun
    sky += (3 * np.exp((near_sun - 1) * 40) + rng.uniform(200, 2000) * (near_sun > 0.9995))[:, None] * warm
    ground = GROUNDS[rng.integers(len(GROUNDS))] * rng.uniform(0.6, 1.4)
    patches = 1 + 0.6 * fractal_noise(look / np.maximum(-up, 0.03)[:, None] * 2, seed + 9, 5)
    soil = ground * np.maximum(patches, 0.1)[:, None]
    flat = np.column_stack([look[:, :2] * 6, np.zeros(len(look))])
    skyline = 0.02 + 0.13 * np.maximum(fractal_noise(flat, seed + 4, 6), 0)
    leaves = 1 + 0.7 * fractal_noise(look * 40, seed + 6, 4)[:, None]
    trees = rng.uniform((0.02, 0.04, 0.01), (0.08, 0.12, 0.05)) * leaves
    return np.where((up < 0)[:, None], soil, np.where((up < skyline)[:, None], np.maximum(trees, 0.01), sky))


def _studio(look: Array, rng: np.random.Generator) -> Array:
    """A dark hall with three soft boxes."""
    seed = int(rng.integers(1 << 20))
    radiance = np.tile(rng.uniform(0.04, 0.25), (len(look), 3)) * (1 + 0.3 * fractal_noise(look * 3, seed))[:, None]
    for _ in range(3):
        towards = unit(np.array([*rng.normal(0, 1, 2), rng.uniform(0.2, 1.5)]))
        side = unit(np.cross(towards, [0.1, 0.2, 1.0]))
        x, y, ahead = look @ side, look @ np.cross(side, towards), look @ towards
        lit = (ahead > 0) & (np.abs(x) < 0.25 * ahead) & (np.abs(y) < 0.18 * ahead)
        radiance[lit] = rng.uniform(5, 20) * np.array([1.0, 0.97, 0.92])
    return radiance


MAPS: dict[str, Callable[[Array, np.random.Generator], Array]] = {
    "room": _room,
    "outside": _outside,
    "studio": _studio,
}


def procedural_map(kind: str, seed: int) -> NDArray[np.float32]:
    """(256, 512, 3) radiance of a kind in ``MAPS``."""
    radiance = MAPS[kind](_directions(), np.random.default_rng(seed))
    return np.maximum(radiance, 1e-4).reshape(HEIGHT, WIDTH, 3).astype(np.float32)
