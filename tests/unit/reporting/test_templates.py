"""Report templates: filled with values, tables included, and strict about what is missing."""

import importlib
import sys

import jinja2
import pytest

from deltasafe.reporting.templates import render


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A package with one template, named after the test's folder so that no cache is shared."""
    name = f"package_{tmp_path.name}"
    folder = tmp_path / name / "templates"
    folder.mkdir(parents=True)
    (folder.parent / "__init__.py").write_text("")
    (folder / "report.md.j2").write_text(
        "# {{ title }}\n{% for rate in rates %}\n* {{ percent(rate) }}\n{% endfor %}\n{{ table(['a', 'b'], rows) }}\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    importlib.invalidate_caches()
    yield name
    sys.modules.pop(name, None)


def test_a_template_is_filled_with_values_and_tables(package):
    text = render(package, "report.md.j2", title="A <b> & c", rates=[0.5, 0.25], rows=[["1", "2"]])
    assert text.startswith("# A <b> & c\n* 50.00%\n* 25.00%\n")
    assert text.splitlines()[-1].replace(" ", "") == "|1|2|"


def test_a_missing_value_is_an_error(package):
    with pytest.raises(jinja2.UndefinedError, match="rates"):
        render(package, "report.md.j2", title="A", rows=[])
