"""Content of a log in one form, independent of what wrote it: messages as Foxglove's, facts, and attached files."""

import dataclasses
import pathlib
from collections.abc import Callable, Mapping
from typing import Any

from deltasafe.errors import DataError
from deltasafe.interchange.messages import KINDS, normalized

NS_PER_S = 1_000_000_000


def stamp(time_ns: int) -> dict[str, int]:
    """Convert a time to a ``timestamp``."""
    return {"sec": time_ns // NS_PER_S, "nsec": time_ns % NS_PER_S}


def time_ns_of(path: pathlib.Path, topic: str, message: Mapping[str, Any]) -> int:
    """Return the ``timestamp`` of a message in nanoseconds.

    Raises:
        DataError: it is missing or invalid.
    """
    time = message.get("timestamp")
    parts: list[Any] = [time.get("sec"), time.get("nsec")] if isinstance(time, dict) else [None]
    if not all(type(part) is int and part >= 0 for part in parts) or parts[-1] >= NS_PER_S:
        raise DataError(path, f"{topic} needs a timestamp of sec and nsec, got {time!r:.80}; record it again")
    return int(parts[0] * NS_PER_S + parts[1])


@dataclasses.dataclass(frozen=True)
class LogContent:
    """Content of a log.

    Attributes:
        path: the file or folder.
        messages: by topic, ordered by time; of a topic of images, one image.
        facts: by name of the metadata.
        attachments: by name.
        kinds: ``image``, ``calibration``, ``transform`` or ``pose`` by topic, for topics of these kinds.
        unread: encoding by topic, for topics that cannot be read.
    """

    path: pathlib.Path
    messages: dict[str, list[dict[str, Any]]]
    facts: dict[str, dict[str, Any]]
    attachments: dict[str, bytes]
    kinds: dict[str, str] = dataclasses.field(default_factory=dict)
    unread: dict[str, str] = dataclasses.field(default_factory=dict)

    def messages_on(self, topic: str) -> list[dict[str, Any]]:
        """Return the messages on a topic, at least one; raise DataError if there is none."""
        return self._required(self.messages, "messages on", topic)

    def facts_named(self, name: str) -> dict[str, Any]:
        """Return the facts of a metadata record; raise DataError if there is none."""
        return self._required(self.facts, "metadata", name)

    def attachment(self, name: str) -> bytes:
        """Return an attached file; raise DataError if there is none."""
        return self._required(self.attachments, "attachment", name)

    def topics(self, kind: str) -> list[str]:
        """Return the topics of a kind, in order of their names."""
        return sorted(topic for topic, its_kind in self.kinds.items() if its_kind == kind)

    def _required(self, found: dict[str, Any], kind: str, name: str) -> Any:
        if name not in found:
            unread = f" (and {self.unread}, which cannot be read)" if self.unread and found is self.messages else ""
            raise DataError(self.path, f"has no {kind} {name}, only {sorted(found)}{unread}; name one of them")
        return found[name]


class LogBuilder:
    """Collects the messages of a log as they are read. Of each topic of images one is kept, to bound the memory.

    Args:
        path: the file or folder.
        image_after_s: the image is the first one that was recorded at least this long after the topic's first.
    """

    def __init__(self, path: pathlib.Path, image_after_s: float = 0.0) -> None:
        self.path = path
        self.facts: dict[str, dict[str, Any]] = {}
        self.attachments: dict[str, bytes] = {}
        self._unread: dict[str, str] = {}
        self._kinds: dict[str, str] = {}
        self._after_ns = round(image_after_s * NS_PER_S)
        self._messages: list[tuple[int, str, dict[str, Any]]] = []
        self._first_ns: dict[str, int] = {}
        self._images: dict[str, tuple[int, str, Callable[[], dict[str, Any]]]] = {}

    def add(self, topic: str, type_name: str, log_time_ns: int, decode: Callable[[], dict[str, Any]]) -> None:
        """Add a message; ``decode`` is called at once, or later for the image that is kept."""
        kind = KINDS.get(type_name)
        if kind is not None:
            self._kinds[topic] = kind
        if kind != "image":
            for message in normalized(type_name, decode()):
                self._messages.append((log_time_ns, topic, message))
            return
        first_ns = self._first_ns[topic] = min(log_time_ns, self._first_ns.get(topic, log_time_ns))
        kept = self._images.get(topic)
        if log_time_ns >= first_ns + self._after_ns and (kept is None or log_time_ns < kept[0]):
            self._images[topic] = (log_time_ns, type_name, decode)

    def skip(self, topic: str, encoding: str) -> None:
        """Note a topic that cannot be read."""
        self._unread[topic] = encoding

    def content(self) -> LogContent:
        """Return the content; the messages of each topic are ordered by the time of recording."""
        by_topic: dict[str, list[dict[str, Any]]] = {}
        for _, topic, message in sorted(self._messages, key=lambda one: one[0]):  # a stable sort
            by_topic.setdefault(topic, []).append(message)
        for topic, (_, type_name, decode) in self._images.items():
            by_topic[topic] = normalized(type_name, decode())
        return LogContent(self.path, by_topic, self.facts, self.attachments, self._kinds, self._unread)
