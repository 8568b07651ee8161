"""A kd-tree that grows point by point: leaves are buckets of 64 points, split at the mean of their widest side."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined, kernel
from deltasafe.planning.search.simd_groups import GROUP, append_within, ctz, le_mask, squared_distances

STACK_SIZE = 256


class BucketTree(NamedTuple):
    """Nodes of a kd-tree in four dimensions; node 0 is the root.

    Attributes:
        lower, upper: (4 n,) bounding box of the points of a node.
        children: (n,) index of the first child, which the second follows; -1 in a leaf.
        split: (n, 2) axis and coordinate of the cut.
        size: (n,) number of points of a leaf; ``size[-1]`` is the number of nodes.
        points: (n, 4, GROUP) points of a leaf; unused places are infinitely far.
        indices: (n, GROUP) of these points.
        squared: (2 GROUP,) scratch: squared distances in a leaf.
        stack, bound: scratch: nodes to visit, and the squared distances of their boxes.
        query, gaps: (8,) scratch: the query point twice, and its squared distances to two boxes by axis.
    """

    lower: NDArray[np.float32]
    upper: NDArray[np.float32]
    children: NDArray[np.int32]
    split: NDArray[np.float32]
    size: NDArray[np.int32]
    points: NDArray[np.float32]
    indices: NDArray[np.int32]
    squared: NDArray[np.float32]
    stack: NDArray[np.int32]
    bound: NDArray[np.float32]
    query: NDArray[np.float32]
    gaps: NDArray[np.float32]


def empty_buckets(capacity: int) -> BucketTree:
    """Allocate a tree for ``capacity`` points."""
    # a split leaves at least half of a bucket on each side, except among equal coordinates
    n = 4 * (capacity // GROUP + 2)
    tree = BucketTree(
        np.full(4 * n, np.inf, np.float32),
        np.full(4 * n, -np.inf, np.float32),
        np.full(n, -1, np.int32),
        np.zeros((n, 2), np.float32),
        np.zeros(n + 1, np.int32),
        np.full((n, 4, GROUP), np.inf, np.float32),
        np.empty((n, GROUP), np.int32),
        np.empty(2 * GROUP, np.float32),
        np.empty(STACK_SIZE, np.int32),
        np.empty(STACK_SIZE, np.float32),
        np.empty(8, np.float32),
        np.empty(8, np.float32),
    )
    tree.size[-1] = 1
    return tree


@kernel
def insert(tree, index, x):  # type: ignore[no-untyped-def]
    """Add a point (a tuple of four float32) with its index."""
    node = 0
    while True:
        _extend_box(tree, node, x)
        if tree.children[node] < 0:
            if tree.size[node] < GROUP:
                break
            _split_leaf(tree, node)
        upper = x[int(tree.split[node, 0])] > tree.split[node, 1]
        node = tree.children[node] + upper
    _append(tree, node, index, x)


@inlined
def _extend_box(tree, node, x):  # type: ignore[no-untyped-def]
    for axis in range(4):
        tree.lower[4 * node + axis] = min(tree.lower[4 * node + axis], x[axis])
        tree.upper[4 * node + axis] = max(tree.upper[4 * node + axis], x[axis])


@inlined
def _append(tree, leaf, index, x):  # type: ignore[no-untyped-def]
    place = tree.size[leaf]
    for axis in range(4):
        tree.points[leaf, axis, place] = x[axis]
    tree.indices[leaf, place] = index
    tree.size[leaf] += 1


@kernel
def _split_leaf(tree, node):  # type: ignore[no-untyped-def]
    axis, widest = 0, np.float32(-1.0)
    for other in range(4):
        width = tree.upper[4 * node + other] - tree.lower[4 * node + other]
        if width > widest:
            axis, widest = other, width
    lower, upper = tree.lower[4 * node + axis], tree.upper[4 * node + axis]
    cut = np.float32(0.0)
    for n in range(GROUP):
        cut += tree.points[node, axis, n] / np.float32(GROUP)
    if not lower <= cut < upper:
        cut = lower
    tree.split[node, 0], tree.split[node, 1] = axis, cut
    tree.children[node] = tree.size[-1]
    tree.size[-1] += 2
    points = tree.points[node]
    for n in range(GROUP):
        child = tree.children[node] + (points[axis, n] > cut)
        x = points[0, n], points[1, n], points[2, n], points[3, n]
        _extend_box(tree, child, x)
        _append(tree, child, tree.indices[node, n], x)


@inlined
def _begin(tree, x):  # type: ignore[no-untyped-def]
    """Push the root, and store the query twice, so that one vectorized loop compares it with two boxes."""
    tree.stack[0], tree.bound[0] = 0, 0.0
    for axis in range(4):
        tree.query[axis] = tree.query[4 + axis] = x[axis]


@inlined
def _push_children(tree, first, top, limit):  # type: ignore[no-untyped-def]
    """Push the children within a squared distance, the nearer one on top; return the new top of the stack."""
    lower, upper = tree.lower[4 * first : 4 * first + 8], tree.upper[4 * first : 4 * first + 8]
    query, gaps = tree.query, tree.gaps
    for n in range(8):
        gap = max(lower[n] - query[n], query[n] - upper[n], np.float32(0.0))
        gaps[n] = gap * gap
    near, far, nearer = gaps[0] + gaps[1] + gaps[2] + gaps[3], gaps[4] + gaps[5] + gaps[6] + gaps[7], first
    if near > far:
        near, far, nearer = far, near, first + 1
    if far <= limit:
        tree.stack[top], tree.bound[top] = 2 * first + 1 - nearer, far
        top += 1
    if near <= limit:
        tree.stack[top], tree.bound[top] = nearer, near
        top += 1
    return top


@kernel
def nearest_in(tree, x):  # type: ignore[no-untyped-def]
    """Return the index of the nearest point (the lowest index among equals) and its squared distance."""
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
        squared_distances(tree.points[node], GROUP, x, tree.squared)
        mask = le_mask(tree.squared, 0, least)
        while mask:
            n = np.int64(ctz(mask))
            squared, index = tree.squared[n], np.int64(tree.indices[node, n])
            if squared < least or (squared == least and index < best):
                best, least = index, squared
            mask &= mask - np.uint64(1)
    return best, least


@kernel
def collect(tree, x, limit, indices, squared):  # type: ignore[no-untyped-def]
    """Write the points within a squared distance to ``indices`` and ``squared``; return their number."""
    _begin(tree, x)
    top, size = 1, 0
    while top > 0:
        top -= 1
        node = tree.stack[top]
        if tree.children[node] >= 0:
            top = _push_children(tree, tree.children[node], top, limit)
            continue
        squared_distances(tree.points[node], GROUP, x, tree.squared)
        before, size = size, append_within(tree.squared, 0, limit, indices, squared, size)
        for n in range(before, size):
            indices[n] = tree.indices[node, indices[n]]
    return size
