"""A kd-tree that grows: leaves are buckets of 32 points, split at the mean of their widest side when full."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compiling import kernel

__all__ = ["BUCKET", "BucketTree", "collect", "empty_buckets", "insert", "nearest_in"]

BUCKET = 32
DEPTH = 256


class BucketTree(NamedTuple):
    """Nodes of a kd-tree in four dimensions, node 0 its root.

    Attributes:
        box: (8, n) lowest and highest coordinates of all points of a node.
        children: (2, n) indices of its halves; -1 in a leaf.
        split: (2, n) axis and place of the cut.
        filled: (n,) number of points of a leaf; ``filled[-1]`` counts the nodes.
        points, number: (n, 4, BUCKET) and (n, BUCKET) the points of a leaf, and their numbers.
        stack: of nodes to be visited, and the smallest squared distance of their boxes.
    """

    box: NDArray[np.float32]
    children: NDArray[np.int32]
    split: NDArray[np.float32]
    filled: NDArray[np.int32]
    points: NDArray[np.float32]
    number: NDArray[np.int32]
    stack: NDArray[np.int32]
    bound: NDArray[np.float32]


def empty_buckets(capacity: int) -> BucketTree:
    """Room for ``capacity`` points."""
    # a split leaves at least half of a bucket on each side, except among equal coordinates
    n = 4 * (capacity // BUCKET + 2)
    tree = BucketTree(
        np.empty((n, 8), np.float32),
        np.full((n, 2), -1, np.int32),
        np.zeros((n, 2), np.float32),
        np.zeros(n + 1, np.int32),
        np.empty((n, 4, BUCKET), np.float32),
        np.empty((n, BUCKET), np.int32),
        np.empty(DEPTH, np.int32),
        np.empty(DEPTH, np.float32),
    )
    tree.box[0, :4], tree.box[0, 4:] = np.inf, -np.inf
    tree.filled[-1] = 1
    return tree


@kernel
def insert(tree, number, x):  # type: ignore[no-untyped-def]
    """Add a point (a tuple of four float32) under a number."""
    node = 0
    while True:
        for axis in range(4):
            tree.box[node, axis] = min(tree.box[node, axis], x[axis])
            tree.box[node, 4 + axis] = max(tree.box[node, 4 + axis], x[axis])
        if tree.children[node, 0] < 0:
            if tree.filled[node] < BUCKET:
                break
            _halve(tree, node)
        upper = x[int(tree.split[node, 0])] > tree.split[node, 1]
        node = tree.children[node, 1 if upper else 0]
    place = tree.filled[node]
    for axis in range(4):
        tree.points[node, axis, place] = x[axis]
    tree.number[node, place] = number
    tree.filled[node] += 1


@kernel
def _halve(tree, node):  # type: ignore[no-untyped-def]
    axis = 0
    for other in range(1, 4):
        if tree.box[node, 4 + other] - tree.box[node, other] > tree.box[node, 4 + axis] - tree.box[node, axis]:
            axis = other
    lowest, highest = tree.box[node, axis], tree.box[node, 4 + axis]
    cut = np.float32(0.0)
    for n in range(BUCKET):
        cut += tree.points[node, axis, n] / np.float32(BUCKET)
    if not lowest <= cut < highest:
        cut = lowest
    tree.split[node, 0], tree.split[node, 1] = axis, cut
    for side in range(2):
        child = tree.filled[-1]
        tree.filled[-1] += 1
        tree.children[node, side] = child
        for other in range(4):
            tree.box[child, other], tree.box[child, 4 + other] = np.inf, -np.inf
        place = 0
        for n in range(BUCKET):
            if (tree.points[node, axis, n] > cut) == (side == 1):
                for other in range(4):
                    value = tree.points[node, other, n]
                    tree.points[child, other, place] = value
                    tree.box[child, other] = min(tree.box[child, other], value)
                    tree.box[child, 4 + other] = max(tree.box[child, 4 + other], value)
                tree.number[child, place] = tree.number[node, n]
                place += 1
        tree.filled[child] = place


@kernel
def _box_distance(tree, node, x):  # type: ignore[no-untyped-def]
    squared = np.float32(0.0)
    for axis in range(4):
        gap = max(tree.box[node, axis] - x[axis], x[axis] - tree.box[node, 4 + axis], np.float32(0.0))
        squared += gap * gap
    return squared


@kernel
def _push_children(tree, node, x, top, within):  # type: ignore[no-untyped-def]
    """Both halves that may hold points within a squared distance, the nearer one on top."""
    first, second = tree.children[node, 0], tree.children[node, 1]
    near, far = _box_distance(tree, first, x), _box_distance(tree, second, x)
    if near > far:
        first, second, near, far = second, first, far, near
    if far <= within:
        tree.stack[top], tree.bound[top] = second, far
        top += 1
    if near <= within:
        tree.stack[top], tree.bound[top] = first, near
        top += 1
    return top


@kernel
def nearest_in(tree, x):  # type: ignore[no-untyped-def]
    """Number of the nearest point, the lowest of equals, and its squared distance."""
    best, least = -1, np.float32(np.inf)
    tree.stack[0], tree.bound[0] = 0, 0.0
    top = 1
    x0, x1, x2, x3 = x
    while top > 0:
        top -= 1
        node = tree.stack[top]
        if tree.bound[top] > least:
            continue
        if tree.children[node, 0] >= 0:
            top = _push_children(tree, node, x, top, least)
            continue
        points, number = tree.points[node], tree.number[node]
        for n in range(tree.filled[node]):
            d0, d1, d2, d3 = points[0, n] - x0, points[1, n] - x1, points[2, n] - x2, points[3, n] - x3
            squared = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3
            if squared < least or (squared == least and number[n] < best):
                best, least = np.int64(number[n]), squared
    return best, least


@kernel
def collect(tree, x, within, found, gap):  # type: ignore[no-untyped-def]
    """All points within a squared distance into ``found`` and ``gap``; returns how many."""
    tree.stack[0], tree.bound[0] = 0, 0.0
    top, m = 1, 0
    x0, x1, x2, x3 = x
    while top > 0:
        top -= 1
        node = tree.stack[top]
        if tree.children[node, 0] >= 0:
            top = _push_children(tree, node, x, top, within)
            continue
        points, number = tree.points[node], tree.number[node]
        for n in range(tree.filled[node]):
            d0, d1, d2, d3 = points[0, n] - x0, points[1, n] - x1, points[2, n] - x2, points[3, n] - x3
            squared = d0 * d0 + d1 * d1 + d2 * d2 + d3 * d3
            found[m], gap[m] = number[n], squared
            m += squared <= within
    return m
