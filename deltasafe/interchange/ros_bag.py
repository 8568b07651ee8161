"""ROS 2 bags and messages in CDR, by the package rosbags. The only importer of rosbags."""

import dataclasses
import functools
import importlib.util
import pathlib
from typing import Any

import numpy as np

from deltasafe.errors import SettingsError
from deltasafe.interchange.log_content import LogBuilder
from deltasafe.interchange.messages import KINDS, type_name_of


def decode_cdr(type_name: str, data: bytes) -> dict[str, Any]:
    """Decode a message of a type of ``KINDS``.

    Raises:
        SettingsError: the package rosbags is not installed.
        ValueError: the data is damaged.
    """
    require_rosbags()
    from rosbags.serde import SerdeError

    try:
        package, name = type_name.split("/")
        return _plain(_types().deserialize_cdr(data, f"{package}/msg/{name}"))
    except (SerdeError, AssertionError, IndexError) as error:
        raise ValueError(f"a message of the type {type_name} is damaged ({error!r:.100})") from error


def add_bag(path: pathlib.Path, builder: LogBuilder) -> None:
    """Add the messages of a bag: a folder with ``metadata.yaml``, or a file ``.db3``.

    Raises:
        SettingsError: the package rosbags is not installed.
        ValueError: the bag is damaged.
    """
    require_rosbags()
    import apsw
    from rosbags.rosbag2 import Reader, ReaderError

    try:
        with Reader(path) as bag:
            read = []
            for connection in bag.connections:
                if type_name_of(connection.msgtype) in KINDS:
                    read.append(connection)
            for connection, time_ns, data in bag.messages(read) if read else ():
                type_name = type_name_of(connection.msgtype)
                builder.add(connection.topic, type_name, time_ns, functools.partial(decode_cdr, type_name, bytes(data)))
    except (ReaderError, apsw.Error, AssertionError) as error:
        raise ValueError(str(error)) from error


def require_rosbags() -> None:
    """Raise SettingsError if the package rosbags is not installed."""
    if importlib.util.find_spec("rosbags") is None:
        raise SettingsError("ROS bags need the package rosbags; install it with: pip install 'deltasafe[ros]'")


@functools.cache
def _types() -> Any:
    """The standard types, whose definitions are the same in every release of ROS 2; those in a file are not trusted."""
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.LATEST)


def _plain(value: Any) -> Any:
    """Convert a message to dictionaries, lists and numbers; arrays of bytes become bytes."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: _plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    return [_plain(one) for one in value] if isinstance(value, list | tuple) else value
