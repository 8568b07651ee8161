"""Write `docs/results/README.md`, and the blocks of figures in README.md and docs/ (`evidence.result_blocks`).

Nothing is measured here. Every figure is read from the records in docs/results, which name command, commit and machine.
"""

import argparse
import math
import pathlib
import sys
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file
from deltasafe.reporting.templates import render
from evidence.result_blocks import Records, filled_pages, read_records
from pipelines.home import PROJECT


def row(
    record: Mapping[str, Any],
    figure: str,
    description: str,
    form: str = ".3g",
    *,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> str:
    """Format a row of the page: a figure, its interval ``NAME_low`` to ``NAME_high`` if recorded, and its target."""
    figures = record.get("figures", {})
    target = f"at least {_plain(at_least)}" if math.isfinite(at_least) else ""
    target = f"at most {_plain(at_most)}" if math.isfinite(at_most) else target
    value = figures.get(figure)
    if value is None:
        return f"| {description} | not measured | | {target} | |"
    low, high = figures.get(f"{figure}_low"), figures.get(f"{figure}_high")
    interval = "" if low is None or high is None else f"{low:{form}} to {high:{form}}"
    met = "" if not target else ("yes" if at_least <= value <= at_most else "**no**")
    return f"| {description} | {float(value):{form}} | {interval} | {target} | {met} |"


def origins(records: Records, *names: str) -> str:
    """List command, commit and machine of every part of the named records."""
    return "\n".join(
        f"* [{name}.json]({name}.json): `{part['command']}` at {part['commit']}, {part['machine']}"
        for name in names
        if (record := records.get(name))
        for part in record.get("parts", {"": record}).values()
    )


def _plain(bound: float) -> str:
    return f"{bound:,.0f}" if bound >= 10_000 else f"{bound:g}"


def generated_pages(root: pathlib.Path = PROJECT) -> dict[pathlib.Path, str]:
    """Create the text of every page of a checkout that holds figures.

    Raises:
        DataError: a block of a page cannot be filled.
    """
    results = root / "docs" / "results"
    return {results / "README.md": results_page(results), **filled_pages(root)}


def results_page(results: pathlib.Path) -> str:
    """Create the page from the records in a folder; the template ``results.md.j2`` names figures and targets."""
    records = read_records(results)
    return render(
        "evidence",
        "results.md.j2",
        reports=sorted(path.parent.name for path in results.glob("*/report.md")),
        row=lambda name, *line, **target: row(records.get(name, {}), *line, **target),
        origins=lambda *names: origins(records, *names),
    )


def main(arguments: list[str] | None = None, root: pathlib.Path = PROJECT) -> int:
    """Run ``python -m evidence.results_page``."""
    parser = argparse.ArgumentParser(prog="python -m evidence.results_page", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a page is outdated")
    options = parser.parse_args(arguments)
    try:
        pages = generated_pages(root)
    except DataError as error:
        sys.exit(f"results_page: {error}")
    outdated = [page for page, text in pages.items() if not page.is_file() or page.read_text(encoding="utf-8") != text]
    for page in outdated:
        print(f"{'outdated' if options.check else 'written'}: {page.relative_to(root)}")
        if not options.check:
            with atomic_file(page) as temporary:
                temporary.write_text(pages[page], encoding="utf-8")
    return int(options.check and bool(outdated))


if __name__ == "__main__":
    sys.exit(main())
