"""Count how many segments a search tests, and how many of them are refused."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import kernel
from deltasafe.planning import register_segment_test, segment_is_safe
from evidence.benchmarks.planner.problems import Problem


class Counted(NamedTuple):
    """A segment test with the numbers of tested and refused segments."""

    test: Any
    counts: NDArray[np.int64]


@register_segment_test(Counted)
@kernel
def _segment(counted, start, end):  # type: ignore[no-untyped-def]
    passed = segment_is_safe(counted.test, start, end)
    counted.counts[0] += 1
    counted.counts[1] += not passed
    return passed


def segment_counts(problem: Problem, iterations: int, repeats: int) -> dict[str, float]:
    """Return the mean number of tested segments (points included) per search, and the fraction refused."""
    counted = Counted(problem.test("sampled"), np.zeros(2, np.int64))
    for seed in range(repeats):
        problem.iterations(counted, iterations, seed)
    tested, refused = counted.counts.tolist()
    return {"asked": tested / repeats, "refused_share": refused / tested}
