"""Fill the blocks of measured figures in README.md and docs/ from the records in docs/results.

A block lies between ``<!-- results:NAME -->`` or ``<!-- results:NAME PART -->`` and ``<!-- /results -->``. Its text is
the template ``templates/NAME.md.j2``. A template reads the figures of ``docs/results/safety.json`` as ``safety.FIGURE``
and the whole record as ``records.safety``; ``part`` selects one of several texts of a template.
"""

import fnmatch
import pathlib
import posixpath
import re
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import read_json
from deltasafe.reporting.templates import render
from deltasafe.studies.intervals import clopper_pearson

Records = Mapping[str, dict[str, Any]]

_BLOCK = re.compile(r"(<!-- results:(\w+)(?: (\w+))? -->\n)(.*?)(<!-- /results -->)", re.DOTALL)
_MARKER = "<!-- results:"


def read_records(results: pathlib.Path) -> Records:
    """Read every JSON record of a folder, by the stem of its file name."""
    return {path.stem: read_json(path) for path in sorted(results.glob("*.json"))}


def filled_pages(root: pathlib.Path) -> dict[pathlib.Path, str]:
    """Return README.md and the pages of docs/ that have blocks, with their blocks filled.

    Raises:
        DataError: a marker is not closed, a template is missing, or a record lacks a figure of a template.
    """
    records = read_records(root / "docs" / "results")
    pages = [root / "README.md", *sorted((root / "docs").rglob("*.md"))]
    texts = {page: page.read_text(encoding="utf-8") for page in pages if root / "docs" / "results" not in page.parents}
    return {page: fill_blocks(text, page, root, records) for page, text in texts.items() if _MARKER in text}


def fill_blocks(text: str, page: pathlib.Path, root: pathlib.Path, records: Records) -> str:
    """Return the text of a page with the content of each block replaced; links are relative to the page."""
    import jinja2

    values = {
        "records": records,
        **{name: record["figures"] for name, record in records.items()},
        "exact_interval": clopper_pearson,
        "link": lambda target: posixpath.relpath(target, page.parent.relative_to(root).as_posix()),
        "percent": _percent,
        "total": _total,
    }

    def replaced(block: re.Match[str]) -> str:
        opening, name, part, content, closing = block.groups()
        if _MARKER in content:
            raise DataError(page, f"the block {opening.strip()} is not closed; add {closing} after it")
        try:
            body = render("evidence", f"{name}.md.j2", part=part, **values)
        except (jinja2.TemplateError, OSError) as error:
            raise DataError(page, f"the block {opening.strip()} cannot be filled: {error}") from error
        return f"{opening}{body.strip()}\n{closing}"

    filled, count = _BLOCK.subn(replaced, text)
    if count != text.count(_MARKER):
        raise DataError(page, "a block of results is not closed; add <!-- /results --> after it")
    return filled


def _percent(fraction: float, digits: int = 1) -> str:
    return f"{100 * fraction:.{digits}f} %"


def _total(figures: Mapping[str, float], *patterns: str) -> float:
    """Return the sum of the figures whose names match one of the patterns, for example ``executions_delta_*``."""
    return sum(value for name, value in figures.items() if any(fnmatch.fnmatchcase(name, each) for each in patterns))
