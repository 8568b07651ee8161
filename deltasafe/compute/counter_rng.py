"""Counter-based random numbers (splitmix64): a draw depends on its key and counter alone, not on earlier draws."""

import math

import numpy as np

from deltasafe.compute.numba_cache import kernel


@kernel
def splitmix64(key, counter):  # type: ignore[no-untyped-def]
    """Return 64 random bits for a key (uint64) and a counter: state increment and finalizer of splitmix64."""
    bits = key + np.uint64(counter) * np.uint64(0x9E3779B97F4A7C15)
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


@kernel
def uniform(key, counter):  # type: ignore[no-untyped-def]
    """Draw from the uniform distribution on [0, 1)."""
    return float(splitmix64(key, counter) >> np.uint64(11)) * (1.0 / 9007199254740992.0)


@kernel
def normal_pair(key, counter):  # type: ignore[no-untyped-def]
    """Draw two independent standard normal numbers (Box and Muller 1958); uses ``counter`` and ``counter + 1``."""
    radius = math.sqrt(-2.0 * math.log(1.0 - uniform(key, counter)))
    angle = 2.0 * math.pi * uniform(key, counter + 1)
    return radius * math.cos(angle), radius * math.sin(angle)


@kernel
def segment_key(seed, start, end):  # type: ignore[no-untyped-def]
    """Hash a seed (uint64) and the two poses of a segment (4 numbers each, rounded to 1e-9) to a key."""
    key = splitmix64(seed, 1)
    for axis in range(4):
        key = splitmix64(key ^ np.uint64(np.int64(start[axis] * 1e9)), 1)
        key = splitmix64(key ^ np.uint64(np.int64(end[axis] * 1e9)), 1)
    return key
