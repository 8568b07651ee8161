"""The surface on which a sampled function has a value, as triangles: marching tetrahedra."""

import numpy as np
from numpy.typing import NDArray

__all__ = ["isosurface"]

Array = NDArray[np.float64]

_CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)])
# six tetrahedra around the diagonal from corner 0 to corner 6; neighboring cubes cut their common face alike
_TETRAHEDRA = np.array([(0, 5, 1, 6), (0, 1, 2, 6), (0, 2, 3, 6), (0, 3, 7, 6), (0, 7, 4, 6), (0, 4, 5, 6)])


def isosurface(values: NDArray[np.floating], level: float) -> Array:
    """Triangles (n, 3, 3) in units of samples; samples above ``level`` are inside.

    Args:
        values: (nx, ny, nz), sample (i, j, k) at the point (i, j, k).
        level: of the surface.
    """
    values = np.asarray(values, dtype=np.float64)
    if min(values.shape) < 2:
        return np.empty((0, 3, 3))
    blocks = [values[_cut(values.shape, corner)] for corner in _CORNERS]
    above = np.stack([block > level for block in blocks])
    cells = np.argwhere(above.any(axis=0) & ~above.all(axis=0))
    if not len(cells):
        return np.empty((0, 3, 3))
    at = np.stack([block[tuple(cells.T)] for block in blocks], axis=1)
    value = at[:, _TETRAHEDRA].reshape(-1, 4)
    point = (cells[:, None] + _CORNERS)[:, _TETRAHEDRA].reshape(-1, 4, 3).astype(np.float64)
    order = np.argsort(value, axis=1)
    value = np.take_along_axis(value, order, axis=1)
    point = np.take_along_axis(point, order[:, :, None], axis=1)
    inside = (value > level).sum(axis=1)

    def crossing(chosen: NDArray[np.bool_], outer: int, inner: int) -> Array:
        low, high = value[chosen, outer], value[chosen, inner]
        share = ((level - low) / (high - low))[:, None]
        return np.asarray(point[chosen, outer] + share * (point[chosen, inner] - point[chosen, outer]))

    one, two, three = (inside == count for count in (1, 2, 3))
    corner = np.stack([crossing(one, n, 3) for n in (0, 1, 2)], axis=1)
    opposite = np.stack([crossing(three, 0, n) for n in (1, 2, 3)], axis=1)
    ring = [crossing(two, *edge) for edge in ((0, 2), (1, 2), (1, 3), (0, 3))]
    halves = [np.stack([ring[n] for n in half], axis=1) for half in ((0, 1, 2), (0, 2, 3))]
    return np.concatenate([corner, opposite, *halves])


def _cut(shape: tuple[int, ...], corner: NDArray[np.int64]) -> tuple[slice, ...]:
    return tuple(slice(offset, count - 1 + offset) for offset, count in zip(corner, shape, strict=True))
