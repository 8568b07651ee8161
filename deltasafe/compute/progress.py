"""Progress reports of long work: a callable `progress(done, total, message)`."""

from collections.abc import Callable
from typing import TypeAlias

Progress: TypeAlias = Callable[[int, int, str], None]


def silent(done: int, total: int, message: str) -> None:
    """Do nothing: the default progress callback."""
