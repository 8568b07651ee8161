"""Lists of SHA-256 digests, as ``sha256sum``, ``shasum -a 256`` and ``openssl dgst -sha256`` write them."""

import pathlib
import re
import unicodedata

from deltasafe.errors import DataError

_HEX = r"(?P<digest>[0-9a-fA-F]{64})"
_LINES = tuple(
    re.compile(line)
    for line in (
        rf"(?P<escape>\\?){_HEX} [ *](?P<name>.+)",
        rf"(?P<escape>\\?)SHA(2-)?256 ?\((?P<name>.+)\) ?= ?{_HEX}",
    )
)


def read_registry(path: str | pathlib.Path) -> dict[str, str]:
    """Read SHA-256 digests (lower case) by path, see `listed_name`.

    Blank lines, a byte order mark, both modes of ``sha256sum`` (text and binary), its escaped names, and its tagged
    form (``--tag``) are read as well.

    Raises:
        DataError: the file is missing, a line is not a digest and a path, or a path has two digests.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise DataError(path, "is missing; write it with sha256sum, or load the set without a registry")
    try:
        data = path.read_bytes()
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise DataError(path, f"cannot be read ({error}); write it with sha256sum, with names in UTF-8") from error
    registry: dict[str, str] = {}
    for number, line in enumerate(text.splitlines(), start=1):
        if not line.strip():
            continue
        match = next((match for form in _LINES if (match := form.fullmatch(line.rstrip()))), None)
        if match is None:
            raise DataError(path, f"line {number} is {line!r:.120}, not a SHA-256 and a path; write it with sha256sum")
        name, digest = match["name"], match["digest"].lower()
        if match["escape"]:
            name = re.sub(r"\\(.)", lambda escaped: {"n": "\n", "r": "\r"}.get(escaped[1], escaped[1]), name)
        name = listed_name(name)
        if registry.setdefault(name, digest) != digest:
            raise DataError(
                path, f"line {number} has another digest for {name!r} than a line before; remove one of them"
            )
    return registry


def listed_name(name: str) -> str:
    """Return a path in one form: without ``./``, and in the Unicode form NFC."""
    return unicodedata.normalize("NFC", pathlib.PurePosixPath(name).as_posix())
