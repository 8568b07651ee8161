"""How often a search asks its segment test, and how often it is refused."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import kernel
from deltasafe.planning import answers_segments, segment_is_safe
from evidence.benchmarks.planner.problems import Problem

__all__ = ["segments_asked"]


class Counted(NamedTuple):
    """A test, and the numbers of segments asked and refused."""

    test: Any
    counts: NDArray[np.int64]


@answers_segments(Counted)
@kernel
def _segment(counted, start, end):  # type: ignore[no-untyped-def]
    passed = segment_is_safe(counted.test, start, end)
    counted.counts[0] += 1
    counted.counts[1] += not passed
    return passed


def segments_asked(problem: Problem, iterations: int, repeats: int) -> dict[str, float]:
    """Means over searches: segments asked (points among them), and the share refused."""
    counted = Counted(problem.test("sampled"), np.zeros(2, np.int64))
    for seed in range(repeats):
        problem.iterations(counted, iterations, seed)
    asked, refused = counted.counts.tolist()
    return {"asked": asked / repeats, "refused_share": refused / asked}
