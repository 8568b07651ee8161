"""A tree of poses in flat arrays: parents, costs, and lists of children through which gains reach descendants."""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deltasafe.compute.numba_cache import inlined

__all__ = ["START", "SearchTree", "TreeArrays", "attach", "empty_tree", "move", "pose_of", "set_pose"]

Array = NDArray[np.float64]
START = 0


class TreeArrays(NamedTuple):
    """A tree with room for more nodes; ``links`` holds first child, next and previous sibling, -1 for none."""

    pose: Array
    cost: Array
    parent: NDArray[np.int32]
    links: NDArray[np.int32]


@dataclasses.dataclass(frozen=True)
class SearchTree:
    """The tree after the search; node 0 is the start, nodes 1 to G are the goals.

    Attributes:
        nodes: (n, 4) poses, yaw continuous.
        parent: (n,) index of the parent; -1 at the root, and at a goal while it is not connected.
        cost: (n,) cost from the start; inf at a goal that is not connected.
        solved_at: iteration that first connected a goal; -1 if none did.
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
        """The goal (0 to G - 1) that is reached at the least cost."""
        return int(self.cost[1 : 1 + self.n_goals].argmin())

    def path(self, goal: int | None = None) -> Array | None:
        """(K, 4) poses from start to a goal (by default the cheapest), or None."""
        chain = [1 + (self.best_goal if goal is None else goal)]
        if self.parent[chain[0]] < 0:
            return None
        while chain[-1] != START:
            chain.append(int(self.parent[chain[-1]]))
        return np.asarray(self.nodes[chain[::-1]])


def empty_tree(capacity: int) -> TreeArrays:
    """Arrays for that many nodes, none of them connected."""
    return TreeArrays(
        np.empty((capacity, 4)),
        np.full(capacity, np.inf),
        np.full(capacity, -1, np.int32),
        np.full((capacity, 3), -1, np.int32),
    )


@inlined
def pose_of(tree, node):  # type: ignore[no-untyped-def]
    """Pose of a node as a tuple."""
    return tree.pose[node, 0], tree.pose[node, 1], tree.pose[node, 2], tree.pose[node, 3]


@inlined
def set_pose(tree, node, pose):  # type: ignore[no-untyped-def]
    """Put a node at a pose, a tuple."""
    tree.pose[node, 0], tree.pose[node, 1], tree.pose[node, 2], tree.pose[node, 3] = pose


@inlined
def attach(tree, node, parent, cost):  # type: ignore[no-untyped-def]
    """Hang a node without parent under another."""
    tree.parent[node], tree.cost[node] = parent, cost
    first = tree.links[parent, 0]
    tree.links[node, 1], tree.links[node, 2] = first, -1
    if first >= 0:
        tree.links[first, 2] = node
    tree.links[parent, 0] = node


@inlined
def move(tree, node, parent, cost):  # type: ignore[no-untyped-def]
    """Give a node a cheaper parent, and all its descendants what they gain by it."""
    links = tree.links
    following, previous = links[node, 1], links[node, 2]
    if previous >= 0:
        links[previous, 1] = following
    else:
        links[tree.parent[node], 0] = following
    if following >= 0:
        links[following, 2] = previous
    gain = tree.cost[node] - cost
    attach(tree, node, parent, cost)
    below = links[node, 0]
    while below >= 0:  # depth first, without a stack: down, else right, else up until right is possible
        tree.cost[below] -= gain
        if links[below, 0] >= 0:
            below = links[below, 0]
            continue
        while below != node and links[below, 1] < 0:
            below = tree.parent[below]
        below = -1 if below == node else links[below, 1]
