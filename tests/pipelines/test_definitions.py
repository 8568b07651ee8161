"""The definitions as the UI sees them."""

import datetime
import itertools
import pathlib
import re

import dagster as dg
import pytest

from assets.interfaces import Store
from deltasafe.errors import SettingsError
from deltasafe.presets import PRESETS, VARIABLE, active
from pipelines.build import build_defs
from pipelines.jobs import retraining

CHAIN = [
    "raw_hands",
    "augmented_hands",
    "ensemble_member",
    "calibration_report",
    "frozen_ensemble",
    "champion",
    "occupancy_fields",
    "planned_motions",
    "executed_motions",
    "safety_report",
]
STUDY = {"study_cell", "augmentation_tables", "ensemble_size", "augmentation_ablation"}
SINGLE_SCENE = {"logged_scene", "scene_motion", "scene_execution"}
PLANNER_STUDY = {"planner_costs", "planner_times", "planner_report"}
SAFETY_STUDY = {"safety_trials", "safety_study_report"}
TRACKING_STUDY = {"tracking_bound"}


@pytest.fixture(scope="module")
def defs(tmp_path_factory):
    return build_defs(tmp_path_factory.mktemp("home"))


def specs(defs):
    return {spec.key.to_user_string(): spec for spec in defs.resolve_all_asset_specs()}


def test_every_asset_of_the_chain_depends_on_the_one_before(defs):
    found = specs(defs)
    studies = {*STUDY, *PLANNER_STUDY, *SAFETY_STUDY, *TRACKING_STUDY}
    assert set(found) == {*CHAIN, *studies, *SINGLE_SCENE, "test_hands", "logged_scenes", "disk_space"}
    for before, after in itertools.pairwise(CHAIN):
        upstream = {dep.asset_key.to_user_string() for dep in found[after].deps}
        assert before in upstream, f"{after} does not depend on {before}"
    assert not found["raw_hands"].deps


def test_no_training_reads_test_images(defs):
    readers = {
        name
        for name, spec in specs(defs).items()
        if "test_hands" in {dep.asset_key.to_user_string() for dep in spec.deps}
    }
    assert readers == {"calibration_report", "champion", "study_cell"}
    assert {name for name, spec in specs(defs).items() if spec.group_name == "perception_study"} == STUDY


def test_the_chain_does_not_depend_on_the_studies(defs):
    keys = defs.resolve_job_def("everything").asset_layer.selected_asset_keys
    assert {key.to_user_string() for key in keys} == {*CHAIN, "test_hands", "logged_scenes"}
    found = specs(defs)
    for name in CHAIN:
        assert not STUDY & {dep.asset_key.to_user_string() for dep in found[name].deps}


def test_every_asset_has_description_owner_kind_version_and_group(defs):
    for name, spec in specs(defs).items():
        assert spec.description, name
        assert spec.owners, name
        assert spec.kinds, name
        assert spec.code_version, name
        studies = ("perception_study", "planner_study", "safety_study", "tracking_study")
        assert spec.group_name in ("perception", "motion", "single_scene", "operation", *studies), name


def test_checks_before_the_freeze_are_blocking(defs):
    checks = {spec.name: spec for check in defs.asset_checks for spec in check.check_specs}
    blocking = {name for name, spec in checks.items() if spec.blocking}
    assert blocking >= {"no_image_in_both_sets", "images_match_their_recipes", "learned", "may_be_frozen"}
    assert all(spec.description for spec in checks.values())


def test_a_failed_gate_keeps_the_ensemble_from_being_frozen(tmp_path):
    """The real gate on a report of an ensemble that is always wrong; downstream assets must not run."""
    frozen = []

    @dg.asset
    def calibration_report():
        return 1

    @dg.asset(deps=[calibration_report])
    def frozen_ensemble():
        frozen.append(True)

    import numpy as np

    from assets.checks import may_be_frozen
    from deltasafe.perception.calibration.evaluation import evaluate
    from deltasafe.perception.calibration.labeled_predictions import LabeledPredictions
    from deltasafe.perception.calibration.write_report import write_calibration_report

    masks = [np.eye(16, dtype=bool), ~np.eye(16, dtype=bool)]
    wrong = [np.where(mask, 0.01, 0.99)[None].astype(np.float32) for mask in masks]
    images = LabeledPredictions(["a", "b"], masks, wrong)
    write_calibration_report(tmp_path / "report", evaluate(images), images)

    class Returns(dg.ConfigurableIOManager):
        def handle_output(self, context, obj):
            pass

        def load_input(self, context):
            return tmp_path / "report"

    result = dg.materialize(
        [calibration_report, frozen_ensemble, may_be_frozen], resources={"io_manager": Returns()}, raise_on_error=False
    )
    (evaluation,) = result.get_asset_check_evaluations()
    assert not evaluation.passed
    assert "support no delta" in evaluation.description
    assert frozen == []


