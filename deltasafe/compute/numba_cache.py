"""numba with a cache that notices every change of this package."""

import functools
import pickle
from collections.abc import Callable
from typing import Any

import numba
from numba.core import caching

from deltasafe.compute.code_digest import digest_of_importers

__all__ = ["compiled", "inlined", "kernel"]


class _Index(caching.IndexDataCacheFile):
    """A cache index that is empty, not fatal, if it names types that this process cannot import.

    A constraint defined in somebody's script or test is such a type for everybody else.
    """

    def _load_index(self) -> dict[Any, str]:
        try:
            return dict(super()._load_index())
        except (ImportError, AttributeError, EOFError, pickle.UnpicklingError):
            return {}


def compiled(function: Callable[..., Any]) -> Any:
    """``numba.njit`` whose on-disk cache is valid for exactly this state of the compiled modules.

    numba itself checks only the file that holds the function: after a change of a collision test in another file it
    would keep running the old one. The stamp of the cache is therefore a digest of all modules that compile functions.
    """
    return _cached(numba.njit(cache=True)(function))


def kernel(function: Callable[..., Any]) -> Any:
    """``compiled`` for a function that makes no arrays: it counts no references to those that it is given.

    Counting them for every array of a nested tuple at every call takes longer than a look-up, and many times longer
    to compile. numba refuses to compile a kernel that allocates.
    """
    return _cached(numba.njit(cache=True, _nrt=False)(function))


def inlined(function: Callable[..., Any]) -> Any:
    """``kernel`` that becomes part of its callers: tables of arrays are not copied from call to call.

    A named tuple of arrays is passed by value, a hundred words or more, which costs more than many a look-up.
    """
    return _cached(numba.njit(cache=True, _nrt=False, forceinline=True)(function))


def _cached(dispatcher: Any) -> Any:
    cache = dispatcher._cache
    cache._cache_file = _Index(cache._cache_path, cache._impl.filename_base, _stamp())
    return dispatcher


@functools.cache
def _stamp() -> str:
    """Digest of all modules that compile functions: a compiled search contains whatever test it was given by type."""
    return f"{numba.__version__} {digest_of_importers(__name__)}"
