"""A tree of poses in flat arrays: parents, costs, and linked lists of children to propagate cost changes."""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined

Array = NDArray[np.float64]

FIRST_CHILD, NEXT_SIBLING, PREVIOUS_SIBLING = range(3)
"""Columns of ``TreeArrays.links``."""


class TreeArrays(NamedTuple):
    """A tree with room for more nodes, as compiled code reads it.

    Attributes:
        pose: (n, 4).
        cost: (n,) cost from the root; inf if not connected.
        parent: (n,) index; -1 for none.
        links: (n, 3) indices of first child, next sibling and previous sibling; -1 for none.
    """

    pose: Array
    cost: Array
    parent: NDArray[np.int32]
    links: NDArray[np.int32]


@dataclasses.dataclass(frozen=True)
class SearchTree:
    """The tree after a search. Node 0 is the start, nodes 1 to G are the goals.

    Attributes:
        nodes: (n, 4) poses, yaw continuous.
        parent: (n,) index of the parent; -1 at the root, and at a goal that is not connected.
        cost: (n,) cost from the start; inf at a goal that is not connected.
        solved_at: first iteration that connected a goal; -1 if none did.
        n_goals: G.
        n_iterations: samples drawn.
    """

    nodes: Array
    parent: NDArray[np.int32]
    cost: Array
    solved_at: int
    n_goals: int = 1
    n_iterations: int = 0

    @property
    def best_goal(self) -> int:
        """The goal (0 to G - 1) with the least cost."""
        return int(self.cost[1 : 1 + self.n_goals].argmin())

    def path(self, goal: int | None = None) -> Array | None:
        """Poses (K, 4) from the start to a goal (by default the cheapest), or None if it is not connected."""
        chain = [1 + (self.best_goal if goal is None else goal)]
        if self.parent[chain[0]] < 0:
            return None
        while chain[-1] != 0:
            chain.append(int(self.parent[chain[-1]]))
        return np.asarray(self.nodes[chain[::-1]])


def empty_tree(capacity: int) -> TreeArrays:
    """Allocate the arrays for ``capacity`` nodes, none of them connected."""
    return TreeArrays(
        np.empty((capacity, 4)),
        np.full(capacity, np.inf),
        np.full(capacity, -1, np.int32),
        np.full((capacity, 3), -1, np.int32),
    )


@inlined
def pose_of(tree, node):  # type: ignore[no-untyped-def]
    """Return the pose of a node as a tuple."""
    return tree.pose[node, 0], tree.pose[node, 1], tree.pose[node, 2], tree.pose[node, 3]


@inlined
def set_pose(tree, node, pose):  # type: ignore[no-untyped-def]
    """Set the pose of a node from a tuple."""
    tree.pose[node, 0], tree.pose[node, 1], tree.pose[node, 2], tree.pose[node, 3] = pose


@inlined
def attach(tree, node, parent, cost):  # type: ignore[no-untyped-def]
    """Make a node without parent the first child of ``parent``."""
    tree.parent[node], tree.cost[node] = parent, cost
    first = tree.links[parent, FIRST_CHILD]
    tree.links[node, NEXT_SIBLING], tree.links[node, PREVIOUS_SIBLING] = first, -1
    if first >= 0:
        tree.links[first, PREVIOUS_SIBLING] = node
    tree.links[parent, FIRST_CHILD] = node


@inlined
def reparent(tree, node, parent, cost):  # type: ignore[no-untyped-def]
    """Move a node to a parent that makes it cheaper, and reduce the costs of its descendants."""
    links = tree.links
    following, previous = links[node, NEXT_SIBLING], links[node, PREVIOUS_SIBLING]
    if previous >= 0:
        links[previous, NEXT_SIBLING] = following
    else:
        links[tree.parent[node], FIRST_CHILD] = following
    if following >= 0:
        links[following, PREVIOUS_SIBLING] = previous
    gain = tree.cost[node] - cost
    attach(tree, node, parent, cost)
    below = links[node, FIRST_CHILD]
    while below >= 0:  # depth first without a stack: first child, else next sibling, else that of an ancestor
        tree.cost[below] -= gain
        if links[below, FIRST_CHILD] >= 0:
            below = links[below, FIRST_CHILD]
            continue
        while below != node and links[below, NEXT_SIBLING] < 0:
            below = tree.parent[below]
        below = -1 if below == node else links[below, NEXT_SIBLING]
