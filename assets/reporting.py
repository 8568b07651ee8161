"""Pictures, reports and facts as Dagster metadata: inlined and small, since the UI serves no files of ours."""

import base64
import hashlib
import io
import pathlib
import re
import textwrap
from collections.abc import Mapping
from typing import Any, TypeAlias

import dagster as dg

__all__ = [
    "Metadata",
    "folder_facts",
    "in_short",
    "inline_jpeg",
    "inline_picture",
    "inline_report",
    "page_link",
    "readable",
    "with_opening",
]

Metadata: TypeAlias = dict[str, Any]

PAGE_BYTES = 95_000
"""Of a report with all its pictures: a page loads at once, and the event log stays small."""
_LEAST_BYTES = 20_000
_SEEN_DIFFERENCE = 5.0
"""Of a picture and its few colors (mean of all channels, of 255): above it, a photograph looks like a poster."""
_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]+)\)")

_SHORT_CHARACTERS = 900
_SHORT_COLUMNS = 60
"""What the UI shows in place, and as wide as its column shows; longer Markdown is behind a click."""

_NAMES = {
    "pa": "pixel accuracy",
    "miou": "mIoU",
    "nll": "NLL [nats]",
    "bs": "Brier score",
    "ece": "calibration error (ECE)",
    "ece_adaptive": "calibration error, adaptive bins",
    "calibration_error_signed": "calibration error, signed",
    "n_members": "members",
}
_UNITS = {"_mps": (1e3, "mm/s"), "_m": (1e3, "mm"), "_s": (1.0, "s"), "_rad": (1.0, "rad")}


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


def in_short(text: str) -> Metadata:
    """The paragraphs that a Markdown report opens with, as far as the page shows them without a click."""
    opening = text.partition("\n## ")[0].split("\n\n")
    paragraphs, shown = [part.strip() for part in opening if part.strip() and part[:1] not in "#|!"], ""
    for paragraph in paragraphs:
        broken = "  \n".join(textwrap.wrap(paragraph, _SHORT_COLUMNS, break_long_words=False))
        if len(shown) + len(broken) > _SHORT_CHARACTERS:
            break
        shown += ("\n\n" if shown else "") + broken
    return {"in short": dg.MetadataValue.md(shown)} if shown else {}


def with_opening(path: pathlib.Path) -> Metadata:
    """A Markdown report with its pictures, and before it what it says in short."""
    return {**in_short(path.read_text(encoding="utf-8")), "report": inline_report(path)}


def readable(figures: Mapping[str, float]) -> Metadata:
    """Figures under names that need no explanation, lengths in millimeters, with four significant digits."""
    shown: Metadata = {}
    for name, value in figures.items():
        words, unit = name, ""
        for suffix, (factor, symbol) in _UNITS.items():
            if name.endswith(suffix):
                words, unit, value = name.removesuffix(suffix), f" [{symbol}]", factor * value  # noqa: PLW2901
                break
        label = _NAMES.get(name) or words.replace("_", " ") + unit
        shown[label] = value if isinstance(value, int) else float(f"{value:.4g}")
    return shown


def folder_facts(folder: pathlib.Path, digest: str = "") -> Metadata:
    """Where it lies, how large it is, and what it is: for every asset alike.

    Args:
        digest: of its content, if it has one of its own; otherwise it is that of all files with their names.
    """
    files = sorted(path for path in folder.rglob("*") if path.is_file())
    return {
        "folder": dg.MetadataValue.path(str(folder)),
        "size [MB]": round(sum(path.stat().st_size for path in files) / 1e6, 3),
        "files": len(files),
        "digest": digest or _digest_of(folder, files),
    }


def _digest_of(folder: pathlib.Path, files: list[pathlib.Path]) -> str:
    digest = hashlib.sha256()
    for path in files:
        digest.update(path.relative_to(folder).as_posix().encode() + b"\0")
        with path.open("rb") as opened:
            digest.update(hashlib.file_digest(opened, "sha256").digest())
    return digest.hexdigest()[:16]


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
    """The widest that fits: few colors suit a plot, whose lettering JPEG would blur, and JPEG suits a photograph."""
    for width in (1000, 800, 640, 500, 400, 320, 240, 160):
        smaller = picture.copy()
        smaller.thumbnail((width, 4 * width))
        plot, photograph = io.BytesIO(), io.BytesIO()
        few_colors = smaller.quantize(48, method=1, dither=0)
        few_colors.save(plot, format="PNG", optimize=True)
        smaller.save(photograph, format="JPEG", quality=72, optimize=True)
        made = [(photograph.getvalue(), "jpeg")]
        if _mean_difference(smaller, few_colors.convert("RGB")) < _SEEN_DIFFERENCE:
            made.append((plot.getvalue(), "png"))
        data, kind = min(made, key=lambda one: len(one[0]))
        if len(data) <= limit_bytes:
            break
    return data, kind


def _mean_difference(one: Any, other: Any) -> float:
    """Of two pictures' channels, of 255."""
    from PIL import ImageChops, ImageStat

    means = ImageStat.Stat(ImageChops.difference(one, other)).mean
    return float(sum(means) / len(means))
