"""Measure the repository itself: its size, its longest parts, import cycles, and warnings of the documentation build.

Tests are not counted. A room is a first-level part of ``deltasafe``, ``deltasafe.perception``, ``deltasafe.planning``
or ``deltasafe.studies``. The number of questions that a new reader could answer is not measured here: pass it with
``--reader-found``.
"""

import ast
import dataclasses
import importlib.util
import os
import pathlib
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import connected_components

from deltasafe.errors import SettingsError
from evidence.reporting import command_parser, finish
from pipelines.home import PROJECT

PACKAGES = ("deltasafe", "assets", "pipelines", "generator", "evidence")
ROOMS = ("deltasafe", "deltasafe.perception", "deltasafe.planning", "deltasafe.studies")


@dataclasses.dataclass(frozen=True)
class Function:
    """A function or method: its qualified name, its lines from ``def`` to the end, and its number of parameters."""

    name: str
    lines: int
    parameters: int


def python_files(root: pathlib.Path = PROJECT) -> list[pathlib.Path]:
    """Return the Python files that git tracks, without tests.

    Raises:
        SettingsError: the folder is not a git checkout.
    """
    listed = subprocess.run(["git", "ls-files", "*.py"], cwd=root, capture_output=True, text=True, check=False)
    if listed.returncode != 0:
        raise SettingsError(f"{root} is not a git checkout, so its tracked files are unknown: {listed.stderr.strip()}")
    return [root / name for name in listed.stdout.splitlines() if not name.startswith("tests/")]


def functions(source: str) -> list[Function]:
    """Return every function of a module, nested ones and methods included.

    ``self`` and ``cls`` are not parameters; ``*args`` and ``**kwargs`` are one parameter each.
    """
    return list(_functions(ast.parse(source), "", in_class=False))


def _functions(node: ast.AST, prefix: str, in_class: bool) -> Iterator[Function]:
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.FunctionDef | ast.AsyncFunctionDef):
            name = prefix + child.name
            yield Function(name, (child.end_lineno or child.lineno) - child.lineno + 1, _parameters(child, in_class))
            yield from _functions(child, f"{name}.", in_class=False)
        elif isinstance(child, ast.ClassDef):
            yield from _functions(child, f"{prefix}{child.name}.", in_class=True)
        else:
            yield from _functions(child, prefix, in_class)


def _parameters(function: ast.FunctionDef | ast.AsyncFunctionDef, in_class: bool) -> int:
    arguments = function.args
    positional = [*arguments.posonlyargs, *arguments.args]
    bound = in_class and bool(positional) and positional[0].arg in ("self", "cls")
    starred = (arguments.vararg is not None) + (arguments.kwarg is not None)
    return len(positional) - bound + len(arguments.kwonlyargs) + starred


def cycles(edges: Iterable[tuple[str, str]]) -> list[list[str]]:
    """Return the groups of nodes of a directed graph that reach each other (strongly connected, at least two)."""
    pairs = sorted({*edges})
    nodes = sorted({node for pair in pairs for node in pair})
    if not nodes:
        return []
    index = {node: place for place, node in enumerate(nodes)}
    rows, columns = np.array([(index[start], index[end]) for start, end in pairs]).T
    graph = csr_array((np.ones(len(rows)), (rows, columns)), shape=(len(nodes), len(nodes)))
    _, labels = connected_components(graph, directed=True, connection="strong")
    groups = [[node for node in nodes if labels[index[node]] == label] for label in range(labels.max() + 1)]
    return [group for group in groups if len(group) > 1]


def import_cycles() -> dict[str, list[list[str]]]:
    """Return the import cycles between modules, and between the rooms of each package of ``ROOMS``.

    Imports inside functions count. Imports for type checkers only (``if TYPE_CHECKING:``) do not.
    """
    import grimp

    graph = grimp.build_graph(*PACKAGES, exclude_type_checking_imports=True, cache_dir=None)
    edges = [(module, other) for module in graph.modules for other in graph.find_modules_directly_imported_by(module)]
    found = {"modules": cycles(edges)}
    for package in ROOMS:
        rooms = ((_room(start, package), _room(end, package)) for start, end in edges)
        found[package] = cycles((start, end) for start, end in rooms if start and end and start != end)
    return found


def _room(module: str, package: str) -> str:
    """Return the part of a package that a module belongs to; empty for other packages and for the package itself."""
    inside = module.removeprefix(f"{package}.")
    return inside.partition(".")[0] if inside != module else ""


def docs_warnings(mkdocs: str = "", root: pathlib.Path = PROJECT) -> list[str] | None:
    """Return the warnings and errors of a build of the documentation site.

    Args:
        mkdocs: the program; by default that of the running interpreter. Without it the result is None.
    """
    if not mkdocs and importlib.util.find_spec("mkdocs") is None:
        return None
    command = [mkdocs] if mkdocs else [sys.executable, "-m", "mkdocs"]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1", "PYTHONPATH": str(root)}
    with tempfile.TemporaryDirectory() as site:
        built = subprocess.run(
            [*command, "build", "--no-strict", "--site-dir", site],
            cwd=root,
            env=environment,
            capture_output=True,
            text=True,
            check=False,
        )
    lines = built.stderr.replace(f"{root}/", "").splitlines()
    warnings = [line for line in lines if line.startswith(("WARNING", "ERROR"))]
    return warnings or ([f"ERROR: exit status {built.returncode}: {built.stderr[-500:]}"] if built.returncode else [])


def _longest(sizes: Mapping[str, int]) -> tuple[str, int]:
    name = max(sizes, key=lambda each: (sizes[each], each))
    return name, sizes[name]


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.house``."""
    parser = command_parser("house", __doc__)
    parser.add_argument(
        "--reader-found", type=int, metavar="N", help="answers that a new reader found, of 15 questions"
    )
    parser.add_argument("--mkdocs", default="", metavar="PROGRAM", help="mkdocs, if not of this environment")
    options = parser.parse_args(arguments)

    sources = {path.relative_to(PROJECT).as_posix(): path.read_text(encoding="utf-8") for path in python_files()}
    found = {f"{name}: {each.name}": each for name, source in sources.items() for each in functions(source)}
    modules = {name: source.count("\n") for name, source in sources.items()}
    longest_module, module_lines = _longest(modules)
    longest_function, function_lines = _longest({name: each.lines for name, each in found.items()})
    widest_function, parameters = _longest({name: each.parameters for name, each in found.items()})
    groups = import_cycles()
    warnings = docs_warnings(options.mkdocs)

    figures: dict[str, float] = {
        "python_lines": sum(modules.values()),
        "modules": len(modules),
        "longest_module": module_lines,
        "longest_function": function_lines,
        "most_parameters": parameters,
        "import_cycles": sum(len(group) for group in groups.values()),
    }
    if warnings is None:
        print("docs_warnings is not measured: mkdocs is not installed (dependency group `docs`; or name it: --mkdocs)")
    else:
        figures["docs_warnings"] = len(warnings)
    found_answers = options.reader_found
    if found_answers is not None:
        figures["reader_found_of_15"] = found_answers
    return finish(
        options,
        figures,
        command="python -m evidence.house" + (f" --reader-found {found_answers}" if found_answers is not None else ""),
        seeds={},
        names={
            "longest_module": longest_module,
            "longest_function": longest_function,
            "most_parameters": widest_function,
        },
        cycles=groups,
        warnings=warnings,
    )


if __name__ == "__main__":
    sys.exit(main())
