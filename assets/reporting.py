"""Pictures, reports and facts as Dagster metadata: inlined and small, since the UI serves no files of ours."""

import base64
import io
import pathlib
import re
from typing import Any, TypeAlias

import dagster as dg

__all__ = ["Metadata", "folder_facts", "inline_jpeg", "inline_picture", "inline_report", "page_link"]

Metadata: TypeAlias = dict[str, Any]

PAGE_BYTES = 95_000
"""Of a report with all its pictures: a page loads at once, and the event log stays small."""
_LEAST_BYTES = 20_000
_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]+)\)")


def inline_picture(path: pathlib.Path, limit_bytes: int = PAGE_BYTES) -> dg.MarkdownMetadataValue:
    """A picture as Markdown, reduced until it fits; of a film its middle."""
    return dg.MetadataValue.md(_inlined(path, path.stem, limit_bytes))


def inline_jpeg(data: bytes, title: str) -> dg.MarkdownMetadataValue:
    """A JPEG that was never a file."""
    return dg.MetadataValue.md(f"![{title}](data:image/jpeg;base64,{base64.b64encode(data).decode()})")


def inline_report(path: pathlib.Path, limit_bytes: int = PAGE_BYTES) -> dg.MarkdownMetadataValue:
    """A Markdown report with the pictures beside it; they share what its text leaves of the limit.

    Where there are too many of them for all to be readable, the last ones are named instead.
    """
    text = path.read_text(encoding="utf-8")
    names = [match.group(2) for match in _PICTURE.finditer(text)]
    room = limit_bytes - len(text.encode("utf-8"))
    shown = names[: max(1, room // _LEAST_BYTES)]
    share = room // max(1, len(shown))

    def inline(match: re.Match[str]) -> str:
        title, name = match.groups()
        if name not in shown:
            return f"*{title}: `{path.parent / name}`*"
        return _inlined(path.parent / name, title, share)

    return dg.MetadataValue.md(_PICTURE.sub(inline, text))


def folder_facts(folder: pathlib.Path, digest: str = "") -> Metadata:
    """Where it lies, how large it is, and what it is: for every asset alike."""
    sizes = [path.stat().st_size for path in folder.rglob("*") if path.is_file()]
    facts: Metadata = {
        "folder": dg.MetadataValue.path(str(folder)),
        "size [MB]": round(sum(sizes) / 1e6, 3),
        "files": len(sizes),
    }
    return {**facts, "digest": digest} if digest else facts


def page_link(address: str | None) -> Metadata:
    """Link to the page of the experiment's run, if it has one by now."""
    return {"MLflow run": dg.MetadataValue.url(address)} if address else {}


def _inlined(path: pathlib.Path, title: str, limit_bytes: int) -> str:
    from PIL import Image

    data, kind = path.read_bytes(), path.suffix.lstrip(".").lower()
    whole = kind in ("png", "jpg", "jpeg") and len(data) * 4 // 3 < limit_bytes - 100
    if not whole:
        with Image.open(path) as opened:
            opened.seek(getattr(opened, "n_frames", 1) // 2)
            picture = opened.convert("RGB")
        data, kind = _reduced(picture, (limit_bytes - 100) * 3 // 4)
    return f"![{title}](data:image/{kind};base64,{base64.b64encode(data).decode()})"


def _reduced(picture: Any, limit_bytes: int) -> tuple[bytes, str]:
    """The widest that fits: few colours suit a plot, whose lettering JPEG would blur, and JPEG suits a photograph."""
    for width in (1000, 800, 640, 500, 400, 320, 240, 160):
        smaller = picture.copy()
        smaller.thumbnail((width, 4 * width))
        plot, photograph = io.BytesIO(), io.BytesIO()
        smaller.quantize(48, method=1, dither=0).save(plot, format="PNG", optimize=True)
        smaller.save(photograph, format="JPEG", quality=72, optimize=True)
        data, kind = min((plot.getvalue(), "png"), (photograph.getvalue(), "jpeg"), key=lambda made: len(made[0]))
        if len(data) <= limit_bytes:
            break
    return data, kind
