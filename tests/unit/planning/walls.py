"""A constraint for tests of the search alone; a single type, since the search is compiled once per type."""

from typing import NamedTuple

from deltasafe.compute.numba_cache import compiled
from deltasafe.planning import register_segment_test


class Wall(NamedTuple):
    """Forbids poses with |x| < half, z < ``height`` and y < ``gap_y``."""

    half: float
    height: float
    gap_y: float


@register_segment_test(Wall)
@compiled
def passes(wall, start, end):  # type: ignore[no-untyped-def]
    for step in range(201):
        t = step / 200.0
        x, y, z = (1 - t) * start[0] + t * end[0], (1 - t) * start[1] + t * end[1], (1 - t) * start[2] + t * end[2]
        if abs(x) < wall.half and z < wall.height and y < wall.gap_y:
            return False
    return True
