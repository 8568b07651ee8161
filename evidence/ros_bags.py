"""ROS 2 bags written by rosbags from plain dictionaries, for tests and fault tests of their import."""

import pathlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

Messages = Mapping[str, Sequence[tuple[float, dict[str, Any]]]]
"""By topic: times of recording in seconds, and messages."""

ROS = get_typestore(Stores.LATEST)
NS_PER_S = 1_000_000_000
START_NS = 1_700_000_000 * NS_PER_S


def write_bag(
    folder: pathlib.Path,
    content: Messages,
    types: Mapping[str, str],
    storage: StoragePlugin = StoragePlugin.SQLITE3,
    compression: CompressionMode | None = None,
) -> pathlib.Path:
    """Write a bag; ``types`` names the type of each topic, for example ``sensor_msgs/msg/Image``."""
    bag = Writer(folder, version=9, storage_plugin=storage)
    if compression is not None:
        bag.set_compression(compression, CompressionFormat.ZSTD)
    with bag:
        for topic, messages in content.items():
            connection = bag.add_connection(topic, types[topic], typestore=ROS)
            for time_s, value in messages:
                data = ROS.serialize_cdr(_message(types[topic], value), types[topic])
                bag.write(connection, START_NS + round(time_s * NS_PER_S), bytes(data))
    return folder


def _message(type_name: str, value: Mapping[str, Any]) -> Any:
    """Make an object of rosbags from dictionaries."""
    fields = ROS.fielddefs[type_name][1]
    return ROS.types[type_name](**{name: _field(kind, about, value[name]) for name, (kind, about) in fields})


def _field(kind: Any, about: Any, value: Any) -> Any:
    if kind.name == "NAME":
        return _message(about, value)
    if kind.name not in ("ARRAY", "SEQUENCE"):
        return value
    (item_kind, item_about), _ = about
    if item_kind.name == "NAME":
        return [_message(item_about, each) for each in value]
    return np.frombuffer(value, np.uint8) if isinstance(value, bytes) else np.array(value, item_about[0])
