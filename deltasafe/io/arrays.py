"""Reading arrays that others have written: no pickle, no more memory than a file of its kind may need, typed errors."""

import pathlib
import struct
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError

__all__ = ["MOST_BYTES", "UNREADABLE", "read_npz"]

MOST_BYTES = 2 * 1024**3
"""Of all arrays of a file together, unpacked; a few kilobytes can claim to hold more than any memory does."""

UNREADABLE = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    MemoryError,
    NotImplementedError,
    RuntimeError,
    struct.error,
    zlib.error,
    zipfile.BadZipFile,
)
"""What zip files and arrays that were damaged, or made to deceive, are known to raise."""


def read_npz(path: str | pathlib.Path) -> dict[str, NDArray[Any]]:
    """All arrays of an ``.npz`` file, by name.

    Raises:
        DataError: the file is missing, damaged, or would take more than ``MOST_BYTES``; or it holds pickled objects.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise DataError(path, "is missing; restore the file")
    try:
        with zipfile.ZipFile(path) as parts:
            unpacked = sum(part.file_size for part in parts.infolist())
        if unpacked > MOST_BYTES:
            raise DataError(path, f"holds {unpacked} bytes unpacked, more than {MOST_BYTES}; give a smaller file")
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return dict(arrays)
    except DataError:
        raise
    except UNREADABLE as error:
        raise DataError(path, f"is not readable ({' '.join(str(error).split())}); restore the file") from error
