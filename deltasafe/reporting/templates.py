"""Report texts as Jinja2 templates, so that prose can be edited without touching code."""

import functools
import importlib.resources
from typing import Any

from deltasafe.reporting.markdown import number, percent, plus_minus, table


def render(package: str, name: str, /, **values: Any) -> str:
    """Render the template ``templates/NAME`` of a package.

    ``table(head, rows)``, ``percent``, ``plus_minus`` and the filter ``number`` of `deltasafe.reporting.markdown` are
    available in templates.

    Args:
        package: dotted name of the package that holds the folder ``templates``.
        name: file name of the template, for example ``report.md.j2``.
        values: variables of the template; a missing one raises ``jinja2.UndefinedError``.
    """
    return str(_environment(package).get_template(name).render(**values))


@functools.cache
def _environment(package: str) -> Any:
    import jinja2

    folder = importlib.resources.files(package) / "templates"
    environment = jinja2.Environment(
        loader=jinja2.FunctionLoader(lambda name: (folder / name).read_text(encoding="utf-8")),
        undefined=jinja2.StrictUndefined,
        autoescape=False,  # the output is Markdown, and all values are our own
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.globals.update(table=table, percent=percent, plus_minus=plus_minus)
    environment.filters["number"] = number
    return environment
