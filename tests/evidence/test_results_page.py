"""The generated page of recorded figures, and the blocks of figures in README.md and docs/."""

import pathlib
import re
import shutil

import pytest

from deltasafe.errors import DataError
from deltasafe.io.storage import write_json
from evidence import results_page
from evidence.result_blocks import fill_blocks
from pipelines.home import PROJECT

BLOCK = re.compile(r"(<!-- results:[^>]* -->\n).*?(<!-- /results -->)", re.DOTALL)
PAGES = [PROJECT / "README.md", *sorted(path for path in (PROJECT / "docs").rglob("*.md"))]
BLOCK_PAGES = [path for path in PAGES if "<!-- results:" in path.read_text(encoding="utf-8")]


@pytest.fixture
def copied(tmp_path):
    """README.md, the pages of docs/ and the records, with every block emptied and without the results page."""
    shutil.copytree(PROJECT / "docs", tmp_path / "docs")
    shutil.copy(PROJECT / "README.md", tmp_path)
    (tmp_path / "docs" / "results" / "README.md").unlink()
    for path in BLOCK_PAGES:
        copy = tmp_path / path.relative_to(PROJECT)
        copy.write_text(BLOCK.sub(r"\1outdated\n\2", path.read_text(encoding="utf-8")), encoding="utf-8")
    return tmp_path


def test_command_writes_the_committed_pages(copied):
    assert results_page.main(["--check"], copied) == 1
    assert not (copied / "docs" / "results" / "README.md").exists()
    assert results_page.main([], copied) == 0
    for path in PAGES:
        written = (copied / path.relative_to(PROJECT)).read_text(encoding="utf-8")
        assert written == path.read_text(encoding="utf-8"), "run: make results"


def test_second_run_changes_nothing(copied, capsys):
    results_page.main([], copied)
    capsys.readouterr()
    assert results_page.main([], copied) == 0
    assert capsys.readouterr().out == ""
    assert results_page.main(["--check"], copied) == 0


def test_readme_and_docs_have_blocks():
    names = {path.relative_to(PROJECT).as_posix() for path in BLOCK_PAGES}
    assert {"README.md", "docs/explanation/safety.md", "docs/explanation/decisions.md"} <= names


def test_readme_follows_the_record(copied):
    record = copied / "docs" / "results" / "safety.json"
    changed = record.read_text(encoding="utf-8").replace('"executions": 3005.0', '"executions": 4711.0')
    record.write_text(changed, encoding="utf-8")
    results_page.main([], copied)
    assert "4711 motions" in (copied / "README.md").read_text(encoding="utf-8")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<!-- results:minutes -->\nopen", "is not closed"),
        ("<!-- results:minutes -->\n<!-- results:schemes -->\n<!-- /results -->", "minutes -->.* is not closed"),
        ("<!-- results:absent -->\n<!-- /results -->", "absent -->.* cannot be filled"),
        ("<!-- results:schemes -->\n<!-- /results -->", "schemes -->.* cannot be filled.*perception"),
    ],
)
def test_block_that_cannot_be_filled_is_an_error(text, message):
    root = pathlib.Path("root")
    with pytest.raises(DataError, match=f"page.md: .*{message}"):
        fill_blocks(text, root / "page.md", root, {})


def test_links_are_relative_to_the_page():
    root, records = pathlib.Path("root"), {"operation": {"figures": {"orchestration_share": 0.1234}}}
    block = "<!-- results:orchestration -->\n<!-- /results -->"
    text = fill_blocks(block, root / "docs" / "how-to" / "ui.md", root, records)
    assert "12.3 %" in text
    assert "](../results/operation.json)" in text
    assert "](docs/results/operation.json)" in fill_blocks(block, root / "README.md", root, records)


@pytest.mark.parametrize(
    ("line", "target", "figures", "expected"),
    [
        (("b", "ratio", ".1f"), {"at_least": 2}, {"b": 2.04}, "| ratio | 2.0 |  | at least 2 | yes |"),
        (("b", "ratio", ".1f"), {"at_least": 2}, {"b": 1.99}, "| ratio | 2.0 |  | at least 2 | **no** |"),
        (("b", "error", "g"), {"at_most": 0}, {"b": 1}, "| error | 1 |  | at most 0 | **no** |"),
        (("b", "passed", "g"), {"at_least": 1}, {"b": True}, "| passed | 1 |  | at least 1 | yes |"),
        (("b", "time", "g"), {}, {"b": 3}, "| time | 3 |  |  |  |"),
        (("b", "time", "g"), {"at_most": 4}, {}, "| time | not measured | | at most 4 | |"),
        (("b", "lines", ",.0f"), {"at_most": 36_967}, {"b": 36_968}, "| lines | 36,968 |  | at most 36,967 | **no** |"),
        (("b", "rate", ".2f"), {}, {"b": 0.5, "b_low": 0.4, "b_high": 0.6}, "| rate | 0.50 | 0.40 to 0.60 |  |  |"),
    ],
)
def test_row_has_interval_and_whether_target_is_met(line, target, figures, expected):
    assert results_page.row({"figures": figures}, *line, **target) == expected


def test_figures_have_their_command(tmp_path):
    part = {"figures": {"executions": 3000}, "command": "make it", "commit": "abc", "machine": "a machine"}
    write_json(tmp_path / "safety.json", {"figures": part["figures"], "parts": {"one": part}})
    page = results_page.results_page(tmp_path)
    assert "| executed motions | 3000 |  | at least 3000 | yes |" in page
    assert "* [safety.json](safety.json): `make it` at abc, a machine" in page


def test_every_figure_appears_once():
    template = (PROJECT / "evidence" / "templates" / "results.md.j2").read_text(encoding="utf-8")
    figures = re.findall(r'row\("(\w+)", "(\w+)"', template)
    assert len(figures) == template.count("row(") > 60
    assert len(figures) == len({*figures})
