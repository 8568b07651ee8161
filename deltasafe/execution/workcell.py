"""Surroundings of an execution: tool, hand and table, and the arm that carries the tool."""

import contextlib
import dataclasses
from collections.abc import Callable
from typing import Any, TypeAlias

from numpy.typing import NDArray

from deltasafe.execution.arm import Arm
from deltasafe.planning.body import ToolBody

Mesh: TypeAlias = tuple[NDArray[Any], NDArray[Any]]


@dataclasses.dataclass(frozen=True)
class Workcell:
    """The arm and what it moves beside.

    Attributes:
        body: the tool at the flange.
        mesh: vertices_m (V, 3) and triangles (F, 3) of the hand, solid in the simulation; None: no hand.
        table_z_m: height of the table; the arm stands beside it.
        make_arm: returns an arm for a seed, which draws its friction and sensor gains; None: the arm that
            ``ExecutionSettings`` names, simulated.
    """

    body: ToolBody
    mesh: Mesh | None = None
    table_z_m: float = 0.0
    make_arm: Callable[[int], contextlib.AbstractContextManager[Arm]] | None = None
