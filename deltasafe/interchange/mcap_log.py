"""MCAP files with JSON messages on topics, facts as metadata, and files as attachments. The only importer of mcap."""

import base64
import contextlib
import dataclasses
import importlib.util
import json
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

from deltasafe.errors import DataError, SettingsError
from deltasafe.interchange.schemas import SCHEMAS
from deltasafe.io.arrays import READ_ERRORS
from deltasafe.io.storage import atomic_file, parse_json

LIBRARY = "deltasafe"
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


@contextlib.contextmanager
def open_log(destination: str | pathlib.Path) -> Iterator["LogWriter"]:
    """Write a log that appears atomically at the end of the block. Equal content gives equal bytes.

    Raises:
        SettingsError: the file does not end in .mcap, or the package mcap is not installed.
        WriteError: no room, or no permission.
    """
    _require_mcap()
    from mcap.writer import Writer

    if pathlib.Path(destination).suffix.lower() != ".mcap":
        raise SettingsError(f"a log must end in .mcap, got {pathlib.Path(destination).name}")
    with atomic_file(destination) as temporary, temporary.open("wb") as stream:
        # the checksums of chunks do not cover attachments and metadata
        writer = Writer(stream, enable_data_crcs=True)
        writer.start(profile="", library=LIBRARY)
        yield LogWriter(writer)
        writer.finish()


class LogWriter:
    """Writes messages, facts and attachments to the log that `open_log` opened."""

    def __init__(self, writer: Any) -> None:
        self._writer = writer
        self._channels: dict[str, int] = {}
        self._schemas: dict[str, int] = {}

    def write_message(self, topic: str, schema: str, time_ns: int, message: Mapping[str, Any]) -> None:
        """Write a message of one of ``SCHEMAS`` with its ``timestamp``."""
        if topic not in self._channels:
            if schema not in self._schemas:
                content = json.dumps(SCHEMAS[schema]).encode()
                self._schemas[schema] = self._writer.register_schema(schema, "jsonschema", content)
            self._channels[topic] = self._writer.register_channel(topic, "json", self._schemas[schema])
        data = json.dumps({"timestamp": stamp(time_ns), **message}, allow_nan=False).encode()
        self._writer.add_message(self._channels[topic], time_ns, data, time_ns)

    def write_facts(self, name: str, facts: Mapping[str, Any]) -> None:
        """Write facts about the whole file as metadata, each as JSON."""
        self._writer.add_metadata(name, {key: json.dumps(value, allow_nan=False) for key, value in facts.items()})

    def attach(self, name: str, media_type: str, data: bytes) -> None:
        """Attach a file."""
        self._writer.add_attachment(0, 0, name, media_type, data)


@dataclasses.dataclass(frozen=True)
class LogContent:
    """Content of a log.

    Attributes:
        path: the file.
        messages: by topic, ordered by time.
        facts: by name of the metadata.
        attachments: by name.
    """

    path: pathlib.Path
    messages: dict[str, list[dict[str, Any]]]
    facts: dict[str, dict[str, Any]]
    attachments: dict[str, bytes]

    def messages_on(self, topic: str) -> list[dict[str, Any]]:
        """Return the messages on a topic, at least one; raise DataError if there is none."""
        return self._required(self.messages, "messages on", topic)

    def facts_named(self, name: str) -> dict[str, Any]:
        """Return the facts of a metadata record; raise DataError if there is none."""
        return self._required(self.facts, "metadata", name)

    def attachment(self, name: str) -> bytes:
        """Return an attached file; raise DataError if there is none."""
        return self._required(self.attachments, "attachment", name)

    def image(self, topic: str) -> tuple[bytes, str]:
        """Return the first image on a topic as the bytes of a file, and its format."""
        message = self.messages_on(topic)[0]
        try:
            return base64.b64decode(message["data"], validate=True), str(message["format"])
        except (KeyError, TypeError, ValueError) as error:
            raise DataError(self.path, f"{topic} holds no compressed image ({error!r}); export it again") from error

    def _required(self, found: dict[str, Any], kind: str, name: str) -> Any:
        if name not in found:
            raise DataError(self.path, f"has no {kind} {name}, only {sorted(found)}; write it with deltasafe export")
        return found[name]


def read_log(path: str | pathlib.Path) -> LogContent:
    """Read a log. Messages that are not JSON are skipped, so that logs of other tools can be read.

    Raises:
        DataError: the file is missing, truncated, damaged, or not MCAP.
        SettingsError: the package mcap is not installed.
    """
    _require_mcap()
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    path = pathlib.Path(path)
    if path.exists() and not path.is_file():  # reading a pipe would block
        raise DataError(path, "is not a file; give the log's file")
    try:
        return _content(path)
    except FileNotFoundError:
        raise DataError(path, "is missing; give the log's file") from None
    except (*READ_ERRORS, McapError, ZstdError, AssertionError, IndexError, OverflowError) as error:
        raise DataError(path, f"is not a readable MCAP log ({error!r}); record or export it again") from error


def _content(path: pathlib.Path) -> LogContent:
    """Read all records in one pass: the index at the end may be missing or incomplete."""
    from mcap.records import Attachment, Channel, Message, Metadata
    from mcap.stream_reader import StreamReader

    channels: dict[int, Any] = {}
    messages: list[Any] = []
    facts: dict[str, dict[str, Any]] = {}
    attachments: dict[str, bytes] = {}
    with path.open("rb") as stream:
        # the limit keeps a damaged length from allocating memory
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
    for message in sorted(messages, key=lambda one: one.log_time):  # a stable sort
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
