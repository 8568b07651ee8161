"""A kd-tree that grows: leaves are buckets of 64 points, split at the mean of their widest side when full."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.search.simd_groups import GROUP, at_most, lowest_bit, measure, put_near

__all__ = ["BucketTree", "collect", "empty_buckets", "insert", "nearest_in"]

DEPTH = 256


class BucketTree(NamedTuple):
    """Nodes of a kd-tree in four dimensions, node 0 its root.

    Attributes:
        lowest, highest: (4 n,) coordinates of all points of a node.
        children: (n,) index of its first half, which the second follows; -1 in a leaf.
        split: (2, n) axis and place of the cut.
        filled: (n,) number of points of a leaf; ``filled[-1]`` counts the nodes.
        points, number: (n, 4, GROUP) and (n, GROUP) the points of a leaf, the places without one infinitely far, and
            their numbers.
        squared: distances in a leaf; the same memory as integers, ``bits``.
        stack, bound: nodes to be visited, and the smallest squared distance of their boxes.
        twice: (8,) the point that is asked for, twice; gaps: (8,) by which it lies beside two boxes, squared.
    """

    lowest: NDArray[np.float32]
    highest: NDArray[np.float32]
    children: NDArray[np.int32]
    split: NDArray[np.float32]
    filled: NDArray[np.int32]
    points: NDArray[np.float32]
    number: NDArray[np.int32]
    squared: NDArray[np.float32]
    bits: NDArray[np.int32]
    stack: NDArray[np.int32]
    bound: NDArray[np.float32]
    twice: NDArray[np.float32]
    gaps: NDArray[np.float32]


def empty_buckets(capacity: int) -> BucketTree:
    """Room for ``capacity`` points."""
    # a split leaves at least half of a bucket on each side, except among equal coordinates
    n, squared = 4 * (capacity // GROUP + 2), np.empty(2 * GROUP, np.float32)
    tree = BucketTree(
        np.full(4 * n, np.inf, np.float32),
        np.full(4 * n, -np.inf, np.float32),
        np.full(n, -1, np.int32),
        np.zeros((n, 2), np.float32),
        np.zeros(n + 1, np.int32),
        np.full((n, 4, GROUP), np.inf, np.float32),
        np.empty((n, GROUP), np.int32),
        squared,
        squared.view(np.int32),
        np.empty(DEPTH, np.int32),
        np.empty(DEPTH, np.float32),
        np.empty(8, np.float32),
        np.empty(8, np.float32),
    )
    tree.filled[-1] = 1
    return tree


@kernel
def insert(tree, number, x):  # type: ignore[no-untyped-def]
    """Add a point (a tuple of four float32) under a number."""
    node = 0
    while True:
        for axis in range(4):
            tree.lowest[4 * node + axis] = min(tree.lowest[4 * node + axis], x[axis])
            tree.highest[4 * node + axis] = max(tree.highest[4 * node + axis], x[axis])
        if tree.children[node] < 0:
            if tree.filled[node] < GROUP:
                break
            _halve(tree, node)
        upper = x[int(tree.split[node, 0])] > tree.split[node, 1]
        node = tree.children[node] + upper
    place = tree.filled[node]
    for axis in range(4):
        tree.points[node, axis, place] = x[axis]
    tree.number[node, place] = number
    tree.filled[node] += 1


@kernel
def _halve(tree, node):  # type: ignore[no-untyped-def]
    axis, widest = 0, np.float32(-1.0)
    for other in range(4):
        width = tree.highest[4 * node + other] - tree.lowest[4 * node + other]
        if width > widest:
            axis, widest = other, width
    lowest, highest = tree.lowest[4 * node + axis], tree.highest[4 * node + axis]
    cut = np.float32(0.0)
    for n in range(GROUP):
        cut += tree.points[node, axis, n] / np.float32(GROUP)
    if not lowest <= cut < highest:
        cut = lowest
    tree.split[node, 0], tree.split[node, 1] = axis, cut
    tree.children[node] = tree.filled[-1]
    tree.filled[-1] += 2
    for side in range(2):
        child, place = tree.children[node] + side, 0
        for n in range(GROUP):
            if (tree.points[node, axis, n] > cut) == (side == 1):
                for other in range(4):
                    value = tree.points[node, other, n]
                    tree.points[child, other, place] = value
                    tree.lowest[4 * child + other] = min(tree.lowest[4 * child + other], value)
                    tree.highest[4 * child + other] = max(tree.highest[4 * child + other], value)
                tree.number[child, place] = tree.number[node, n]
                place += 1
        tree.filled[child] = place


@inlined
def _begin(tree, x):  # type: ignore[no-untyped-def]
    """The root on the stack, and the point where two boxes are compared with it at once."""
    tree.stack[0], tree.bound[0] = 0, 0.0
    for axis in range(4):
        tree.twice[axis] = tree.twice[4 + axis] = x[axis]


@inlined
def _push_children(tree, first, top, within):  # type: ignore[no-untyped-def]
    """Both halves that may hold points within a squared distance, the nearer one on top."""
    lowest, highest = tree.lowest[4 * first : 4 * first + 8], tree.highest[4 * first : 4 * first + 8]
    twice, gaps = tree.twice, tree.gaps
    for n in range(8):
        gap = max(lowest[n] - twice[n], twice[n] - highest[n], np.float32(0.0))
        gaps[n] = gap * gap
    near, far, nearer = gaps[0] + gaps[1] + gaps[2] + gaps[3], gaps[4] + gaps[5] + gaps[6] + gaps[7], first
    if near > far:
        near, far, nearer = far, near, first + 1
    if far <= within:
        tree.stack[top], tree.bound[top] = 2 * first + 1 - nearer, far
        top += 1
    if near <= within:
        tree.stack[top], tree.bound[top] = nearer, near
        top += 1
    return top


@kernel
def nearest_in(tree, x):  # type: ignore[no-untyped-def]
    """Number of the nearest point, the lowest of equals, and its squared distance."""
    best, least = -1, np.float32(np.inf)
    _begin(tree, x)
    top = 1
    while top > 0:
        top -= 1
        node = tree.stack[top]
        if tree.bound[top] > least:
            continue
        if tree.children[node] >= 0:
            top = _push_children(tree, tree.children[node], top, least)
            continue
        measure(tree.points[node], GROUP, x, tree.squared)
        chosen = at_most(tree.squared, 0, least)
        while chosen:
            n = np.int64(lowest_bit(chosen))
            squared, number = tree.squared[n], np.int64(tree.number[node, n])
            if squared < least or (squared == least and number < best):
                best, least = number, squared
            chosen &= chosen - np.uint64(1)
    return best, least


@kernel
def collect(tree, x, within, found, gap):  # type: ignore[no-untyped-def]
    """All points within a squared distance into ``found`` and ``gap``; returns how many."""
    _begin(tree, x)
    top, m = 1, 0
    while top > 0:
        top -= 1
        node = tree.stack[top]
        if tree.children[node] >= 0:
            top = _push_children(tree, tree.children[node], top, within)
            continue
        measure(tree.points[node], GROUP, x, tree.squared)
        before, m = m, put_near(tree.squared, 0, within, found, gap, m)
        for n in range(before, m):
            found[n] = tree.number[node, found[n]]
    return m