def test_the_schedule_is_off_by_default_and_retrains_every_member(defs):
    assert retraining.default_status == dg.DefaultScheduleStatus.STOPPED
    context = dg.build_schedule_context(scheduled_execution_time=datetime.datetime(2030, 1, 6, 3, tzinfo=datetime.UTC))
    request = retraining(context)
    job = defs.resolve_job_def("perception")
    keys = [f"member_{m:02d}" for m in range(PRESETS["smoke"].n_members)]
    assert request.tags["dagster/asset_partition_range_start"] == keys[0]
    assert request.tags["dagster/asset_partition_range_end"] == keys[-1]
    assert {key.to_user_string() for key in job.asset_layer.selected_asset_keys} >= {
        "ensemble_member",
        "frozen_ensemble",
    }


@pytest.mark.parametrize("name", PRESETS)
def test_the_environment_selects_the_preset(monkeypatch, name):
    monkeypatch.setenv(VARIABLE, name)
    assert active() is PRESETS[name]


def test_an_unknown_preset_is_refused_with_a_list_of_presets(monkeypatch):
    monkeypatch.setenv(VARIABLE, "papre")
    with pytest.raises(SettingsError, match="smoke, default, paper"):
        active()


def test_the_paper_preset_has_the_settings_of_the_paper():
    paper = PRESETS["paper"]
    assert paper.n_members == 10
    assert (paper.training.network.architecture, paper.training.network.backbone) == ("deeplabv3", "resnet50")
    assert (paper.augmentation.width, paper.augmentation.height) == (384, 288)
    assert (paper.motion.n_iterations, paper.motion.n_samples, paper.motion.delta) == (2000, 100, 0.05)
    assert (paper.motion.v_min_mps, paper.motion.v_max_mps) == (0.01, 0.2)


SAFE = {
    "contacts": 0,
    "scenes": 3,
    "scenes_executed": 2,
    "scenes_safe": 2,
    "max_tracking_excess_m": -1e-4,
    "tracking_share_within_bound": 1.0,
}


@pytest.mark.parametrize(
    ("change", "safe", "tracked"),
    [
        ({}, True, True),
        ({"contacts": 1}, False, True),
        ({"scenes_safe": 1}, False, True),
        ({"scenes_executed": 0, "scenes_safe": 0}, False, True),
        ({"max_tracking_excess_m": 1e-6}, True, False),
        ({"scenes_executed": 3, "scenes_judged": 2, "scenes_unsafe": 0}, True, True),
        ({"scenes_executed": 3, "scenes_judged": 2, "scenes_unsafe": 1}, False, True),
    ],
    ids=str,
)
def test_the_checks_of_the_safety_report_fail_for_their_own_reason(tmp_path, change, safe, tracked):
    from assets.checks import executions_were_safe, tracking_kept_its_bound
    from deltasafe.io.storage import write_json

    write_json(tmp_path / "report.json", {"figures": {**SAFE, **change}})
    assert executions_were_safe(tmp_path).passed == safe
    assert tracking_kept_its_bound(tmp_path).passed == tracked


@pytest.mark.parametrize("n_unsafe", [0, 1])
def test_motions_without_a_true_hand_neither_pass_nor_fail(tmp_path, n_unsafe):
    from assets.checks import executions_were_safe
    from deltasafe.io.storage import write_json

    unjudged = {"contacts": None, "scenes_judged": 0, "scenes_safe": 0, "scenes_unsafe": n_unsafe}
    write_json(tmp_path / "report.json", {"figures": SAFE | unjudged})
    result = executions_were_safe(tmp_path)
    assert not result.passed
    assert result.severity == (dg.AssetCheckSeverity.ERROR if n_unsafe else dg.AssetCheckSeverity.WARN)
    assert "not judged: contacts of 2 motions" in result.description
    assert f"({n_unsafe} of them were unsafe for another reason)" in result.description
    assert result.metadata["contacts"].value == "not judged"


