"""Procedural environment maps: a room with windows, an outdoor sky, a studio, as (H, W, 3) radiance."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from generator.aliases import Array
from generator.noise import fractal_noise, smoothstep
from generator.surface_mesh import normalized

HEIGHT, WIDTH = 256, 512
# albedos of grass, asphalt, sand, earth, concrete
GROUNDS = np.array([(0.07, 0.14, 0.03), (0.06, 0.06, 0.06), (0.34, 0.25, 0.15), (0.14, 0.08, 0.04), (0.25, 0.24, 0.22)])


def _directions() -> Array:
    """Return (H * W, 3) unit vectors, z up; row 0 is next to the zenith."""
    polar = np.pi * (np.arange(HEIGHT) + 0.5) / HEIGHT
    azimuth = 2 * np.pi * (np.arange(WIDTH) + 0.5) / WIDTH
    polar, azimuth = np.meshgrid(polar, azimuth, indexing="ij")
    axes = [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)]
    return np.stack(axes, axis=-1).reshape(-1, 3)


def _room(directions: Array, rng: np.random.Generator) -> Array:
    """Render a box from inside: colored walls with pictures, a floor, bright windows in one wall, ceiling lamps."""
    half_size, seed = np.array([*rng.uniform(1.8, 4.0, 2), 1.3]), int(rng.integers(1 << 20))
    wall_color = rng.uniform(0.15, 0.75, 3) * 0.3 + rng.uniform(0.2, 0.6)
    floor_color = rng.uniform(0.05, 0.4) * np.array([1, 0.75, 0.5])
    distance = half_size / np.maximum(np.abs(directions), 1e-9)
    axis = np.argmin(distance, axis=1)
    point = directions * distance.min(axis=1, keepdims=True)
    across, height = np.where(axis == 0, point[:, 1], point[:, 0]), point[:, 2]
    radiance = np.tile(wall_color, (len(directions), 1)) * (0.8 + 0.2 * height / half_size[2])[:, None]
    for _ in range(8):  # pictures, shelves, doors
        wall_axis, sign = rng.integers(2), rng.choice([-1.0, 1.0])
        center, bottom = rng.uniform(-2.5, 2.5), rng.uniform(-1.3, 0.2)
        half_width, tall = rng.uniform(0.2, 0.9, 2)
        inside = (axis == wall_axis) & (np.sign(point[:, wall_axis]) == sign) & (np.abs(across - center) < half_width)
        inside &= (height > bottom) & (height < bottom + tall)
        radiance[inside] = rng.uniform(0.02, 0.6, 3)
    floor, ceiling = (axis == 2) & (height < 0), (axis == 2) & (height > 0)
    boards = (1 + 0.25 * fractal_noise(point * [9, 1.2, 1], seed))[:, None]
    radiance = np.where(floor[:, None], floor_color * boards, radiance)
    radiance[ceiling] = 0.55
    window = (axis == 0) & (point[:, 0] > 0) & (np.abs(height - 0.15) < 0.75) & (np.abs(across) < 1.3)
    bars = (np.abs(across % 0.65) < 0.05) | (np.abs(height % 0.6) < 0.04)
    radiance[window & ~bars] = rng.uniform(4, 12) * np.array([0.9, 1.0, 1.1])
    lamp = ceiling & (np.abs(point[:, :2] % 1.6 - 0.8) < 0.25).all(axis=1)
    radiance[lamp] = rng.uniform(3, 15) * np.array([1.0, 0.9, 0.75])
    return radiance * (1 + 0.05 * fractal_noise(directions * 9, seed + 3))[:, None]


def _outside(directions: Array, rng: np.random.Generator) -> Array:
    """Render a sky with clouds and a sun, ground, and a skyline of hills or trees."""
    seed, up = int(rng.integers(1 << 20)), directions[:, 2]
    sun = normalized(np.array([*rng.normal(0, 1, 2), rng.uniform(0.1, 1.2)]))
    blue, warm = np.array([0.25, 0.5, 1.0]), np.array([1.0, 0.75, 0.5])
    haze = np.exp(-np.maximum(up, 0) * 4)[:, None]
    sky = blue * rng.uniform(0.4, 1) * (1 - haze) + rng.uniform(0.6, 1.2) * (0.6 + 0.4 * warm) * haze
    cloud_noise = fractal_noise(directions / np.maximum(up, 0.08)[:, None] * 1.3, seed, 5)
    clouds = smoothstep(0.0, 0.5, cloud_noise + rng.uniform(-0.3, 0.3))[:, None]
    sky = sky * (1 - 0.8 * clouds) + 0.85 * clouds
    cos_to_sun = directions @ sun
    sky += (3 * np.exp((cos_to_sun - 1) * 40) + rng.uniform(200, 2000) * (cos_to_sun > 0.9995))[:, None] * warm
    ground = GROUNDS[rng.integers(len(GROUNDS))] * rng.uniform(0.6, 1.4)
    patches = 1 + 0.6 * fractal_noise(directions / np.maximum(-up, 0.03)[:, None] * 2, seed + 9, 5)
    ground = ground * np.maximum(patches, 0.1)[:, None]
    flat = np.column_stack([directions[:, :2] * 6, np.zeros(len(directions))])
    skyline = 0.02 + 0.13 * np.maximum(fractal_noise(flat, seed + 4, 6), 0)
    leaves = 1 + 0.7 * fractal_noise(directions * 40, seed + 6, 4)[:, None]
    trees = rng.uniform((0.02, 0.04, 0.01), (0.08, 0.12, 0.05)) * leaves
    return np.where((up < 0)[:, None], ground, np.where((up < skyline)[:, None], np.maximum(trees, 0.01), sky))


def _studio(directions: Array, rng: np.random.Generator) -> Array:
    """Render a dark hall with three softboxes."""
    seed = int(rng.integers(1 << 20))
    shading = 1 + 0.3 * fractal_noise(directions * 3, seed)
    radiance = rng.uniform(0.04, 0.25) * np.tile(shading[:, None], 3)
    for _ in range(3):
        axis = normalized(np.array([*rng.normal(0, 1, 2), rng.uniform(0.2, 1.5)]))
        right = normalized(np.cross(axis, [0.1, 0.2, 1.0]))
        x, y, depth = directions @ right, directions @ np.cross(right, axis), directions @ axis
        inside = (depth > 0) & (np.abs(x) < 0.25 * depth) & (np.abs(y) < 0.18 * depth)
        radiance[inside] = rng.uniform(5, 20) * np.array([1.0, 0.97, 0.92])
    return radiance


MAPS: dict[str, Callable[[Array, np.random.Generator], Array]] = {
    "room": _room,
    "outside": _outside,
    "studio": _studio,
}


def procedural_map(kind: str, seed: int) -> NDArray[np.float32]:
    """Return the radiance (256, 512, 3) of a random map of a kind in ``MAPS``."""
    radiance = MAPS[kind](_directions(), np.random.default_rng(seed))
    return np.maximum(radiance, 1e-4).reshape(HEIGHT, WIDTH, 3).astype(np.float32)
