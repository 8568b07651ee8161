"""The documentation agrees with the code: links, commands, cited decisions, names of assets and settings; it builds."""

import ast
import importlib.util
import os
import pathlib
import re
import subprocess
import sys

import pytest

import deltasafe.perception

ROOT = pathlib.Path(__file__).parents[2]
DOCS = ROOT / "docs"
PAGES = sorted([*ROOT.glob("*.md"), *DOCS.rglob("*.md"), ROOT / "datasets/README.md", ROOT / "examples/README.md"])
PACKAGES = ("deltasafe", "assets", "pipelines", "generator", "evidence")


def name_of(path):
    return path.relative_to(ROOT).as_posix()


def sources(*packages):
    return [path for package in packages for path in sorted((ROOT / package).rglob("*.py"))]


def page(name):
    return (DOCS / name).read_text(encoding="utf-8")


@pytest.mark.parametrize("path", PAGES, ids=name_of)
def test_pages_are_finished_and_their_links_lead_somewhere(path):
    text = path.read_text(encoding="utf-8")
    assert "@@" not in text
    api_pages = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")
    for link in re.findall(r"\]\(([^)#:]+)(?:#[^)]*)?\)", text):
        target = (path.parent / link).resolve()
        if target.parent == DOCS / "reference" / "api":  # made when the site is built
            assert target.relative_to(DOCS).as_posix() in api_pages, link
        else:
            assert target.exists(), link


# recorded commands are valid at their commit only
@pytest.mark.parametrize("path", [path for path in PAGES if path != DOCS / "results" / "README.md"], ids=name_of)
def test_every_command_on_a_page_exists(path):
    text = path.read_text(encoding="utf-8")
    targets = re.findall(r"^([a-z][a-z-]*):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    code = "\n".join(re.findall(r"`[^`\n]+`|^```(?:bash)\n.*?^```", text, re.MULTILINE | re.DOTALL))
    assert set(re.findall(r"\bmake ([a-z][a-z-]*)", code)) <= set(targets)
    for module in re.findall(r"python -m ((?:pipelines|evidence|generator)[\w.]*)", code):
        place = ROOT / module.removesuffix(".NAME").replace(".", "/")
        assert place.is_dir() or place.with_suffix(".py").is_file(), module


def test_measured_figures_stand_in_blocks_that_are_generated():
    # decisions.md names prototypes and rejected alternatives, which have no record
    pages = [ROOT / "README.md", *({*DOCS.rglob("*.md")} - {DOCS / "explanation" / "decisions.md"})]
    measured = re.compile(
        r"\d (?:minutes|hours|motions|images/s|times as|GPU hours)|(?:mIoU|NLL)[^|\n]{0,20} (?:0\.\d{3}|\d\d\.\d %)"
    )
    found = []
    for path in pages:
        if DOCS / "results" not in path.parents:
            text = re.sub(r"<!-- results:.*?<!-- /results -->", "", path.read_text(encoding="utf-8"), flags=re.DOTALL)
            found += [f"{name_of(path)}: {match.group()}" for match in measured.finditer(text)]
    assert found == []


@pytest.mark.parametrize("path", [path for path in PAGES if DOCS / "results" not in path.parents], ids=name_of)
def test_files_and_imports_on_a_page_exist(path):
    text = path.read_text(encoding="utf-8")
    if path.name != "CHANGELOG.md":  # its older entries name older files
        files = re.findall(rf"`((?:{'|'.join(PACKAGES)}|tests)/[\w/]+\.py)`", text)
        assert [name for name in files if not (ROOT / name).is_file()] == []
    for module, names in re.findall(r"^from (deltasafe[\w.]*) import (\([^)]*\)|.+)$", text, re.MULTILINE):
        place = ROOT / module.replace(".", "/")
        source = place / "__init__.py" if place.is_dir() else place.with_suffix(".py")
        assert source.is_file(), module
        assert [
            name for name in re.findall(r"\w+", names) if not re.search(rf"\b{name}\b", source.read_text())
        ] == [], module


def test_every_decision_that_the_code_cites_exists():
    numbers = [int(number) for number in re.findall(r"^### D(\d+): ", page("explanation/decisions.md"), re.MULTILINE)]
    assert len(set(numbers)) == len(numbers), "each number stands for one decision"
    cited = set()
    for path in [*sources(*PACKAGES), *sources("tests"), *ROOT.glob("*.toml")]:
        for group in re.findall(r"\b[Dd]ecisions? (\d+(?:(?:, | and )\d+)*)", path.read_text(encoding="utf-8")):
            cited |= {int(number) for number in re.findall(r"\d+", group)}
    assert cited, "comments cite decisions by number"
    assert cited <= set(numbers)


def test_every_asset_check_and_job_is_in_the_reference():
    known = set(re.findall(r"`(\w+)`", page("reference/assets.md")))
    for path in sources("assets"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            decorators = [ast.unparse(decorator) for decorator in getattr(node, "decorator_list", [])]
            if any(decorator.startswith("dg.asset") for decorator in decorators):
                assert node.name in known
    jobs = (ROOT / "pipelines" / "jobs.py").read_text(encoding="utf-8")
    assert set(re.findall(r"define_asset_job\(\s*\"(\w+)\"", jobs)) <= known


def test_every_make_target_and_variable_is_in_the_reference():
    phony = re.search(r"^\.PHONY: (.*)$", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    assert [target for target in phony[1].split() if f"`make {target}`" not in page("reference/make.md")] == []
    read = {
        name
        for path in sources("deltasafe", "assets", "pipelines")
        for name in re.findall(r'"(DELTASAFE_[A-Z_]+)"', path.read_text())
    }
    read -= {"DELTASAFE_APART"}  # set by `make scale` for its own processes
    assert [name for name in sorted(read) if f"`{name}`" not in page("reference/settings.md")] == []


def test_the_site_builds_strictly_and_loads_nothing_from_other_hosts(tmp_path):
    if importlib.util.find_spec("mkdocs") is None:
        pytest.skip("needs the dependency group `docs` (make docs)")
    command = [sys.executable, "-m", "mkdocs", "build", "--strict", "--site-dir", str(tmp_path)]
    environment = {**os.environ, "NO_MKDOCS_2_WARNING": "1"}
    built = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, env=environment, check=False)
    assert built.returncode == 0, built.stderr
    shown = (tmp_path / "reference" / "api" / "deltasafe.planning.html").read_text(encoding="utf-8")
    assert 'id="deltasafe.planning.plan_motion"' in shown
    assert "decisions.html#d16" in shown or "decisions.html#d18" in shown
    for package in (deltasafe, deltasafe.perception):
        shown = (tmp_path / "reference" / "api" / f"{package.__name__}.html").read_text(encoding="utf-8")
        assert [name for name in package.__all__ if f'id="{package.__name__}.{name}"' not in shown] == []
    example = re.sub(r"<[^>]+>", "", (tmp_path / "how-to" / "use-the-api.html").read_text(encoding="utf-8"))
    assert "grid = grid_from_shapes(obstacles" in example
    assert "perception.train_ensemble(augmented" in example
