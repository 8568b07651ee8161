"""MCAP files: messages on topics, facts as metadata, and files as attachments. The only importer of mcap."""

import contextlib
import functools
import importlib.util
import json
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

from deltasafe.errors import SettingsError
from deltasafe.interchange.log_content import LogBuilder, stamp
from deltasafe.interchange.messages import KINDS, normalized, type_name_of
from deltasafe.interchange.ros_bag import decode_cdr
from deltasafe.interchange.schemas import SCHEMAS
from deltasafe.io.storage import atomic_file, parse_json

LIBRARY = "deltasafe"


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


def add_mcap(path: pathlib.Path, builder: LogBuilder) -> None:
    """Add all records of a file in one pass: the index at the end may be missing or incomplete.

    Raises:
        SettingsError: the package mcap is not installed, or rosbags for messages in CDR.
        ValueError, and others of ``READ_ERRORS``: the file is damaged.
    """
    _require_mcap()
    from mcap.records import Attachment, Metadata

    with _damage_as_value_error():
        for record, channel, name in _records(path):
            if channel is not None:
                encoding = channel.message_encoding
                if encoding == "json":
                    builder.add(channel.topic, name, record.log_time, functools.partial(_object, record.data))
                elif encoding == "cdr" and name in KINDS:
                    decode = functools.partial(decode_cdr, name, record.data)
                    builder.add(channel.topic, name, record.log_time, decode)
                elif name in KINDS:
                    builder.skip(channel.topic, f"{name} in {encoding}")
            elif isinstance(record, Metadata) and record.name.startswith(f"{LIBRARY}."):
                builder.facts[record.name] = {key: parse_json(value) for key, value in record.metadata.items()}
            elif isinstance(record, Attachment):
                builder.attachments[record.name] = bytes(record.data)


def image_messages(path: pathlib.Path, topic: str = "") -> Iterator[tuple[str, int, dict[str, Any]]]:
    """Yield topic, time of recording (ns) and message of each image, in Foxglove's form; only of ``topic`` if given.

    Raises:
        SettingsError: the package mcap is not installed, or rosbags for messages in CDR.
        ValueError, and others of ``READ_ERRORS``: the file is damaged.
    """
    _require_mcap()
    with _damage_as_value_error():
        for record, channel, name in _records(path):
            if channel is None or KINDS.get(name) != "image" or topic not in ("", channel.topic):
                continue
            is_json = channel.message_encoding == "json"
            message = _object(record.data) if is_json else decode_cdr(name, record.data)
            for image in normalized(name, message):
                yield channel.topic, record.log_time, image


@contextlib.contextmanager
def _damage_as_value_error() -> Iterator[None]:
    """Turn what mcap raises about damaged files, and what decoding their messages raises, into a ValueError."""
    from mcap.exceptions import McapError
    from zstandard import ZstdError

    try:
        yield
    except (McapError, ZstdError, AssertionError, IndexError, OverflowError) as error:
        raise ValueError(repr(error)) from error


def _records(path: pathlib.Path) -> Iterator[tuple[Any, Any, str]]:
    """Yield each message with its channel and the name of its type, and other records with None and an empty name."""
    from mcap.records import Channel, Message, Schema
    from mcap.stream_reader import StreamReader

    channels: dict[int, Any] = {}
    types: dict[int, str] = {}
    with path.open("rb") as stream:
        # the limit keeps a damaged length from allocating memory
        for record in StreamReader(stream, validate_crcs=True, record_size_limit=path.stat().st_size).records:
            if isinstance(record, Schema):
                types[record.id] = type_name_of(record.name)
            elif isinstance(record, Channel):
                channels[record.id] = record
            elif isinstance(record, Message):
                channel = channels[record.channel_id]
                yield record, channel, types.get(channel.schema_id, "")
            else:
                yield record, None, ""


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
