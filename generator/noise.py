"""Value noise with a seed, and the splines and distances from which skin creases and veins are built."""

import numpy as np
from numpy.typing import NDArray

from generator.aliases import Array

HASH_PRIMES = (374761393, 668265263, 1274126177)
SEED_FACTOR = 362437
UINT32_MAX = 0xFFFFFFFF
POINTS_PER_SEGMENT = 6


def smoothstep(start: float, end: float, x: Array) -> Array:
    """Interpolate from 0 at ``start`` to 1 at ``end`` with a cubic; ``start`` may be greater than ``end``."""
    t = np.clip((x - start) / (end - start), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def value_noise(points: Array, seed: int = 0) -> Array:
    """Return smooth noise (N,) in [-1, 1] at points (N, 3); features are about one unit wide."""
    cell = np.floor(points)
    local = points - cell
    local = (local**3 * (local * (local * 6 - 15) + 10)).T
    weights = (1 - local, local)
    x, y, z = cell.astype(np.int64).T
    origin = x * HASH_PRIMES[0] + y * HASH_PRIMES[1] + z * HASH_PRIMES[2] + seed * SEED_FACTOR
    total = np.zeros(len(points))
    for i, j, k in np.ndindex(2, 2, 2):
        offset = i * HASH_PRIMES[0] + j * HASH_PRIMES[1] + k * HASH_PRIMES[2]
        total += weights[i][0] * weights[j][1] * weights[k][2] * _hash_to_unit_range(origin + offset)
    return total


def fractal_noise(points: Array, seed: int = 0, octaves: int = 3) -> Array:
    """Sum ``octaves`` of value noise (N,) in [-1, 1]; each octave has twice the frequency and half the amplitude."""
    amplitudes = 0.5 ** np.arange(octaves)
    layers = (value_noise(points * 2.0**k + 17.3 * k, seed + k) for k in range(octaves))
    return np.asarray(sum(a * layer for a, layer in zip(amplitudes, layers, strict=True)) / amplitudes.sum())


def distance_to_polyline(points: Array, line: Array) -> tuple[Array, Array]:
    """Return the distance (N,) of points (N, 2) to a polyline (K, 2), and the line parameter (N,) in [0, 1]."""
    distance, parameter, n_segments = np.full(len(points), np.inf), np.zeros(len(points)), len(line) - 1
    for k in range(n_segments):
        segment = line[k + 1] - line[k]
        t = np.clip((points - line[k]) @ segment / (segment @ segment), 0, 1)
        segment_distance = np.hypot(*(points - line[k] - t[:, None] * segment).T)
        nearer = segment_distance < distance
        distance[nearer], parameter[nearer] = segment_distance[nearer], ((k + t) / n_segments)[nearer]
    return distance, parameter


def catmull_rom(knots: Array) -> Array:
    """Sample the Catmull-Rom spline through ``knots`` (K, 2), both ends included."""
    padded = np.concatenate([[2 * knots[0] - knots[1]], knots, [2 * knots[-1] - knots[-2]]])
    t = np.linspace(0, 1, POINTS_PER_SEGMENT, endpoint=False)[:, None]
    segments = [
        0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
        for a, b, c, d in zip(padded, padded[1:], padded[2:], padded[3:], strict=False)
    ]
    return np.concatenate([*segments, knots[-1:]])


def _hash_to_unit_range(key: NDArray[np.int64]) -> Array:
    """Hash integers (N,) to numbers in [-1, 1]; integer arithmetic gives the same result on every machine."""
    mixed = key & UINT32_MAX
    mixed = ((mixed ^ (mixed >> 13)) * HASH_PRIMES[2]) & UINT32_MAX
    return np.asarray(((mixed ^ (mixed >> 16)) & 0xFFFF) / 32767.5 - 1)
