"""numba decorators with an on-disk cache that becomes invalid when any compiled module changes."""

import functools
import pickle
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
    return _cached(numba.njit(cache=True)(function))


def kernel(function: Callable[..., Any]) -> Any:
    """``compiled`` without reference counting, for functions that allocate no arrays.

    Counting references to each array of a nested tuple at each call takes longer than a table look-up, and compiles
    many times slower. numba refuses to compile a kernel that allocates.
    """
    return _cached(numba.njit(cache=True, _nrt=False)(function))


def inlined(function: Callable[..., Any]) -> Any:
    """``kernel`` that is always inlined.

    numba passes a named tuple of arrays by value, a hundred words or more, which costs more than most look-ups.
    """
    return _cached(numba.njit(cache=True, _nrt=False, forceinline=True)(function))


def _cached(dispatcher: Any) -> Any:
    cache = dispatcher._cache
    cache._cache_file = _Index(cache._cache_path, cache._impl.filename_base, _stamp())
    return dispatcher


@functools.cache
def _stamp() -> str:
    """Cache key: version of numba and digest of all modules that use these decorators."""
    return f"{numba.__version__} {digest_of_importers(__name__)}"
