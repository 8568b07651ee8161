"""Rules for the whole code: import contracts and cycles, sizes of modules and functions, what an import loads."""

import ast
import pathlib
import subprocess
import sys

import pytest

from evidence.house import PACKAGES, functions, import_cycles

ROOT = pathlib.Path(__file__).parents[2]
MODULES = sorted(path for package in PACKAGES for path in (ROOT / package).rglob("*.py"))


def test_import_contracts_hold():
    subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"],
        check=True,
        cwd=ROOT,
    )


def test_no_imports_form_a_cycle():
    assert {package: groups for package, groups in import_cycles().items() if groups} == {}


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_modules_have_400_lines_at_most_and_a_docstring(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 400
    assert path.name != "utils.py"
    if text.strip():
        assert ast.get_docstring(ast.parse(text)), "a module opens by saying what belongs in it"


def test_functions_have_60_lines_and_7_parameters_at_most():
    over = {
        f"{path.relative_to(ROOT).as_posix()}: {each.name}": f"{each.lines} lines, {each.parameters} parameters"
        for path in MODULES
        for each in functions(path.read_text(encoding="utf-8"))
        if each.lines > 60 or each.parameters > 7
    }
    assert over == {}


def test_only_front_doors_list_public_names():
    listing = [path for path in MODULES if "\n__all__ = " in path.read_text(encoding="utf-8")]
    assert {path.relative_to(ROOT).as_posix() for path in listing if path.name != "__init__.py"} == set()


@pytest.mark.parametrize("path", sorted((ROOT / "assets").rglob("*.py")), ids=lambda path: path.name)
def test_assets_are_thin_sentences(path):
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        decorators = [ast.unparse(d) for d in getattr(node, "decorator_list", [])]
        if any(d.startswith(("dg.asset", "asset")) for d in decorators):
            body = node.end_lineno - node.body[0].lineno
            assert body <= 25, f"{node.name} is {body} lines long"


def imported_after(statement):
    program = f"import sys; {statement}; print(*sorted({{name.split('.')[0] for name in sys.modules}}))"
    run = subprocess.run([sys.executable, "-c", program], check=True, cwd=ROOT, capture_output=True, text=True)
    return set(run.stdout.split())


def test_definitions_load_without_the_heavy_libraries():
    loaded = imported_after("from pipelines.build import build_defs; build_defs()")
    assert not loaded & {"torch", "torchvision", "mlflow", "pybullet", "albumentations", "cv2", "matplotlib", "ray"}


def test_planning_needs_numpy_numba_and_scipy_only():
    loaded = imported_after("import deltasafe.planning, deltasafe.scene")
    assert not loaded & {"torch", "cv2", "pybullet", "matplotlib", "dagster", "mlflow", "PIL"}


def test_the_wheel_would_hold_the_library_alone():
    import tomllib

    project = tomllib.loads((ROOT / "pyproject.toml").read_text())
    assert project["tool"]["hatch"]["build"]["targets"]["wheel"]["packages"] == ["deltasafe"]


def test_datasets_hold_no_python():
    assert not list((ROOT / "datasets").rglob("*.py"))


def test_nothing_unpickles():
    for path in MODULES:
        text = path.read_text(encoding="utf-8")
        assert "allow_pickle=True" not in text, path
        assert "pickle.load" not in text, path
        assert text.count("torch.load(") == text.count("weights_only=True"), path
