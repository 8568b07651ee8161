"""Pictures and reports as Dagster metadata: inlined, since the UI serves no files of ours."""

import base64
import io
import pathlib
from typing import Any, TypeAlias

import dagster as dg

__all__ = ["Metadata", "inline_picture", "inline_report"]

Metadata: TypeAlias = dict[str, Any]

_LIMIT_BYTES = 1_500_000


def inline_picture(path: pathlib.Path, width: int = 1000) -> dg.MarkdownMetadataValue:
    """A picture as Markdown; heavy ones are shown as JPEG of at most that ``width``."""
    from PIL import Image

    data, kind = path.read_bytes(), path.suffix.lstrip(".").lower()
    if kind in ("png", "jpg") and len(data) > 200_000:
        stream = io.BytesIO()
        with Image.open(path) as picture:
            reduced = picture.convert("RGB")
        reduced.thumbnail((width, 4 * width))
        reduced.save(stream, format="JPEG", quality=80)
        data, kind = stream.getvalue(), "jpeg"
    if len(data) > _LIMIT_BYTES:
        return dg.MetadataValue.md(f"[{path.name}]({path}) ({len(data) / 1e6:.1f} MB)")
    return dg.MetadataValue.md(f"![{path.stem}](data:image/{kind};base64,{base64.b64encode(data).decode()})")


def inline_report(path: pathlib.Path) -> dg.MarkdownMetadataValue:
    """A Markdown report with the pictures beside it inlined."""
    from deltasafe.perception.calibration_writing import inline_pictures

    return dg.MetadataValue.md(inline_pictures(path))
