"""Coordinate frames of a log: stamped transforms, and the pose of a frame in the world at a given time."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.errors import DataError
from deltasafe.interchange.mcap_log import NS_PER_S, LogContent, time_ns_of

__all__ = ["WORLD", "FramePose", "Frames", "frame_of", "pose_of", "same_pose"]

WORLD = "world"
UNIT_TOLERANCE = 1e-3
"""Of the length of a quaternion: covers components that were rounded to three decimals."""
SAME_M, SAME_RAD = 1e-4, 1e-4
"""Two poses closer than this are the same: covers transforms that were rounded when they were recorded."""
LARGEST = 1e6
"""Of any coordinate in meters: no product of such numbers overflows."""
MOST_LINKS = 100
"""Of a chain: real ones have about ten; bounds the work that a log can ask for."""


@dataclasses.dataclass(frozen=True)
class FramePose:
    """A pose in space, all six degrees of freedom.

    Attributes:
        position_m: (3,) float64.
        quaternion: (4,) float64 x, y, z, w, of unit length within ``UNIT_TOLERANCE``; as it was recorded.
    """

    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]

    @property
    def rotation(self) -> Rotation:
        return Rotation.from_quat(self.quaternion)

    def within(self, outer: "FramePose") -> "FramePose":
        """This pose, given in a frame whose own pose is ``outer``, in the frame of ``outer``."""
        if outer is ORIGIN:  # no arithmetic: poses in the world frame keep their last bit
            return self
        position_m = outer.rotation.apply(self.position_m) + outer.position_m
        return FramePose(position_m, (outer.rotation * self.rotation).as_quat())

    def inverse(self) -> "FramePose":
        """The pose of the outer frame in this one."""
        back = self.rotation.inv()
        return FramePose(-back.apply(self.position_m), back.as_quat())


ORIGIN = FramePose(np.zeros(3), np.array([0.0, 0.0, 0.0, 1.0]))


@dataclasses.dataclass(frozen=True)
class _Transform:
    parent: str
    child: str
    time_ns: int
    message: dict[str, Any]


class Frames:
    """The transforms on a topic of a log.

    Args:
        log: the log.
        topic: holds messages ``foxglove.FrameTransform``.

    Raises:
        DataError: there is none, or one lacks a frame or its timestamp.
    """

    def __init__(self, log: LogContent, topic: str) -> None:
        self._log, self._topic = log, topic
        self._transforms = [
            _Transform(
                frame_of(log, topic, message, "parent_frame_id"),
                frame_of(log, topic, message, "child_frame_id"),
                time_ns_of(log.path, topic, message),
                message,
            )
            for message in log.on(topic)
        ]

    def knows(self, frame: str, time_ns: int) -> bool:
        """Whether transforms not later than ``time_ns`` lead from the world to the frame."""
        return _chain(self._newest(time_ns), frame) is not None

    def pose_in_world(self, frame: str, time_ns: int) -> FramePose:
        """Pose of a frame in the world, composed of the newest transforms that are not later than ``time_ns``.

        Transforms are followed in both directions, as tf2 does.

        Raises:
            DataError: no chain of such transforms leads from the world to the frame, two chains disagree, or a
                transform is not finite or its quaternion not of unit length.
        """
        usable = self._newest(time_ns)
        chain = _chain(usable, frame)
        if chain is None:
            raise DataError(self._log.path, f"{self._topic} {self._no_chain(frame, time_ns)}")
        if len(chain) > MOST_LINKS:
            raise DataError(
                self._log.path,
                f"{self._topic} has {len(chain)} transforms from {WORLD!r} to {frame!r}, at most {MOST_LINKS} are "
                "read; give a shorter chain",
            )
        pose = self._composed(chain)
        for link in chain:  # any other chain does without one of the links
            other = _chain([one for one in usable if one is not link], frame)
            if other is not None and not same_pose(pose, self._composed(other)):
                raise DataError(
                    self._log.path,
                    f"{self._topic} gives {frame!r} two poses in {WORLD!r}: by {_names(chain)}, and by "
                    f"{_names(other)}; remove the wrong transform",
                )
        return pose

    def _newest(self, time_ns: int) -> list[_Transform]:
        """Of each pair of frames the newest transform not later than a time; several, if they have the same time."""
        newest: dict[tuple[str, str], list[_Transform]] = {}
        for one in self._transforms:
            if one.time_ns > time_ns:
                continue
            known = newest.setdefault((one.parent, one.child), [])
            if known and known[0].time_ns < one.time_ns:
                known.clear()
            if not known or known[0].time_ns == one.time_ns:
                known.append(one)
        return [one for several in newest.values() for one in several]

    def _composed(self, chain: Sequence[_Transform]) -> FramePose:
        pose, here = ORIGIN, WORLD
        for one in chain:
            what = f"{self._topic} ({one.parent} -> {one.child})"
            link = pose_of(self._log, what, one.message.get("translation"), one.message.get("rotation"))
            forward = one.parent == here
            pose, here = (link if forward else link.inverse()).within(pose), one.child if forward else one.parent
        return pose

    def _no_chain(self, frame: str, time_ns: int) -> str:
        if _chain(self._transforms, frame) is not None:
            return (
                f"connects {WORLD!r} with {frame!r} only later than {time_ns / NS_PER_S:.9g} s, the time of the "
                "image; give transforms from before the image"
            )
        pairs = sorted({f"{one.parent} -> {one.child}" for one in self._transforms})
        return f"does not connect {WORLD!r} with {frame!r}, it holds {', '.join(pairs):.200}; add the missing transform"


def pose_of(log: LogContent, what: str, position: Any, orientation: Any) -> FramePose:
    """Position and orientation as messages hold them, checked.

    Raises:
        DataError: a component is missing or not a finite number, or the quaternion is not of unit length.
    """
    position_m, quaternion = _numbers(log, what, position, "xyz"), _numbers(log, what, orientation, "xyzw")
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) <= UNIT_TOLERANCE:
        raise DataError(
            log.path,
            f"{what} has the quaternion {quaternion.tolist()} of length {length:.6g}; "
            "a rotation needs length 1, record it again",
        )
    return FramePose(position_m, quaternion)


def frame_of(log: LogContent, topic: str, message: dict[str, Any], key: str = "frame_id") -> str:
    """The frame that a message names.

    Raises:
        DataError: it names none.
    """
    frame = message.get(key)
    if not isinstance(frame, str) or not frame:
        raise DataError(log.path, f"{topic} needs the name of a frame as {key}, got {frame!r:.80}; add it")
    return frame


def same_pose(one: FramePose, other: FramePose) -> bool:
    """Whether two poses differ by less than ``SAME_M`` and ``SAME_RAD``."""
    apart_m = float(np.abs(one.position_m - other.position_m).max())
    return apart_m <= SAME_M and float((one.rotation.inv() * other.rotation).magnitude()) <= SAME_RAD


def _numbers(log: LogContent, what: str, value: Any, names: str) -> NDArray[np.float64]:
    """The components in their order; true and text are no numbers."""
    found: list[Any] = [value.get(name) for name in names] if isinstance(value, dict) else [None]
    if not all(type(one) in (int, float) and abs(one) <= LARGEST for one in found):
        raise DataError(
            log.path,
            f"{what} needs finite numbers {', '.join(names)} up to {LARGEST:g}, got {value!r:.120}; record it again",
        )
    return np.array(found, np.float64)


def _chain(transforms: Sequence[_Transform], frame: str) -> list[_Transform] | None:
    """The shortest chain from the world to a frame."""
    beside: dict[str, list[tuple[str, _Transform]]] = {}
    for one in transforms:
        beside.setdefault(one.parent, []).append((one.child, one))
        beside.setdefault(one.child, []).append((one.parent, one))
    reached: dict[str, tuple[str, _Transform] | None] = {WORLD: None}
    front = [WORLD]
    while front and frame not in reached:
        following = []
        for here in front:
            for there, one in beside.get(here, []):
                if there not in reached:
                    reached[there] = (here, one)
                    following.append(there)
        front = following
    if frame not in reached:
        return None
    chain: list[_Transform] = []
    step = reached[frame]
    while step is not None:
        chain.append(step[1])
        step = reached[step[0]]
    return chain[::-1]


def _names(chain: Sequence[_Transform]) -> str:
    return ", ".join(f"{one.parent} -> {one.child} at {one.time_ns / NS_PER_S:.9g} s" for one in chain)
