"""Distance from the convex parts of a body to the unsafe voxels, exact but for rounding: the last resort of a test.

Voxels above each other are one box. The distance of a box and a part follows from alternating projections (Cheney and
Goldstein 1959); each step also gives a lower bound, the gap between both along the direction that joins the points.
"""

import math

import numpy as np

from deltasafe.compute.numba_cache import inlined, kernel

DISC, BOX, SEGMENT = 0.0, 1.0, 2.0
"""Codes of the core of a part, as in ``ToolPart.params``."""

MAX_PROJECTIONS = 60
TOLERANCE_M = 2e-6
"""Gap between distance and lower bound at which projections end; the lower bound is returned."""

BESIDE_M = 4000.0
"""The unsafe space beside the grid begins in its outermost voxels and is as wide as this; poses lie within 1000 m."""


@kernel
def exact_clearance(arrays, body, pose, least_m, most_m):  # type: ignore[no-untyped-def]
    """Lower bound of the clearance of a body, capped at ``most_m``; -inf if it is less than ``least_m``."""
    x, y, z, yaw = pose
    clearance_m = min(most_m, z - body.half_thickness_m - arrays.table_z_m)
    cos, sin = math.cos(yaw), math.sin(yaw)
    for n in range(len(arrays.parts)):
        if clearance_m < least_m:
            return -np.inf
        part = arrays.parts[n]
        center = x + cos * part[1] - sin * part[2], y + sin * part[1] + cos * part[2], z + part[3]
        if part[0] == SEGMENT:
            core = cos * part[4] - sin * part[5], sin * part[4] + cos * part[5], part[6]
            turn = 1.0, 0.0
        else:
            core = part[4], part[5], part[6]
            turn = cos * part[7] - sin * part[8], sin * part[7] + cos * part[8]
        shape = part[0], center, core, turn
        clearance_m = _to_voxels(arrays, shape, part[9], least_m, clearance_m)
    return clearance_m if clearance_m >= least_m else -np.inf


@kernel
def _to_voxels(arrays, shape, radius_m, least_m, most_m):  # type: ignore[no-untyped-def]
    """The same for one part, a core (kind, center, half sizes, turn) grown by ``radius_m``."""
    lattice, bits = arrays.lattice, arrays.unsafe_bits
    (x, y, z), reach_m, per_m, size = shape[1], most_m + radius_m, lattice.per_m, lattice.voxel_m
    width_m, depth_m = _support(shape, 1.0, 0.0, 0.0) + reach_m, _support(shape, 0.0, 1.0, 0.0) + reach_m
    height_m = _support(shape, 0.0, 0.0, 1.0) + reach_m
    u, v, w = x - lattice.lower_x_m, y - lattice.lower_y_m, z - lattice.lower_z_m
    first_i, last_i = _voxel(u - width_m, per_m, lattice.nx), _voxel(u + width_m, per_m, lattice.nx)
    first_j, last_j = _voxel(v - depth_m, per_m, lattice.ny), _voxel(v + depth_m, per_m, lattice.ny)
    first_k, last_k = _voxel(w - height_m, per_m, lattice.nz), _voxel(w + height_m, per_m, lattice.nz)
    for i in range(first_i, last_i + 1):
        low_x = i * size if i > 0 else -BESIDE_M
        high_x = (i + 1) * size if i < lattice.nx - 1 else BESIDE_M
        for j in range(first_j, last_j + 1):
            low_y = j * size if j > 0 else -BESIDE_M
            high_y = (j + 1) * size if j < lattice.ny - 1 else BESIDE_M
            k = first_k
            while k <= last_k:
                word = bits[i, j, k >> 5] >> (k & 31)
                if word == 0:  # no further unsafe voxel in this word
                    k = (k | 31) + 1
                    continue
                if word & 1 == 0:
                    k += 1
                    continue
                begin = k
                while k <= last_k and (bits[i, j, k >> 5] >> (k & 31)) & 1 == 1:
                    k += 1
                low_z = begin * size if begin > 0 else -BESIDE_M
                low = lattice.lower_x_m + low_x, lattice.lower_y_m + low_y, lattice.lower_z_m + low_z
                high = lattice.lower_x_m + high_x, lattice.lower_y_m + high_y, lattice.lower_z_m + k * size
                most_m = _to_box(shape, low, high, least_m + radius_m, most_m + radius_m) - radius_m
                if most_m < least_m:
                    return -np.inf
    return most_m


