"""The walk from a printed board to a plan beside a cup, in this process, with a training of a few steps."""

import argparse
import shlex

import dagster as dg
import pytest

from assets import checks
from deltasafe import cli
from evidence import own_camera
from pipelines.build import build_defs
from pipelines.home import prepare_home
from pipelines.own_data import converted, home_of, steps_of
from tests.registered import light_registration

TINY = {
    "augmented_hands": {"augmentation": {"n_variants": 1, "width": 64, "height": 48}, "workers": 1},
    "ensemble_member": {"training": {"epochs": 1, "batch_size": 4}},
    "planned_motions": {"motion": {"delta": 0.97}},  # networks of two steps predict about 0.5 nearly everywhere
}


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run commands in this process; `make demo` as its job, with ``TINY``."""
    light_registration(monkeypatch)
    monkeypatch.setattr(checks, "_MAX_LOSS_RATIO", float("inf"))

    def demo(words):
        parser = argparse.ArgumentParser()
        for name in ("hands", "test", "scenes", "backgrounds"):
            parser.add_argument(f"--{name}")
        folders = converted(tmp_path / "home", vars(parser.parse_args(words)))
        for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
            monkeypatch.setenv(name, str(home_of(tmp_path / "home", folders)))
        root = prepare_home()
        steps = steps_of(folders)
        ops = {name: {"config": {**steps.get(name, {}), **TINY.get(name, {})}} for name in {*steps, *TINY}}
        with dg.DagsterInstance.get() as instance:
            job = build_defs(root).resolve_job_def("everything")
            assert job.execute_in_process({"ops": ops}, instance=instance).success

    def run(module, words):
        if module == "deltasafe.cli":
            assert cli.main(shlex.split(words)) == 0
        else:
            demo(shlex.split(words))

    return run


@pytest.mark.filterwarnings("ignore")  # warnings of MLflow
def test_photographs_alone_lead_to_a_plan_that_claims_nothing_about_contacts(tmp_path, run):
    assert own_camera.walk(tmp_path, run, n_train=8, n_test=4) == []


def test_a_page_that_says_hand_is_found(tmp_path):
    (tmp_path / "report.md").write_text("A hand-specific word, and a Hand.")
    assert [page for page, text in own_camera._markdown(tmp_path) if own_camera._HAND.search(text)] == ["report.md"]
    (tmp_path / "report.md").write_text("A hand-specific word.")
    assert not [page for page, text in own_camera._markdown(tmp_path) if own_camera._HAND.search(text)]
