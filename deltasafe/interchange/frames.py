"""Coordinate frames of a log: stamped transforms, and the pose of a frame in the world at a time."""

import dataclasses
import itertools
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from deltasafe.errors import DataError
from deltasafe.interchange.log_content import NS_PER_S, LogContent, time_ns_of

WORLD = "world"
UNIT_TOLERANCE = 1e-3
"""Tolerance of the norm of a quaternion: covers components that were rounded to three decimals."""
SAME_M, SAME_RAD = 1e-4, 1e-4
"""Two poses closer than this are equal: covers transforms that were rounded when they were recorded."""
MAX_COORDINATE = 1e6
"""In meters: no product of such numbers overflows."""
MAX_LINKS = 100
"""Of a chain of transforms, which bounds the work for a malicious log. Real chains have about ten."""


@dataclasses.dataclass(frozen=True)
class FramePose:
    """A pose with six degrees of freedom.

    Attributes:
        position_m: (3,) float64.
        quaternion: (4,) float64 x, y, z, w as recorded; its norm is 1 within ``UNIT_TOLERANCE``.
    """

    position_m: NDArray[np.float64]
    quaternion: NDArray[np.float64]

    @property
    def rotation(self) -> Rotation:
        return Rotation.from_quat(self.quaternion)

    def within(self, outer: "FramePose") -> "FramePose":
        """Transform this pose from a frame with the pose ``outer`` to the frame in which ``outer`` is given."""
        if outer is ORIGIN:  # without arithmetic, so that poses in the world frame keep their last bit
            return self
        position_m = outer.rotation.apply(self.position_m) + outer.position_m
        return FramePose(position_m, (outer.rotation * self.rotation).as_quat())

    def inverse(self) -> "FramePose":
        """Return the pose of the outer frame in this one."""
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
    """The transforms of a log.

    Args:
        log: the log.
        topics: of messages ``foxglove.FrameTransform``. Transforms on a topic ``tf_static`` hold at all times.
        world: name of the world frame.

    Raises:
        DataError: a topic has no message, or a message without a frame or a timestamp.
    """

    def __init__(self, log: LogContent, topics: Sequence[str], world: str = WORLD) -> None:
        self._log, self._topic, self._world = log, " and ".join(topics), world
        self._transforms = [
            _Transform(
                frame_of(log, topic, message, "parent_frame_id"),
                frame_of(log, topic, message, "child_frame_id"),
                -1 if topic.endswith("tf_static") else time_ns_of(log.path, topic, message),
                message,
            )
            for topic in topics
            for message in log.messages_on(topic)
        ]

    def is_connected(self, frame: str, time_ns: int) -> bool:
        """Whether transforms not later than ``time_ns`` connect the world with the frame."""
        return _chain(self._newest(time_ns), self._world, frame) is not None

    def pose_in_world(self, frame: str, time_ns: int) -> FramePose:
        """Compose the pose of a frame in the world from the newest transforms that are not later than ``time_ns``.

        Transforms are followed in both directions, as in tf2.

        Raises:
            DataError: such transforms do not connect the world with the frame, two chains disagree, a transform is not
                finite, or its quaternion is not of unit length.
        """
        usable = self._newest(time_ns)
        chain = _chain(usable, self._world, frame)
        if chain is None:
            raise DataError(self._log.path, f"{self._topic} {self._no_chain(frame, time_ns)}")
        if len(chain) > MAX_LINKS:
            raise DataError(
                self._log.path,
                f"{self._topic} has {len(chain)} transforms from {self._world!r} to {frame!r}, at most {MAX_LINKS} are "
                "read; give a shorter chain",
            )
        pose = self._composed(chain)
        for link in chain:  # any other chain lacks one of the links
            other = _chain([one for one in usable if one is not link], self._world, frame)
            if other is not None and not same_pose(pose, self._composed(other)):
                raise DataError(
                    self._log.path,
                    f"{self._topic} gives {frame!r} two poses in {self._world!r}: by {_names(chain)}, and by "
                    f"{_names(other)}; remove the wrong transform",
                )
        return pose

    def _newest(self, time_ns: int) -> list[_Transform]:
        """The newest transforms of each pair of frames that are not later than a time; several with equal times."""
        newest: dict[tuple[str, str], list[_Transform]] = {}
        for one in self._transforms:
            if one.time_ns > time_ns:
                continue
            found = newest.setdefault((one.parent, one.child), [])
            if found and found[0].time_ns < one.time_ns:
                found.clear()
            if not found or found[0].time_ns == one.time_ns:
                found.append(one)
        return list(itertools.chain.from_iterable(newest.values()))

    def _composed(self, chain: Sequence[_Transform]) -> FramePose:
        pose, here = ORIGIN, self._world
        for one in chain:
            what = f"{self._topic} ({one.parent} -> {one.child})"
            link = pose_of(self._log, what, one.message.get("translation"), one.message.get("rotation"))
            forward = one.parent == here
            pose, here = (link if forward else link.inverse()).within(pose), one.child if forward else one.parent
        return pose

    def _no_chain(self, frame: str, time_ns: int) -> str:
        if _chain(self._transforms, self._world, frame) is not None:
            return (
                f"connects {self._world!r} with {frame!r} only later than {time_ns / NS_PER_S:.9g} s, the time of the "
                "image; give transforms from before the image"
            )
        pairs = sorted({f"{one.parent} -> {one.child}" for one in self._transforms})
        held = f"it holds {', '.join(pairs):.200}"
        return f"does not connect {self._world!r} with {frame!r}, {held}; add the missing transform"


def pose_of(log: LogContent, what: str, position: Any, orientation: Any) -> FramePose:
    """Check position and orientation of a message, and return the pose.

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
    """Return the frame of a message.

    Raises:
        DataError: the message has none.
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
    """The components in their order; booleans and text are refused."""
    found: list[Any] = [value.get(name) for name in names] if isinstance(value, dict) else [None]
    if not all(type(one) in (int, float) and abs(one) <= MAX_COORDINATE for one in found):
        raise DataError(
            log.path,
            f"{what} needs finite numbers {', '.join(names)} up to {MAX_COORDINATE:g}, got {value!r:.120}; "
            "record it again",
        )
    return np.array(found, np.float64)


def _chain(transforms: Sequence[_Transform], world: str, frame: str) -> list[_Transform] | None:
    """The shortest chain between two frames (breadth-first search)."""
    neighbors: dict[str, list[tuple[str, _Transform]]] = {}
    for one in transforms:
        neighbors.setdefault(one.parent, []).append((one.child, one))
        neighbors.setdefault(one.child, []).append((one.parent, one))
    reached: dict[str, tuple[str, _Transform] | None] = {world: None}
    front = [world]
    while front and frame not in reached:
        following = []
        for here in front:
            for there, one in neighbors.get(here, []):
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
