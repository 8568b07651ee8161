"""A compared method inside what the camera sees: its own test of obstacles, and ours of table and border alone."""

from typing import NamedTuple

from deltasafe.compute.numba_cache import compiled
from deltasafe.planning.collision.segment_query import answers_segments, segment_is_safe
from deltasafe.planning.collision.segment_tests import SegmentTest
from deltasafe.studies.baselines.segment_tests import GaussianTest

__all__ = ["GaussianTestInView"]


class GaussianTestInView(NamedTuple):
    """Both tests must pass. ``seen`` is of a field in which only what the camera does not see is occupied."""

    obstacles: GaussianTest
    seen: SegmentTest


@answers_segments(GaussianTestInView)
@compiled
def _segment(test, start, end):  # type: ignore[no-untyped-def]
    return segment_is_safe(test.seen, start, end) and segment_is_safe(test.obstacles, start, end)
