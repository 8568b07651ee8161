"""numba decorators with an on-disk cache that becomes invalid when any compiled module changes."""

import contextlib
import functools
import os
import pathlib
import pickle
import tempfile
from collections.abc import Callable
from typing import Any

import numba
from numba.core import caching

from deltasafe.compute.code_digest import digest_of_importers


class _Index(caching.IndexDataCacheFile):
    """Cache index that counts as empty if it names types that this process cannot import.

    A script or a test may define its own constraint type; other processes cannot import it.
    """

    def _load_index(self) -> dict[Any, str]:
        try:
            return dict(super()._load_index())
        except (ImportError, AttributeError, EOFError, pickle.UnpicklingError):
            return {}


def compiled(function: Callable[..., Any]) -> Any:
    """Compile with ``numba.njit`` and cache on disk, keyed by the source of all compiled modules.

    numba itself checks only the file of the function. A compiled search contains the segment test of its constraint
    type, so that a change of that test in another file must invalidate the search as well.
    """
    return _cached(function)


def kernel(function: Callable[..., Any]) -> Any:
    """``compiled`` without reference counting, for functions that allocate no arrays.

    Counting references to each array of a nested tuple at each call takes longer than a table look-up, and compiles
    many times slower. numba refuses to compile a kernel that allocates.
    """
    return _cached(function, _nrt=False)


def inlined(function: Callable[..., Any]) -> Any:
    """``kernel`` that is always inlined.

    numba passes a named tuple of arrays by value, a hundred words or more, which costs more than most look-ups.
    """
    return _cached(function, _nrt=False, forceinline=True)


def _cached(function: Callable[..., Any], **options: bool) -> Any:
    try:
        dispatcher = numba.njit(cache=True, **options)(function)
    except RuntimeError:  # the folder of the code and the user's cache folder are read-only
        numba.config.CACHE_DIR = os.environ["NUMBA_CACHE_DIR"] = _own_folder()
        dispatcher = numba.njit(cache=True, **options)(function)
    cache = dispatcher._cache
    cache._cache_file = _Index(cache._cache_path, cache._impl.filename_base, _stamp())
    return dispatcher


def _own_folder() -> str:
    """Return a cache folder below `$DELTASAFE_HOME`, or below the temporary folder.

    numba unpickles what it finds there, so a folder that others can write to is not used.
    """
    user, home = os.getuid(), os.environ.get("DELTASAFE_HOME")
    temporary = pathlib.Path(tempfile.gettempdir(), f"deltasafe-numba-{user}")
    for folder in ([pathlib.Path(home, "cache", "numba")] if home else []) + [temporary]:
        with contextlib.suppress(OSError):
            folder.mkdir(mode=0o700, parents=True, exist_ok=True)
            stat = folder.lstat()
            is_private = stat.st_uid == user and not stat.st_mode & 0o022 and not folder.is_symlink()
            if is_private and os.access(folder, os.W_OK):
                return str(folder)
    return tempfile.mkdtemp(prefix="deltasafe-numba-")


@functools.cache
def _stamp() -> str:
    """Cache key: version of numba and digest of all modules that use these decorators."""
    return f"{numba.__version__} {digest_of_importers(__name__)}"
