"""Cache keys follow imports: a change of a reachable module changes the key, other changes do not."""

import pathlib
import shutil

import pytest

import deltasafe
from deltasafe.compute import code_digest
from deltasafe.compute.code_digest import digest_of_code, digest_of_importers, digest_of_package, modules_behind
from deltasafe.planning import plan_motion
from deltasafe.studies.planner.cost_comparison import run_comparison
from deltasafe.studies.safety.runs import run_scenario
from deltasafe.studies.tracking.tracking_errors import record_runs


@pytest.fixture
def sources(tmp_path, monkeypatch):
    """Copy the package, and let the digests read the copy, whose files a test may edit."""
    root = pathlib.Path(deltasafe.__file__).parent
    shutil.copytree(root, tmp_path / "deltasafe", ignore=shutil.ignore_patterns("__pycache__"))
    monkeypatch.setattr(code_digest, "_SOURCES", tmp_path)
    return tmp_path / "deltasafe"


def edit(file):
    file.write_text(file.read_text(encoding="utf-8") + "\n# edited\n", encoding="utf-8")


@pytest.mark.parametrize("module", ["planning/collision/continuous.py", "scene/occupancy.py", "geometry.py"])
def test_editing_a_module_in_the_closure_changes_the_key(sources, module):
    before = digest_of_code(plan_motion)
    edit(sources / module)
    assert digest_of_code(plan_motion) != before


@pytest.mark.parametrize("module", ["perception/settings.py", "execution/monitor.py", "studies/safety/runs.py"])
def test_editing_a_module_outside_the_closure_keeps_the_key(sources, module):
    before = digest_of_code(plan_motion)
    edit(sources / module)
    assert digest_of_code(plan_motion) == before


def test_imports_inside_functions_count():
    """The runs of the safety study import the simulator only where it is needed."""
    assert "deltasafe.execution.world" in modules_behind(run_scenario)


@pytest.mark.parametrize(
    ("work", "module"),
    [
        (run_scenario, "perception.settings"),
        (run_scenario, "perception.inference.backends"),
        (run_scenario, "execution.monitor"),
        (record_runs, "execution.monitor"),
        (run_comparison, "studies.baselines.segment_tests"),
    ],
)
def test_studies_depend_on_modules_that_hand_kept_lists_had_missed(work, module):
    assert f"deltasafe.{module}" in modules_behind(work)


def test_compiled_functions_share_one_stamp_over_all_modules_that_compile(sources):
    before = digest_of_importers("deltasafe.compute.numba_cache")
    edit(sources / "perception" / "settings.py")
    assert digest_of_importers("deltasafe.compute.numba_cache") == before
    edit(sources / "studies" / "baselines" / "segment_tests.py")
    assert digest_of_importers("deltasafe.compute.numba_cache") != before


def test_the_digest_of_the_package_covers_every_module(sources):
    before = digest_of_package()
    edit(sources / "cli.py")
    assert digest_of_package() != before


def test_an_empty_match_is_an_error():
    with pytest.raises(ValueError, match="no code"):
        digest_of_importers("deltasafe.no_such_module")
    with pytest.raises(ValueError, match="no code"):
        digest_of_code()
    with pytest.raises(ValueError, match="no source file"):
        digest_of_code(len)
