"""One MCAP file: JSON messages on topics, facts as metadata, whole files as attachments. The only importer of mcap."""

import base64
import contextlib
import dataclasses
import importlib.util
import json
import pathlib
from collections.abc import Mapping
from types import TracebackType
from typing import Any, Self

from deltasafe.errors import DataError, SettingsError
from deltasafe.interchange.schemas import SCHEMAS
from deltasafe.io.arrays import READ_ERRORS
from deltasafe.io.storage import atomic_file, parse_json

__all__ = ["NS_PER_S", "LogContent", "LogWriter", "read_log", "stamp", "time_ns_of"]

LIBRARY = "deltasafe"
NS_PER_S = 1_000_000_000


def stamp(time_ns: int) -> dict[str, int]:
    """A time as messages hold it."""
    return {"sec": time_ns // NS_PER_S, "nsec": time_ns % NS_PER_S}


def time_ns_of(path: pathlib.Path, topic: str, message: Mapping[str, Any]) -> int:
    """The ``timestamp`` of a message, which ``stamp`` wrote.

    Raises:
        DataError: it is missing, or no time.
    """
    time = message.get("timestamp")
    parts: list[Any] = [time.get("sec"), time.get("nsec")] if isinstance(time, dict) else [None]
    if not all(type(part) is int and part >= 0 for part in parts) or parts[-1] >= NS_PER_S:
        raise DataError(path, f"{topic} needs a timestamp of sec and nsec, got {time!r:.80}; record it again")
    return int(parts[0] * NS_PER_S + parts[1])


class LogWriter:
    """Writes a file that appears as a whole when the block ends; equal content gives equal bytes.

    Args:
        destination: the file.

    Raises:
        SettingsError: the file does not end in .mcap, or the package mcap is not installed.
        WriteError: no room, or no permission.
    """

    def __init__(self, destination: str | pathlib.Path) -> None:
        _require_mcap()
        if pathlib.Path(destination).suffix.lower() != ".mcap":
            raise SettingsError(f"a log must end in .mcap, got {pathlib.Path(destination).name}")
        self._whole = contextlib.ExitStack()
        self._destination = destination
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def __enter__(self) -> Self:
        from mcap.writer import Writer

        temporary = self._whole.enter_context(atomic_file(self._destination))
        stream = self._whole.enter_context(temporary.open("wb"))
        # covers attachments and metadata, which the checksums of chunks do not
        self._writer = Writer(stream, enable_data_crcs=True)
        self._whole.push(self._finish)
        self._writer.start(profile="", library=LIBRARY)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._whole.__exit__(kind, error, trace)

    def _finish(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if kind is None:
            self._writer.finish()

    def say(self, topic: str, schema: str, time_ns: int, message: Mapping[str, Any]) -> None:
        """A message of one of ``SCHEMAS``; its ``timestamp`` is added."""
        if topic not in self._channels:
            if schema not in self._schemas:
                content = json.dumps(SCHEMAS[schema]).encode()
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", content)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        data = json.dumps({"timestamp": stamp(time_ns), **message}, allow_nan=False).encode()
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def note(self, name: str, facts: Mapping[str, Any]) -> None:
        """Facts about the whole file, each as JSON."""
        self._writer.add_metadata(name, {key: json.dumps(value, allow_nan=False) for key, value in facts.items()})

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """A whole file."""
        self._writer.add_attachment(0, 0, name, media_type, data)


@dataclasses.dataclass(frozen=True)
class LogContent:
    """All that a log holds.

    Attributes:
        path: the file.
        messages: by topic, in the order of time.
        facts: by the name of the metadata.
        attachments: by name.
    """

    path: pathlib.Path
    messages: dict[str, list[dict[str, Any]]]
    facts: dict[str, dict[str, Any]]
    attachments: dict[str, bytes]

    def on(self, topic: str) -> list[dict[str, Any]]:
        """The messages on a topic, at least one.

        Raises:
            DataError: there is none; names the topics that there are.
        """
        if topic not in self.messages:
            raise DataError(self.path, f"has no messages on {topic}, only on {sorted(self.messages)}; export it again")
        return self.messages[topic]

    def about(self, name: str) -> dict[str, Any]:
        """The facts of that name.

        Raises:
            DataError: there are none.
        """
        if name not in self.facts:
            raise DataError(self.path, f"has no metadata {name}; it was not written by deltasafe export")
        return self.facts[name]

    def attachment(self, name: str) -> bytes:
        """The attached file of that name.

        Raises:
            DataError: there is none.
        """
        if name not in self.attachments:
            raise DataError(self.path, f"has no attachment {name}, only {sorted(self.attachments)}; export it again")
        return self.attachments[name]

    def image(self, topic: str) -> tuple[bytes, str]:
        """The first image on a topic as a file's bytes, and its format."""
        message = self.on(topic)[0]
        try:
            return base64.b64decode(message["data"], validate=True), str(message["format"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(self.path, f"{topic} holds no compressed image ({error!r}); export it again") from error


def read_log(path: str | pathlib.Path) -> LogContent:
    """Read a whole log; messages that are not JSON are passed over, so that logs of other tools can be read.

    Raises:
        DataError: the file is missing, cut short, damaged, or no MCAP.
        SettingsError: the package mcap is not installed.
    """
    _require_mcap()
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    path = pathlib.Path(path)
    if path.exists() and not path.is_file():  # a pipe would be waited for
        raise DataError(path, "is no file; give the log's file")
    try:
        return _content(path)
    except FileNotFoundError:
        raise DataError(path, "is missing; give the log's file") from None
    except (*READ_ERRORS, McapError, ZstdError, AssertionError, IndexError, OverflowError) as error:
        raise DataError(path, f"is not a readable MCAP log ({error!r}); record or export it again") from error


def _content(path: pathlib.Path) -> LogContent:
    """Everything in one pass over the records: the index at the end may be missing, or know a part of them only."""
    from mcap.records import Attachment, Channel, Message, Metadata
    from mcap.stream_reader import StreamReader

    channels: dict[int, Any] = {}
    messages: list[Any] = []
    facts: dict[str, dict[str, Any]] = {}
    attachments: dict[str, bytes] = {}
    with path.open("rb") as stream:
        # no record is longer than the file: a damaged length must not claim memory
        for record in StreamReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size).records:
            if isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message) and channels[record.channel_id].message_encoding == "json":
                messages.append(record)
            elif isinstance(record, Metadata) and record.name.startswith(f"{LIBRARY}."):
                facts[record.name] = {key: parse_json(value) for key, value in record.metadata.items()}
            elif isinstance(record, Attachment):
                attachments[record.name] = bytes(record.data)
    by_topic: dict[str, list[dict[str, Any]]] = {}
    for message in sorted(messages, key=lambda one: one.log_time):  # stable: equal times keep the order of the file
        by_topic.setdefault(channels[message.channel_id].topic, []).append(_object(message.data))
    return LogContent(path, by_topic, facts, attachments)


def _object(data: bytes) -> dict[str, Any]:
    found = parse_json(data)
    if not isinstance(found, dict):
        raise ValueError("a message is not a JSON object")
    return found


def _require_mcap() -> None:
    if importlib.util.find_spec("mcap") is None:
        raise SettingsError(
            "reading and writing MCAP needs its package; install it with: pip install 'deltasafe[mcap]'"
        )