@pytest.mark.parametrize("whole", [True, False], ids=["all members in one run", "one member"])
def test_a_member_that_did_not_learn_fails_the_check_of_its_partition(tmp_path, whole):
    from torch import nn

    from assets.checks import learned
    from assets.perception import members
    from deltasafe.perception.training.member import Member

    first, second = members.get_partition_keys()[:2]
    for name, losses in {first: [1.0 - 0.009 * step for step in range(100)], second: [0.7] * 100}.items():
        Member.write(tmp_path / name, nn.Linear(2, 1), {"losses": losses})

    @dg.asset(partitions_def=members, backfill_policy=dg.BackfillPolicy.single_run())
    def ensemble_member():
        pass

    @dg.asset(deps=[ensemble_member])
    def downstream():
        pass

    class Folders(dg.ConfigurableIOManager):
        def handle_output(self, context, obj):
            pass

        def load_input(self, context):
            return {key: tmp_path / key for key in context.asset_partition_keys}

    span = {"dagster/asset_partition_range_start": first, "dagster/asset_partition_range_end": second}
    result = dg.materialize(
        [ensemble_member, downstream, learned],
        resources={"io_manager": Folders()},
        raise_on_error=False,
        **({"tags": span} if whole else {"partition_key": second}),
    )
    evaluations = {evaluation.partition: evaluation for evaluation in result.get_asset_check_evaluations()}
    assert set(evaluations) == ({first, second, None} if whole else {second})
    assert not evaluations[second].passed
    assert evaluations[second].description == f"{second} ended at 100% of its first loss"
    if whole:
        assert evaluations[first].passed
        assert evaluations[None].description == evaluations[second].description
    assert not result.asset_materializations_for_node("downstream"), "the check blocks"


@pytest.mark.parametrize(
    ("step", "config", "message"),
    [
        ("ensemble_member", {"training": {"epochs": 0}}, "training: epochs must be at least 1, got 0"),
        ("champion", {"level": 2.0}, "level must be in"),
        ("calibration_report_may_be_frozen", {"miou": 3.0}, "miou must be in"),
    ],
)
def test_an_invalid_setting_of_any_step_is_found(step, config, message):
    from pipelines.automation.launch_check import wrong_settings

    assert re.search(message, wrong_settings({"ops": {step: {"config": config}}}))


def test_a_run_with_an_invalid_setting_of_a_later_step_computes_nothing(tmp_path):
    from assets.perception import champion
    from assets.policies import RETRY_TWICE, no_retry
    from pipelines.resources import StoreResource

    calls = []

    @dg.asset(retry_policy=RETRY_TWICE)
    @no_retry
    def test_hands(store: dg.ResourceParam[Store]):
        calls.append(store)

    plain = {"tracker": object(), "registry": object()}
    resources = {"store": StoreResource(home=str(tmp_path), datasets=str(tmp_path)), **plain}
    given = dg.AssetSpec("frozen_ensemble")
    job = dg.Definitions([test_hands, champion, given], resources=resources).resolve_implicit_global_asset_job_def()
    result = job.execute_in_process(run_config={"ops": {"champion": {"config": {"level": 2.0}}}}, raise_on_error=False)
    assert not result.success
    assert calls == []
    assert not [event for event in result.all_events if event.is_step_up_for_retry]


def test_every_asset_that_uses_the_store_refuses_such_a_run(defs):
    for definition in defs.assets:
        function = getattr(getattr(definition, "op", None), "compute_fn", None)
        if function is not None and "store" in definition.required_resource_keys:
            assert function.decorated_fn.__wrapped__, definition.key


def test_valid_settings_pass_the_launch_check():
    from pipelines.automation.launch_check import wrong_settings

    valid = {"ensemble_member": {"config": {"training": {"epochs": 3}}}, "raw_hands": {}}
    assert wrong_settings({"ops": valid}) == ""


