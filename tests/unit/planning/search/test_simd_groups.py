"""The LLVM intrinsics compared with pure Python, compiled for this CPU and for one without wide vectors."""

import json
import os
import pathlib
import platform
import subprocess
import sys

import numba
import numpy as np

from deltasafe.planning.search.neighbors import add_point, empty_neighbors, k_nearest, nearest
from deltasafe.planning.search.simd_groups import GROUP, UNROLLED, append_within, ctz, le_mask, popcount

ROOT = pathlib.Path(__file__).parents[4]


@numba.njit
def mask_of(values, begin, limit):  # type: ignore[no-untyped-def]
    return le_mask(values, begin, limit)


@numba.njit
def counts_of(bits):  # type: ignore[no-untyped-def]
    return popcount(bits), ctz(bits)


def words() -> list[int]:
    rng = np.random.default_rng(1)
    return [0, 1, 2**63, 2**64 - 1, *(int(word) for word in rng.integers(0, 2**63, 50))]


def groups() -> list[tuple[np.ndarray, int]]:
    """Float32 and int32 values with ties, infinities, NaN and extremes, and the place where a group begins."""
    rng = np.random.default_rng(0)
    specials = {
        np.float32: [0.0, -0.0, 0.25, 1.0, np.inf, -np.inf, np.nan, *rng.random(5)],
        np.int32: [0, 1, -1, 2**31 - 1, -(2**31), *rng.integers(-99, 99, 5)],
    }
    return [
        (rng.choice(values, 3 * GROUP).astype(dtype), int(rng.integers(0, GROUP + 1)))
        for _ in range(20)
        for dtype, values in specials.items()
    ]


def results() -> dict[str, list]:
    """Results of the compiled functions on fixed inputs, as JSON; the limit of a group is its sixth value."""
    masks, appended, near = [], [], []
    for values, begin in groups():
        masks.append(int(mask_of(values, begin, values[5])))
        indices, kept = np.zeros(GROUP + UNROLLED + 3, np.int32), np.zeros(GROUP + UNROLLED + 3, values.dtype)
        size = append_within(values, begin, values[5], indices, kept, 3)
        appended.append([*indices[3:size].tolist(), *kept[3:size].view(np.int32).tolist()])
    rng = np.random.default_rng(2)
    neighbors = empty_neighbors(300)
    for n, point in enumerate(rng.random((300, 4))):
        add_point(neighbors, n, tuple(point))
    for query in rng.random((20, 4)):
        near.append([float(value) for value in nearest(neighbors, 300, tuple(query))])
        size, squared = k_nearest(neighbors, 300, tuple(query), 7, 0.01, True)
        near.append([float(squared), *neighbors.found[:size].tolist()])
    counts = [[int(count) for count in counts_of(np.uint64(word))] for word in words()]
    return {"masks": masks, "appended": appended, "near": near, "counts": counts}


def test_intrinsics_equal_pure_python() -> None:
    found = results()
    for word, counts in zip(words(), found["counts"], strict=True):
        bits = f"{word:064b}"
        assert counts == [bits.count("1"), len(bits) - len(bits.rstrip("0"))]
    for (values, begin), mask, appended in zip(groups(), found["masks"], found["appended"], strict=True):
        hits = [n for n in range(begin, begin + GROUP) if values[n] <= values[5]]
        assert mask == sum(1 << (n - begin) for n in hits)
        assert appended == [*hits, *(int(values[n : n + 1].view(np.int32)[0]) for n in hits)]


def test_results_do_not_depend_on_the_vector_registers() -> None:
    """A subprocess compiles for the baseline of the architecture: on x86-64 without AVX, vectors of four lanes."""
    program = (
        "import json, tests.unit.planning.search.test_simd_groups as module; "
        "print(json.dumps([module.results(), *module.mask_of.inspect_asm().values()]))"
    )
    run = subprocess.run(
        [sys.executable, "-c", program],
        env=os.environ | {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
        cwd=ROOT,
        check=True,
        capture_output=True,
        text=True,
    )
    found, *assembly = json.loads(run.stdout)
    if platform.machine() == "x86_64":
        assert not any("ymm" in text or "zmm" in text for text in assembly)
    assert found == json.loads(json.dumps(results()))