@inlined
def _voxel(offset_m, per_m, count):  # type: ignore[no-untyped-def]
    return int(min(max(offset_m * per_m, 0.0), count - 1.0))


@kernel
def _to_box(shape, low, high, least_m, most_m):  # type: ignore[no-untyped-def]
    """Lower bound of the distance of a core to a box, capped at ``most_m``; less than ``least_m`` ends the search."""
    x, y, z = shape[1]
    bound_m, px, py, pz = -np.inf, x, y, z
    for _ in range(MAX_PROJECTIONS):
        qx = min(max(px, low[0]), high[0])
        qy = min(max(py, low[1]), high[1])
        qz = min(max(pz, low[2]), high[2])
        dx, dy, dz = qx - px, qy - py, qz - pz
        gap_m = math.sqrt(dx * dx + dy * dy + dz * dz)
        if gap_m < 1e-9:
            return -np.inf  # the first point is the center, which may lie in the box
        dx, dy, dz = dx / gap_m, dy / gap_m, dz / gap_m
        # the box begins at its corner against the direction, the core ends at its support
        bx, by, bz = low[0] if dx > 0 else high[0], low[1] if dy > 0 else high[1], low[2] if dz > 0 else high[2]
        along_m = dx * (bx - x) + dy * (by - y) + dz * (bz - z) - _support(shape, dx, dy, dz)
        bound_m = max(bound_m, along_m)
        if bound_m >= most_m:
            return most_m
        px, py, pz = _nearest(shape, qx, qy, qz)
        dx, dy, dz = qx - px, qy - py, qz - pz
        gap_m = math.sqrt(dx * dx + dy * dy + dz * dz)
        if gap_m < least_m or gap_m - bound_m <= TOLERANCE_M:
            break
    return min(bound_m, most_m)


@inlined
def _support(shape, dx, dy, dz):  # type: ignore[no-untyped-def]
    """How far the core extends from its center along a unit vector."""
    kind, _, (a, b, c), (cos, sin) = shape
    if kind == SEGMENT:
        return abs(dx * a + dy * b + dz * c)
    u, v = cos * dx + sin * dy, cos * dy - sin * dx
    if kind == BOX:
        return a * abs(u) + b * abs(v) + c * abs(dz)
    return math.sqrt(a * a * u * u + b * b * v * v) + c * abs(dz)


@inlined
def _nearest(shape, x, y, z):  # type: ignore[no-untyped-def]
    """Return the point of the core nearest to a point."""
    kind, center, (a, b, c), (cos, sin) = shape
    x, y, z = x - center[0], y - center[1], z - center[2]
    if kind == SEGMENT:
        along = (x * a + y * b + z * c) / max(a * a + b * b + c * c, 1e-300)
        along = min(max(along, -1.0), 1.0)
        return center[0] + along * a, center[1] + along * b, center[2] + along * c
    u, v = cos * x + sin * y, cos * y - sin * x
    if kind == BOX:
        u, v = min(max(u, -a), a), min(max(v, -b), b)
    else:
        u, v = _on_ellipse(u, v, a, b)
    return center[0] + cos * u - sin * v, center[1] + sin * u + cos * v, center[2] + min(max(z, -c), c)


@inlined
def _on_ellipse(u, v, a, b):  # type: ignore[no-untyped-def]
    """Return the point of an ellipse nearest to (u, v); Newton's method on a convex decreasing function."""
    if (u / a) * (u / a) + (v / b) * (v / b) <= 1.0:
        return u, v
    p, q = a * abs(u), b * abs(v)
    t = max(p - a * a, q - b * b, 0.0)
    for _ in range(30):
        r, s = p / (t + a * a), q / (t + b * b)
        excess = r * r + s * s - 1.0
        if excess <= 1e-13:
            break
        t += 0.5 * excess / (r * r / (t + a * a) + s * s / (t + b * b))
    r, s = p / (t + a * a), q / (t + b * b)
    scale = 1.0 / math.sqrt(r * r + s * s)  # onto the ellipse, whatever the rounding
    return math.copysign(a * r * scale, u), math.copysign(b * s * scale, v)
