"""Which process bears a number: numbers are given away again, the number and the start together are not."""

import pathlib

__all__ = ["start_ticks"]


def start_ticks(pid: int) -> int | None:
    """When the process began, in ticks since the machine did; None where that cannot be told (no /proc).

    Raises:
        ProcessLookupError: there is none of that number; one that has ended and was not waited for yet is none.
    """
    if not pathlib.Path("/proc/self/stat").is_file():
        return None
    try:
        fields = pathlib.Path("/proc", str(pid), "stat").read_text(encoding="utf-8").rpartition(")")[2].split()
    except OSError:
        raise ProcessLookupError(pid) from None
    if fields[0] in "ZX":
        raise ProcessLookupError(pid)
    return int(fields[19])
