"""Value noise on a lattice: smooth, seeded, the same on every machine; and the curves that creases and veins follow."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["catmull_rom", "distance_to_polyline", "fractal_noise", "smoothstep", "value_noise"]

Array = NDArray[np.float64]
PRIMES = (374761393, 668265263, 1274126177)
MASK = 0xFFFFFFFF


def smoothstep(start: float, end: float, x: Array) -> Array:
    """0 before ``start``, 1 after ``end``, cubic between them; ``start`` may be the larger one."""
    t = np.clip((x - start) / (end - start), 0, 1)
    return np.asarray(t * t * (3 - 2 * t))


def value_noise(points: Array, seed: int = 0) -> Array:
    """Noise (N,) in [-1, 1] at points (N, 3), with features about one unit wide."""
    cell = np.floor(points)
    local = points - cell
    local = (local**3 * (local * (local * 6 - 15) + 10)).T
    shares = (1 - local, local)
    x, y, z = cell.astype(np.int64).T
    origin = x * PRIMES[0] + y * PRIMES[1] + z * PRIMES[2] + seed * 362437
    total = np.zeros(len(points))
    for i, j, k in np.ndindex(2, 2, 2):
        offset = i * PRIMES[0] + j * PRIMES[1] + k * PRIMES[2]
        total += shares[i][0] * shares[j][1] * shares[k][2] * _hashed(origin + offset)
    return total


def fractal_noise(points: Array, seed: int = 0, octaves: int = 3) -> Array:
    """Sum of ``octaves`` noises (N,) in [-1, 1], each twice as fine and half as strong as the one before."""
    amplitudes = 0.5 ** np.arange(octaves)
    layers = (value_noise(points * 2.0**k + 17.3 * k, seed + k) for k in range(octaves))
    return np.asarray(sum(a * layer for a, layer in zip(amplitudes, layers, strict=True)) / amplitudes.sum())


def distance_to_polyline(points: Array, line: Array) -> tuple[Array, Array]:
    """Distance (N,) of points (N, 2) to a polyline (K, 2), and the place (N,) on it from 0 (start) to 1 (end)."""
    distance, place, pieces = np.full(len(points), np.inf), np.zeros(len(points)), len(line) - 1
    for k in range(pieces):
        along = line[k + 1] - line[k]
        t = np.clip((points - line[k]) @ along / (along @ along), 0, 1)
        away = np.hypot(*(points - line[k] - t[:, None] * along).T)
        nearer = away < distance
        distance[nearer], place[nearer] = away[nearer], ((k + t) / pieces)[nearer]
    return distance, place


def catmull_rom(knots: Array, per_piece: int = 6) -> Array:
    """Points of the Catmull-Rom spline through ``knots`` (K, 2), both ends included."""
    knots = np.asarray(knots, dtype=float)
    padded = np.concatenate([[2 * knots[0] - knots[1]], knots, [2 * knots[-1] - knots[-2]]])
    t = np.linspace(0, 1, per_piece, endpoint=False)[:, None]
    pieces = [
        0.5 * (2 * b + (c - a) * t + (2 * a - 5 * b + 4 * c - d) * t**2 + (3 * b - a - 3 * c + d) * t**3)
        for a, b, c, d in zip(padded, padded[1:], padded[2:], padded[3:], strict=False)
    ]
    return np.concatenate([*pieces, knots[-1:]])


def _hashed(key: NDArray[np.int64]) -> Array:
    mixed = key & MASK
    mixed = ((mixed ^ (mixed >> 13)) * 1274126177) & MASK
    return np.asarray(((mixed ^ (mixed >> 16)) & 0xFFFF) / 32767.5 - 1)
