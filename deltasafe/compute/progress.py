"""How long work reports that it is alive: one callable, `progress(done, total, message)`."""

from collections.abc import Callable
from typing import TypeAlias

__all__ = ["Progress", "silent"]

Progress: TypeAlias = Callable[[int, int, str], None]


def silent(done: int, total: int, message: str) -> None:
    """The progress of whoever does not want to hear of it."""
