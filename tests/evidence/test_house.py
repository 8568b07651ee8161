"""Measurements of the repository: functions, import cycles, tracked files, warnings of the documentation build."""

import pytest

from deltasafe.errors import SettingsError
from evidence import house
from evidence.house import Function, cycles, docs_warnings, functions, python_files

SOURCE = """
@decorator
def plain(a, /, b, *args, c, **kwargs):
    def inner():
        return 1

    return inner


class Box:
    def method(self, a): ...

    @classmethod
    async def make(cls): ...

    @staticmethod
    def free(a, b): ...


if True:
    def late(self): ...
"""


def test_functions_have_lines_and_parameters_without_self():
    assert functions(SOURCE) == [
        Function("plain", 5, 5),
        Function("plain.inner", 2, 0),
        Function("Box.method", 1, 1),
        Function("Box.make", 1, 0),
        Function("Box.free", 1, 2),
        Function("late", 1, 1),
    ]


def test_cycles_are_groups_that_reach_each_other():
    assert cycles([("a", "b"), ("b", "c"), ("a", "c")]) == []
    assert cycles([("a", "b"), ("b", "c"), ("c", "a"), ("c", "d"), ("x", "y"), ("y", "x")]) == [
        ["a", "b", "c"],
        ["x", "y"],
    ]
    assert cycles([]) == []


def test_tracked_files_exclude_tests(tmp_path):
    names = [path.relative_to(house.PROJECT).as_posix() for path in python_files()]
    assert "evidence/house.py" in names
    assert not [name for name in names if name.startswith("tests/")]
    with pytest.raises(SettingsError, match="not a git checkout"):
        python_files(tmp_path)


def test_warnings_of_the_documentation_are_counted(tmp_path):
    program = tmp_path / "mkdocs"
    program.write_text(
        "#!/bin/sh\necho 'WARNING -  one' >&2\necho 'INFO -  two' >&2\necho 'ERROR -  three' >&2\nexit 1\n"
    )
    program.chmod(0o755)
    assert docs_warnings(str(program), tmp_path) == ["WARNING -  one", "ERROR -  three"]
    program.write_text("#!/bin/sh\necho 'Traceback' >&2\nexit 1\n")
    assert docs_warnings(str(program), tmp_path) == ["ERROR: exit status 1: Traceback\n"]
    program.write_text("#!/bin/sh\nexit 0\n")
    assert docs_warnings(str(program), tmp_path) == []


def test_missing_mkdocs_leaves_the_figure_out(monkeypatch):
    monkeypatch.setattr("importlib.util.find_spec", lambda name: None)
    assert docs_warnings() is None