def test_invalid_input_is_not_retried_and_transient_errors_are():
    from assets.policies import no_retry
    from deltasafe.errors import DataError, WorkerLostError

    attempts = []

    @dg.asset(retry_policy=dg.RetryPolicy(max_retries=2))
    @no_retry
    def reader(context: dg.AssetExecutionContext):
        attempts.append(context.retry_number)
        raise error

    wrong, busy, killed = (
        DataError("a.png", "is no image"),
        OSError("the disk was busy"),
        WorkerLostError("out of memory"),
    )
    for error, expected in ((wrong, 1), (busy, 3), (killed, 3)):  # noqa: B007
        attempts.clear()
        result = dg.materialize([reader], raise_on_error=False)
        assert len(attempts) == expected
    assert not result.success


@pytest.mark.parametrize("policy", [None, dg.RetryPolicy(max_retries=2)], ids=["no policy", "retries"])
def test_a_missing_input_is_not_retried_and_is_the_first_line_of_the_error(tmp_path, policy):
    from pipelines.storage.io_manager import FolderPointers

    @dg.asset(retry_policy=policy)
    def reader(frozen_ensemble: pathlib.Path):
        pass

    resources = {"io_manager": FolderPointers(home=str(tmp_path))}
    result = dg.materialize([reader, dg.AssetSpec("frozen_ensemble")], resources=resources, raise_on_error=False)
    assert not [event for event in result.all_events if event.is_step_up_for_retry]
    (failure,) = result.get_step_failure_events()
    assert "materialize frozen_ensemble first" in failure.step_failure_data.error.message.splitlines()[0]


def test_definitions_without_a_dagster_home_say_so(monkeypatch, caplog):
    """`dg dev` in the checkout would run without pools and monitoring."""
    import importlib

    from pipelines import definitions

    monkeypatch.setenv("DAGSTER_HOME", "")
    importlib.reload(definitions)
    assert "no pools and no monitoring; use `make ui`" in caplog.text
    monkeypatch.setenv("DAGSTER_HOME", "/somewhere")
    caplog.clear()
    importlib.reload(definitions)
    assert not caplog.text


def test_the_ui_shows_all_pools_of_a_new_home(tmp_path, monkeypatch, defs):
    from pipelines.commands import ui
    from pipelines.home import prepare_home

    for name in ("DELTASAFE_HOME", "DAGSTER_HOME"):
        monkeypatch.setenv(name, str(tmp_path))
    prepare_home()
    for _ in range(2):
        ui._check_dagster()
    with dg.DagsterInstance.get() as instance:
        shown = {limit.name: limit.limit for limit in instance.event_log_storage.get_pool_limits()}
    ops = [definition.op for definition in defs.assets if isinstance(definition, dg.AssetsDefinition)]
    assert shown == dict.fromkeys({op.pool for op in ops if op.pool}, 1)


def test_heavy_assets_share_one_pool_and_are_retried_with_backoff(defs):
    heavy = {"augmented_hands", "ensemble_member", "calibration_report", "planned_motions", "executed_motions"}
    ops = {d.key.to_user_string(): d.op for d in defs.assets if isinstance(d, dg.AssetsDefinition)}
    for name in heavy | {"study_cell", "planner_costs", "planner_times", "scene_motion", "scene_execution"}:
        assert ops[name].pool == "all_cores", name
    for name in heavy:
        policy = ops[name].retry_policy
        assert (policy.backoff, policy.jitter) == (dg.Backoff.EXPONENTIAL, dg.Jitter.PLUS_MINUS), name


def test_large_reports_and_pictures_are_reduced_to_the_limit(tmp_path):
    import numpy as np
    from PIL import Image

    from assets.reporting import inline_picture, inline_report

    rng = np.random.default_rng(0)
    names = [f"{k}.png" for k in range(6)]
    for name in names:
        Image.fromarray(rng.integers(0, 256, (240, 320, 3), dtype=np.uint8)).save(tmp_path / name)
    frames = [Image.fromarray(rng.integers(0, 256, (200, 300, 3), dtype=np.uint8)) for _ in range(5)]
    frames[0].save(tmp_path / "film.gif", save_all=True, append_images=frames[1:])
    (tmp_path / "report.md").write_text("# All\n" + "\n".join(f"![picture {name}]({name})" for name in names))
    report = inline_report(tmp_path / "report.md").value
    assert len(report) < 100_000
    assert report.count("data:image/") >= 3
    assert all(f"picture {name}" in report for name in names), "pictures that do not fit are named"
    for name in ("0.png", "film.gif"):
        assert len(inline_picture(tmp_path / name, 40_000).value) < 40_000
