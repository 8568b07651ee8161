"""Markdown tables, and numbers as reports print them."""

import math
from collections.abc import Iterable, Sequence


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Format a Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def plus_minus(mean: float, sd: float | None) -> str:
    """Format mean and standard deviation; the mean alone if ``sd`` is None."""
    return f"{mean:.4f}" if sd is None else f"{mean:.4f} ± {sd:.4f}"


def percent(value: float | None, none: str = "-") -> str:
    """Format a fraction; ``none`` stands for None."""
    return none if value is None else f"{value:.2%}"


def number(value: float | None, form: str, missing: str = "") -> str:
    """Format a number, for example by ``.2%``; ``missing`` stands for None, NaN and infinity."""
    return missing if value is None or not math.isfinite(value) else f"{value:{form}}"
