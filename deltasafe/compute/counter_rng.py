"""Counter-based random numbers: a draw is a function of its key alone, whatever was drawn before it."""

import math

import numpy as np

from deltasafe.compute.numba_cache import kernel

__all__ = ["key_of_segment", "mixed", "normal_pair", "uniform"]


@kernel
def mixed(key, counter):  # type: ignore[no-untyped-def]
    """64 random bits of a key (uint64) and a counter: the finaliser of splitmix64, once for each key."""
    bits = key + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@kernel
def uniform(key, counter):  # type: ignore[no-untyped-def]
    """Number in [0, 1) of a key and a counter."""
    return float(mixed(key, counter) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@kernel
def normal_pair(key, counter):  # type: ignore[no-untyped-def]
    """Two independent standard normal numbers of a key and a counter, which must be even (Box and Muller 1958)."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(key, counter)))
    angle = 2.0 * math.pi * uniform(key, counter + 1)
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def key_of_segment(seed, start, end):  # type: ignore[no-untyped-def]
    """Key of the segment between two poses (4 numbers each) under a seed (uint64), to the nanometer."""
    key = mixed(seed, 1)
    for axis in range(4):
        key = mixed(key ^ np.uint64(np.int64(start[axis] * 1e9)), 1)
        key = mixed(key ^ np.uint64(np.int64(end[axis] * 1e9)), 1)
    return key
