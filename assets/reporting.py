"""Pictures, reports and facts as Dagster metadata. Pictures are inlined and small: the UI cannot serve files."""

import base64
import hashlib
import io
import pathlib
import re
import textwrap
from collections.abc import Mapping
from typing import Any, TypeAlias

import dagster as dg

Metadata: TypeAlias = dict[str, Any]

PAGE_BYTES = 95_000
"""Limit for a report with its pictures, so that pages load fast and the event log stays small."""
_MIN_PICTURE_BYTES = 20_000
_VISIBLE_DIFFERENCE = 5.0
"""Largest acceptable mean difference (of 255) between a picture and its version with 48 colors."""
_PICTURE = re.compile(r"!\[([^\]]*)\]\(([^)]+)\)")

_SUMMARY_CHARACTERS = 900
_SUMMARY_COLUMNS = 60
"""Length and width up to which the UI shows Markdown in place; longer text needs a click."""

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
    """Return a picture, or the middle frame of a film, as Markdown of at most ``limit_bytes``."""
    return dg.MetadataValue.md(_inlined(path, path.stem, limit_bytes))


def inline_jpeg(data: bytes, title: str) -> dg.MarkdownMetadataValue:
    """Return JPEG data as Markdown."""
    return dg.MetadataValue.md(f"![{title}](data:image/jpeg;base64,{base64.b64encode(data).decode()})")


def inline_report(path: pathlib.Path, limit_bytes: int = PAGE_BYTES) -> dg.MarkdownMetadataValue:
    """Return a Markdown report with inlined pictures, which share the bytes that the text leaves.

    If there are too many pictures, the last ones are replaced by their paths.
    """
    text = path.read_text(encoding="utf-8")
    names = [match.group(2) for match in _PICTURE.finditer(text)]
    n_bytes = limit_bytes - len(text.encode("utf-8"))
    shown = names[: max(1, n_bytes // _MIN_PICTURE_BYTES)]
    bytes_each = n_bytes // max(1, len(shown))

    def inline(match: re.Match[str]) -> str:
        title, name = match.groups()
        if name not in shown:
            return f"*{title}: `{path.parent / name}`*"
        return _inlined(path.parent / name, title, bytes_each)

    return dg.MetadataValue.md(_PICTURE.sub(inline, text))


def summary_of(text: str) -> Metadata:
    """Return the first paragraphs of a Markdown report, as many as the page shows without a click."""
    opening = text.partition("\n## ")[0].split("\n\n")
    paragraphs, shown = [part.strip() for part in opening if part.strip() and part[:1] not in "#|!"], ""
    for paragraph in paragraphs:
        wrapped = "  \n".join(textwrap.wrap(paragraph, _SUMMARY_COLUMNS, break_long_words=False))
        if len(shown) + len(wrapped) > _SUMMARY_CHARACTERS:
            break
        shown += ("\n\n" if shown else "") + wrapped
    return {"summary": dg.MetadataValue.md(shown)} if shown else {}


def report_with_summary(path: pathlib.Path) -> Metadata:
    """Return the summary of a Markdown report, and the report with inlined pictures."""
    return {**summary_of(path.read_text(encoding="utf-8")), "report": inline_report(path)}


def readable(figures: Mapping[str, float | None], thing: str = "hand") -> Metadata:
    """Return figures with descriptive names, lengths in millimeters, and four significant digits; None: not judged.

    ``thing`` is the display name of the obstacle, which the names of figures call a hand.
    """
    shown: Metadata = {}
    for name, value in figures.items():
        words, unit = name, ""
        for suffix, (factor, symbol) in _UNITS.items():
            if name.endswith(suffix):
                words, unit = name.removesuffix(suffix), f" [{symbol}]"
                value = None if value is None else factor * value  # noqa: PLW2901
                break
        label = _NAMES.get(name) or re.sub(r"\bhand\b", thing, words.replace("_", " ")) + unit
        shown[label] = "not judged" if value is None else value if isinstance(value, int) else float(f"{value:.4g}")
    return shown


def folder_facts(folder: pathlib.Path, digest: str = "") -> Metadata:
    """Return path, size, number of files and digest of a folder, the same for all assets.

    Args:
        digest: a known digest of the content; by default, a digest of all files and their names.
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
    """Return a link to the page of the MLflow run; nothing if the run is not recorded yet."""
    return {"MLflow run": dg.MetadataValue.url(address)} if address else {}


def _inlined(path: pathlib.Path, title: str, limit_bytes: int) -> str:
    from PIL import Image

    data, kind = path.read_bytes(), path.suffix.lstrip(".").lower()
    fits = kind in ("png", "jpg", "jpeg") and len(data) * 4 // 3 < limit_bytes - 100
    if not fits:
        with Image.open(path) as opened:
            opened.seek(getattr(opened, "n_frames", 1) // 2)
            picture = opened.convert("RGB")
        data, kind = _reduced(picture, (limit_bytes - 100) * 3 // 4)
    return f"![{title}](data:image/{kind};base64,{base64.b64encode(data).decode()})"


def _reduced(picture: Any, limit_bytes: int) -> tuple[bytes, str]:
    """Return the widest version that fits: PNG with few colors for plots, whose text JPEG would blur, else JPEG."""
    for width in (1000, 800, 640, 500, 400, 320, 240, 160):
        smaller = picture.copy()
        smaller.thumbnail((width, 4 * width))
        plot, photograph = io.BytesIO(), io.BytesIO()
        few_colors = smaller.quantize(48, method=1, dither=0)
        few_colors.save(plot, format="PNG", optimize=True)
        smaller.save(photograph, format="JPEG", quality=72, optimize=True)
        candidates = [(photograph.getvalue(), "jpeg")]
        if _mean_difference(smaller, few_colors.convert("RGB")) < _VISIBLE_DIFFERENCE:
            candidates.append((plot.getvalue(), "png"))
        data, kind = min(candidates, key=lambda candidate: len(candidate[0]))
        if len(data) <= limit_bytes:
            break
    return data, kind


def _mean_difference(one: Any, other: Any) -> float:
    """Return the mean difference of all pixels and channels, of 255."""
    from PIL import ImageChops, ImageStat

    means = ImageStat.Stat(ImageChops.difference(one, other)).mean
    return float(sum(means) / len(means))
