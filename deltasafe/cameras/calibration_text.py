"""The text of calibration files: YAML, JSON and XML as OpenCV and ROS write them, and the matrices in it."""

import math
import pathlib
import re
import xml.etree.ElementTree
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

from deltasafe.errors import DataError

Array = NDArray[np.float64]

MAX_BYTES = 4_000_000
"""Of a file: OpenCV stores the detected corners of all images in it as well."""
MAX_DEPTH = 20


def parse_calibration(path: pathlib.Path) -> dict[str, Any]:
    """Parse YAML, JSON or XML to named values.

    Raises:
        DataError: the file is missing, larger than ``MAX_BYTES``, or none of these.
    """
    try:
        if path.exists() and not path.is_file():  # reading a named pipe would block
            raise DataError(path, "is not a file; give the calibration file")
        if path.stat().st_size > MAX_BYTES:
            raise DataError(path, f"is larger than {MAX_BYTES / 1e6:g} MB; give the calibration file")
        text = path.read_text(encoding="utf-8-sig")
        record = _from_xml(text) if text.lstrip().startswith("<") else _from_yaml(text)
    except DataError:
        raise
    except FileNotFoundError:
        raise DataError(path, "is missing; give the calibration file") from None
    except OSError as error:
        raise DataError(path, f"cannot be read ({error.strerror}); restore the file, or its permissions") from error
    except (ValueError, RecursionError, yaml.YAMLError, xml.etree.ElementTree.ParseError) as error:
        reason = " ".join(str(error).split())
        raise DataError(path, f"is no YAML, JSON or XML of a calibration ({reason:.200}); give that file") from error
    if not isinstance(record, dict):
        raise DataError(path, "holds no named values; give the file that OpenCV or ROS wrote")
    return record


def _from_xml(text: str) -> dict[str, Any]:
    """Read OpenCV's XML: matrices have the elements rows and cols (or sizes) and data."""
    root = xml.etree.ElementTree.fromstring(text)
    return {
        node.tag: {child.tag: child.text for child in node} if len(node) else (node.text or "").strip() for node in root
    }


def _from_yaml(text: str) -> Any:
    """Read the first document of YAML, be it JSON or with OpenCV's header (%YAML:1.0) and tags (!!opencv-matrix)."""

    class Loader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):  # type: ignore[misc]
        pass

    for kind in ("matrix", "nd-matrix"):
        Loader.add_constructor(f"tag:yaml.org,2002:opencv-{kind}", _mapping)
    text = re.sub(r"\A%YAML.*\n", "", text).replace("\t", " ")
    depth = 0
    for event in yaml.parse(text, Loader):  # composing nodes recurses in C, without a limit
        depth += isinstance(event, yaml.CollectionStartEvent) - isinstance(event, yaml.CollectionEndEvent)
        if depth > MAX_DEPTH:
            raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
        if isinstance(event, yaml.DocumentEndEvent):
            break
    loader = Loader(text)
    try:
        return loader.get_data() if loader.check_data() else None
    finally:
        loader.dispose()


def _mapping(loader: Any, node: Any) -> Any:
    return loader.construct_mapping(node, deep=True)


def numbers_of(path: pathlib.Path, name: str, value: Any, count: int | None = None) -> Array:
    """Return the numbers (N,) of a matrix: nested lists, or rows, cols (or sizes) and data. Text is converted.

    Raises:
        DataError: it does not hold ``count`` finite numbers, or another number of them than its sizes.
    """
    sizes: list[Any] = []
    if isinstance(value, Mapping):
        sizes = value.get("sizes") or [value.get("rows", 1), value.get("cols", 1)]
        sizes = sizes.split() if isinstance(sizes, str) else sizes
        value = value.get("data")
    value = value.split() if isinstance(value, str) else value
    try:
        flat = [one for row in value for one in (row if isinstance(row, list | tuple) else [row])]
        found = np.array([_number(one) for one in flat[:100]])
        if sizes and math.prod(int(size) for size in sizes) != len(flat):
            raise ValueError(f"{len(flat)} numbers for the sizes {sizes}")
        if count not in (None, len(flat)) or not np.isfinite(found).all():
            raise ValueError(f"{count or 'some'} finite numbers are needed")
    except (TypeError, ValueError, OverflowError) as error:
        raise DataError(
            path, f"field {name} must hold numbers, got {value!r:.100} ({error}); restore the file"
        ) from error
    return found


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise TypeError(f"{value!r:.40} is no number")
    return float(value)


def integer_of(path: pathlib.Path, name: str, value: Any) -> int:
    """Return a whole number; raise DataError otherwise."""
    (number,) = numbers_of(path, name, [value], 1).tolist()
    if number != int(number):
        raise DataError(path, f"field {name} must be a whole number of pixels, got {value!r:.80}; restore the file")
    return int(number)
