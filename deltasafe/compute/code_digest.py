"""Digests of the code behind a result, for cache keys and provenance: the one implementation for all of them.

A key that lists source files by hand goes stale as soon as a module moves. These functions follow import statements
instead, also those inside functions, so that a change of any module that the work can reach changes the key.
"""

import ast
import functools
import hashlib
import pathlib
import sys
from collections.abc import Callable, Iterable, Iterator
from typing import Any

_SOURCES = pathlib.Path(__file__).parents[2]
_PACKAGE = "deltasafe"


def digest_of_code(*work: Callable[..., Any]) -> str:
    """SHA-256 over the modules that define ``work`` (functions or classes) and all package modules that they import.

    Functions defined outside of this package (a script, a test) contribute their own file, and what it imports of
    this package.

    Raises:
        ValueError: there is nothing to digest, or a module has no source file.
    """
    return _digest(modules_behind(*work))


def digest_of_importers(module: str) -> str:
    """SHA-256 over all package modules that import ``module``, and everything that those import.

    Raises:
        ValueError: no module imports it.
    """
    needle = module.rpartition(".")[2].encode()
    candidates = {_name_of(path): path for path in _files() if needle in path.read_bytes()}
    found = {name: path for name, path in candidates.items() if module in _imports_of(path)}
    return _digest(_closure(found))


def digest_of_package() -> str:
    """SHA-256 over every module of this package: the provenance of an artifact."""
    return _digest({_name_of(path): path for path in _files()})


def modules_behind(*work: Callable[..., Any]) -> dict[str, pathlib.Path]:
    """Names and files of the modules that ``digest_of_code`` covers.

    Packages on the way to a module do not count (importing ``a.b.c`` runs ``a/__init__.py``, but does not use it),
    unless a name is imported from them.
    """
    roots = {}
    for each in work:
        name = each.__module__
        file = getattr(sys.modules.get(name), "__file__", None)
        if file is None:
            raise ValueError(f"the module {name} has no source file; define {each.__qualname__} in one")
        roots[name] = pathlib.Path(file)
    return _closure(roots)


def _digest(modules: dict[str, pathlib.Path]) -> str:
    if not modules:
        raise ValueError("there is no code to digest; name a function of a module")
    digest = hashlib.sha256()
    for name in sorted(modules):
        digest.update(f"{name} {hashlib.sha256(modules[name].read_bytes()).hexdigest()}\n".encode())
    return digest.hexdigest()


def _closure(roots: dict[str, pathlib.Path]) -> dict[str, pathlib.Path]:
    found, waiting = dict(roots), list(roots.values())
    while waiting:
        for name in _imports_of(waiting.pop()):
            path = _path_of(name)
            if name not in found and path is not None:
                found[name] = path
                waiting.append(path)
    return found


def _imports_of(path: pathlib.Path) -> frozenset[str]:
    """Modules of this package that the file imports, at its top or inside functions."""
    return _parsed(path, path.stat().st_mtime_ns)


@functools.cache
def _parsed(path: pathlib.Path, _mtime_ns: int) -> frozenset[str]:
    return frozenset(_imported(ast.walk(ast.parse(path.read_bytes()))))


def _imported(nodes: Iterable[ast.AST]) -> Iterator[str]:
    for node in nodes:
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if _is_ours(alias.name))
        elif isinstance(node, ast.ImportFrom) and _is_ours(node.module or ""):
            for alias in node.names:
                submodule = f"{node.module}.{alias.name}"
                yield submodule if _path_of(submodule) else str(node.module)


def _is_ours(module: str) -> bool:
    return module.partition(".")[0] == _PACKAGE


def _path_of(module: str) -> pathlib.Path | None:
    base = _SOURCES.joinpath(*module.split("."))
    return next((file for file in (base / "__init__.py", base.with_suffix(".py")) if file.is_file()), None)


def _name_of(path: pathlib.Path) -> str:
    return ".".join(path.relative_to(_SOURCES).with_suffix("").parts).removesuffix(".__init__")


def _files() -> list[pathlib.Path]:
    return sorted((_SOURCES / _PACKAGE).rglob("*.py"))
