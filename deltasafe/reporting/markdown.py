"""Tables of reports."""

from collections.abc import Iterable, Sequence

__all__ = ["percent", "plus_minus", "table"]


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def plus_minus(mean: float, sd: float | None) -> str:
    """Mean and standard deviation; the mean alone where there is no deviation."""
    return f"{mean:.4f}" if sd is None else f"{mean:.4f} ± {sd:.4f}"


def percent(value: float | None) -> str:
    """A share of a hand; None is an image without one."""
    return "no hand" if value is None else f"{value:.2%}"
