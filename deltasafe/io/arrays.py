"""Read arrays that other programs wrote: no pickle, bounded memory, typed errors."""

import pathlib
import struct
import zipfile
import zlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.errors import DataError

MAX_BYTES = 2 * 1024**3
"""Limit for the decompressed arrays of one file together. A few kilobytes can claim to hold more than any memory."""

READ_ERRORS = (
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
"""Exceptions that damaged or malicious zip files and arrays are known to raise."""


def read_npz(path: str | pathlib.Path) -> dict[str, NDArray[Any]]:
    """Read all arrays of an ``.npz`` file, by name.

    Raises:
        DataError: the file is missing, damaged, larger than ``MAX_BYTES`` when decompressed, or holds pickled objects.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise DataError(path, "is missing; restore the file")
    try:
        with zipfile.ZipFile(path) as parts:
            n_bytes = sum(part.file_size for part in parts.infolist())
        if n_bytes > MAX_BYTES:
            raise DataError(path, f"has {n_bytes} bytes when decompressed, more than {MAX_BYTES}; give a smaller file")
        with path.open("rb") as stream, np.load(stream, allow_pickle=False) as arrays:
            return dict(arrays)
    except DataError:
        raise
    except READ_ERRORS as error:
        raise DataError(path, f"is not readable ({' '.join(str(error).split())}); restore the file") from error
