"""Rules that no single module can show: who may import whom, how long a module is, what an import costs."""

import ast
import json
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]
MODULES = sorted(
    path
    for package in ("deltasafe", "assets", "pipelines", "generator", "evidence")
    for path in (ROOT / package).rglob("*.py")
)


def test_import_contracts_hold():
    subprocess.run(
        [sys.executable, "-c", "from importlinter.cli import lint_imports_command as c; c()"],
        check=True,
        cwd=ROOT,
    )


@pytest.mark.parametrize("path", MODULES, ids=lambda path: path.relative_to(ROOT).as_posix())
def test_modules_are_small_and_say_what_they_are(path):
    text = path.read_text(encoding="utf-8")
    assert text.count("\n") <= 400
    assert path.name != "utils.py"
    if text.strip():
        assert ast.get_docstring(ast.parse(text)), "a module opens by saying what belongs in it"


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


def test_the_readme_shows_the_recorded_figures():
    figures = json.loads((ROOT / "docs" / "results" / "default.json").read_text())["figures"]
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    shown = [
        f"**{figures['minutes_total']:.1f} minutes**",
        f"| pixel accuracy | {100 * figures['pa']:.1f} % |",
        f"| mIoU | {100 * figures['miou']:.1f} % |",
        f"| NLL (nats) | {figures['nll']:.4f} |",
        f"| Brier score | {figures['bs']:.4f} |",
        f"| {figures['scenes_executed']:.0f} / {figures['scenes_safe']:.0f} of {figures['scenes']:.0f} |",
        f"| contacts with hand or table | {figures['contacts']:.0f} |",
        f"| smallest distance of the tool to the true hand | {1000 * figures['min_tool_to_hand_m']:.1f} mm |",
    ]
    assert [line for line in shown if line not in text] == []
