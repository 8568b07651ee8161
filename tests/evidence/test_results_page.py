"""The generated page of recorded figures."""

import pytest

from deltasafe.io.storage import write_json
from evidence import results_page
from evidence.results_page import LINES, Line


def test_page_is_up_to_date():
    assert results_page.main(["--check"]) == 0, "run: make results"


@pytest.mark.parametrize(
    ("line", "value", "row"),
    [
        (Line("a", "b", "ratio", ".1f", 2), 2.04, "| ratio | 2.0 | at least 2 | yes |"),
        (Line("a", "b", "ratio", ".1f", 2), 1.99, "| ratio | 2.0 | at least 2 | **no** |"),
        (Line("a", "b", "error", "g", at_most=0), 1, "| error | 1 | at most 0 | **no** |"),
        (Line("a", "b", "passed", "g", 1), True, "| passed | 1 | at least 1 | yes |"),
        (Line("a", "b", "time", "g"), 3, "| time | 3 |  |  |"),
        (Line("a", "b", "time", "g", at_most=4), None, "| time | not measured | at most 4 | |"),
    ],
)
def test_row_tells_whether_target_is_met(line, value, row):
    assert line.row(value) == row


def test_figures_have_their_command(tmp_path):
    part = {"figures": {"executions": 3000}, "command": "make it", "commit": "abc", "machine": "a machine"}
    write_json(tmp_path / "safety.json", {"figures": part["figures"], "parts": {"one": part}})
    page = results_page.results_page(tmp_path)
    assert "| executed motions | 3000 | at least 3000 | yes |" in page
    assert "* [safety.json](safety.json): `make it` at abc, a machine" in page


def test_every_figure_appears_once():
    figures = [(line.record, line.figure) for lines in LINES.values() for line in lines]
    assert len(figures) == len({*figures})
