"""The interface between search and segment tests: ``segment_is_safe``, dispatched by type at compile time."""

from collections.abc import Callable
from typing import Any

from numba import types
from numba.extending import overload

from deltasafe.compute.numba_cache import kernel


def segment_is_safe(constraint: Any, start: Any, end: Any) -> bool:
    """Return whether every pose of the segment between two poses (tuples of 4) satisfies the constraint.

    Only compiled code may call it. numba resolves the call by the type of ``constraint``, a ``NamedTuple`` class whose
    test was registered with ``register_segment_test``.
    """
    raise TypeError("segment_is_safe is for compiled code; call segment_passes")


def register_segment_test(constraint_type: type) -> Callable[[Any], Any]:
    """Register a compiled ``test(constraint, start, end) -> bool`` for a ``NamedTuple`` class.

    ``start`` and ``end`` are tuples (x, y, z, yaw).
    """

    def register(test: Any) -> Any:
        @overload(segment_is_safe, jit_options={"_nrt": False})
        def resolve(constraint, start, end):  # type: ignore[no-untyped-def]
            if isinstance(constraint, types.BaseTuple) and (
                getattr(constraint, "instance_class", None) is constraint_type
            ):
                return lambda constraint, start, end: test(constraint, start, end)  # noqa: PLW0108 - numba reads it
            return None

        return test

    return register


@kernel
def as_pose(pose):  # type: ignore[no-untyped-def]
    """Convert an array (4,) to a tuple."""
    return pose[0], pose[1], pose[2], pose[3]


@kernel
def segment_passes(constraint, start, end):  # type: ignore[no-untyped-def]
    """Call ``segment_is_safe`` from Python, with poses as arrays (4,) of float64."""
    return segment_is_safe(constraint, as_pose(start), as_pose(end))
