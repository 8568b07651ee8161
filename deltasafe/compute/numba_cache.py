"""numba with a cache that notices every change of this package."""

import functools
import hashlib
import pathlib
import pickle
from collections.abc import Callable
from typing import Any

import numba
from numba.core import caching

__all__ = ["compiled", "inlined", "kernel"]


@functools.cache
def _digest_of_sources() -> str:
    digest = hashlib.sha256(numba.__version__.encode())
    root = pathlib.Path(__file__).parent.parent
    for path in [
        pathlib.Path(__file__),
        *sorted(root.glob("scene/*.py")),
        *sorted(root.glob("planning/**/*.py")),
        *sorted(root.glob("studies/baselines/*.py")),
    ]:
        digest.update(path.read_bytes())
    return digest.hexdigest()


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
    """``numba.njit`` whose on-disk cache is valid for exactly this state of scene and planning.

    numba itself looks only at the file that holds the function: after a change to a collision test in
    another file it would go on running the old one. The stamp of the cache is therefore a digest of all sources.
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
    cache._cache_file = _Index(cache._cache_path, cache._impl.filename_base, _digest_of_sources())
    return dispatcher
