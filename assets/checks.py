"""Asset checks of the pipeline. Blocking checks stop the run before downstream assets are made.

Every result states in one sentence what was found.
"""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.perception import members
from assets.policies import ON_NEW_ASSET
from assets.reporting import Metadata, readable
from assets.run_settings import gate_thresholds, planning_delta
from deltasafe import presets
from deltasafe.perception.data.dataset_info import DatasetInfo

PRESET = presets.active()

GateConfig = configurable(PRESET.gate)


@dg.asset_check(
    asset="test_hands",
    additional_ins={"raw_hands": dg.AssetIn("raw_hands")},
    blocking=True,
    description="No test image is also a training image, compared by decoded pixels. A failure stops the run: the "
    "evaluation would be too good. Near copies (re-encoded, scaled, mirrored) are a warning.",
)
def no_image_in_both_sets(test_hands: pathlib.Path, raw_hands: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.errors import DataError
    from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint
    from deltasafe.perception.data.near_copies import listed, near_copies

    train, test = LabeledImageSet.load(raw_hands), LabeledImageSet.load(test_hands)
    try:
        check_disjoint(train, test)
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    counts = {"training images": len(train), "test images": len(test)}
    if pairs := near_copies(test, train):
        found = (
            f"{len(pairs)} of the {len(test)} test images are near copies of training images, which makes the "
            f"evaluation too good; remove them from one of the sets: {listed(pairs)}"
        )
        counts["near copies"] = len(pairs)
        return dg.AssetCheckResult(
            passed=False, severity=dg.AssetCheckSeverity.WARN, description=found, metadata=counts
        )
    found = f"none of the {len(test)} test images is among the {len(train)} training images"
    return dg.AssetCheckResult(passed=True, description=found, metadata=counts)


@dg.asset_check(
    asset="augmented_hands",
    blocking=True,
    description="Stored images match the checksums in their recipes. At least 95 % of those that are made from an "
    "image with an obstacle show one, and obstacles cover 2 to 60 % of their pixels, unless the data set allows "
    "another fraction. A failure stops the run before training.",
)
def images_match_their_recipes(augmented_hands: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.errors import DataError
    from deltasafe.perception.data.augmented_set import AugmentedSet
    from deltasafe.perception.data.shown_hands import ShownHands

    data = AugmentedSet.load(augmented_hands)
    try:
        data.verify()
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    shown = ShownHands.of(data)
    fractions = {
        f"images with {data.info.with_article}": round(shown.fraction, 4),
        f"fraction of {data.info.singular} pixels": round(shown.coverage, 4),
    }
    return dg.AssetCheckResult(passed=shown.passed, description=shown.sentence(), metadata=fractions)


@dg.asset_check(
    asset="ensemble_member",
    partitions_def=members,
    blocking=True,
    description="The training loss of the member fell to less than half of its first values. A failure stops the "
    "run before calibration.",
)
def learned(context: dg.AssetCheckExecutionContext, ensemble_member: dict[str, pathlib.Path]) -> dg.AssetCheckResult:
    ratios = {name: _loss_ratio(folder) for name, folder in sorted(ensemble_member.items())}
    found = {name: f"{name} ended at {ratio:.0%} of its first loss" for name, ratio in ratios.items()}
    if len(ratios) > 1:  # in a run of several partitions, Dagster assigns the result below to none of them
        for name, ratio in ratios.items():
            evaluation = dg.AssetCheckEvaluation(
                asset_key=dg.AssetKey("ensemble_member"),
                check_name="learned",
                passed=ratio < _MAX_LOSS_RATIO,
                metadata={"last loss / first loss": dg.FloatMetadataValue(round(ratio, 4))},
                description=found[name],
                blocking=True,
                partition=name,
            )
            context.op_execution_context.log_event(evaluation)  # type: ignore[arg-type] # it accepts this, too
    failed = [name for name, ratio in ratios.items() if ratio >= _MAX_LOSS_RATIO]
    return dg.AssetCheckResult(
        passed=not failed,
        description="; ".join(found[name] for name in failed or ratios),
        metadata={"last loss / first loss": round(max(ratios.values()), 4)},
    )


_MAX_LOSS_RATIO = 0.5


def _loss_ratio(folder: pathlib.Path) -> float:
    """Return the mean of the last losses divided by the mean of the first."""
    from deltasafe.perception.training.member import Member

    losses = Member.load(folder).losses
    n = max(1, min(20, len(losses) // 5))
    return (sum(losses[-n:]) / n) / (sum(losses[:n]) / n)


@dg.asset_check(
    asset="calibration_report",
    blocking=True,
    description="Gate: pixel accuracy and mIoU reach their thresholds, and the test images support the delta of "
    "planning. A failure means that the ensemble is not frozen; thresholds are settings of this check, else those of "
    "the data set, else those of the preset.",
)
def may_be_frozen(
    context: dg.AssetCheckExecutionContext, calibration_report: pathlib.Path, config: GateConfig
) -> dg.AssetCheckResult:
    from deltasafe.perception.calibration.report import CalibrationReport, gate

    report = CalibrationReport.load(calibration_report)
    thresholds = gate_thresholds(context.run.run_config, config.settings(), report.info.gate)
    failures = gate(report, thresholds)
    supported, needed = report.smallest_supported_delta, report.settings.planning_delta
    found = (
        "; ".join(failures)
        or f"accuracy is sufficient; the images support a delta of {supported}, planning needs {needed}"
    )
    return dg.AssetCheckResult(
        passed=not failures, description=found, metadata=readable(report.figures(), report.info.singular)
    )


@dg.asset_check(
    asset="frozen_ensemble",
    blocking=True,
    description="The frozen folder is intact, loads, and predicts the same probabilities for its golden image as "
    "when it was frozen. A failure means that the folder is damaged or computes differently here.",
)
def answers_its_golden_image(frozen_ensemble: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.errors import DataError
    from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble

    try:
        difference = golden_difference(load_ensemble(frozen_ensemble))
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    found = f"all files are intact, and no probability differs by more than {difference:.1e}"
    return dg.AssetCheckResult(
        passed=True, description=found, metadata={"largest difference in probability": difference}
    )


@dg.asset_check(
    asset="occupancy_fields",
    automation_condition=ON_NEW_ASSET,
    additional_ins={"logged_scenes": dg.AssetIn("logged_scenes")},
    description="In every scene, at most 5 % of the pixels of the true obstacle have p_occupied up to delta, which the "
    "planner treats as free. A failure is a warning: motions may come too close to it, or no scene has a true "
    "mask to judge by.",
)
def true_hands_are_seen(
    context: dg.AssetCheckExecutionContext, occupancy_fields: pathlib.Path, logged_scenes: pathlib.Path
) -> dg.AssetCheckResult:
    from deltasafe.trials.occupancy_fields import miss_rates_at_delta
    from deltasafe.trials.selection import load_selection

    delta = planning_delta(context.run.run_config)
    scenes = load_selection(logged_scenes)
    missed = miss_rates_at_delta(scenes, occupancy_fields, delta)
    unjudged = len(scenes) - len(missed)
    notes = [f"not judged: {unjudged} of {len(scenes)} scenes, which have no true mask"] if unjudged else []
    largest, passed = None, False
    if missed:
        worst, thing = max(missed, key=lambda scene: missed[scene]), DatasetInfo.load(occupancy_fields).with_article
        largest, passed = round(missed[worst], 4), missed[worst] <= 0.05
        notes.insert(0, f"the largest miss rate at delta {delta:g} is {missed[worst]:.1%} of {thing} (in {worst})")
    return dg.AssetCheckResult(
        passed=passed,
        severity=dg.AssetCheckSeverity.WARN,
        description="; ".join(notes),
        metadata={**readable({"largest miss rate at delta": largest}), "miss rate at delta, by scene": missed},
    )


@dg.asset_check(
    asset="planned_motions",
    automation_condition=ON_NEW_ASSET,
    additional_ins={
        "occupancy_fields": dg.AssetIn("occupancy_fields"),
        "logged_scenes": dg.AssetIn("logged_scenes"),
    },
    blocking=True,
    description="An audit that shares no code with the planner finds no unsafe pose on any trajectory. A failure "
    "means an error in the planner, and stops the run before execution.",
)
def audit_finds_no_unsafe_point(
    planned_motions: pathlib.Path, occupancy_fields: pathlib.Path, logged_scenes: pathlib.Path
) -> dg.AssetCheckResult:
    return audit_result(logged_scenes, occupancy_fields, planned_motions)


def audit_result(scenes: pathlib.Path, fields: pathlib.Path, motions: pathlib.Path) -> dg.AssetCheckResult:
    """Audit all motions in a folder."""
    from deltasafe.trials.motions import audit_motions
    from deltasafe.trials.selection import load_selection

    audits = audit_motions(load_selection(scenes), fields, motions)
    unsafe = {name: audit.unsafe_poses for name, audit in audits.items() if audit.unsafe_poses}
    poses = sum(audit.poses for audit in audits.values())
    where = f", in {', '.join(unsafe)}" if unsafe else ""
    return dg.AssetCheckResult(
        passed=not unsafe,
        description=f"{sum(unsafe.values())} of {poses} poses on {len(audits)} trajectories are unsafe{where}",
        metadata={"poses": poses, "unsafe poses": sum(unsafe.values()), "unsafe poses by scene": unsafe},
    )


@dg.asset_check(
    asset="executed_motions",
    automation_condition=ON_NEW_ASSET,
    blocking=True,
    description="Every scene has an outcome, and every recording is complete and matches its checksum. A failure "
    "means that files were damaged.",
)
def recordings_are_intact(executed_motions: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.executions import load_execution, load_outcomes

    outcomes = load_outcomes(executed_motions)
    samples = {o.scene_id: len(load_execution(executed_motions, o.scene_id).time_s) for o in outcomes if o.executed}
    found = f"{len(samples)} recordings of {len(outcomes)} scenes are complete" if outcomes else "there are no outcomes"
    counts: Metadata = {"scenes": len(outcomes), "recordings": len(samples), "samples by scene": samples}
    return dg.AssetCheckResult(passed=bool(outcomes), description=found, metadata=counts)


@dg.asset_check(
    asset="safety_report",
    automation_condition=ON_NEW_ASSET,
    description="Every executed motion was completed, had no contact with obstacle or table, and was delta-safe at "
    "every pose. A failure names the counts; the safety report shows the motions. If no scene has true obstacles, it "
    "is a warning: not judged.",
)
def executions_were_safe(safety_report: pathlib.Path) -> dg.AssetCheckResult:
    return safety_result(safety_report, n_required=1)


def safety_result(report: pathlib.Path, n_required: int) -> dg.AssetCheckResult:
    """Evaluate a safety report: all executed motions were safe, and at least ``n_required`` were executed.

    Motions without a true obstacle neither pass nor fail as far as they are not judged. If all are such, the result is
    a warning.
    """
    from deltasafe.trials.safety_report import read_figures

    figures, thing = read_figures(report), DatasetInfo.load(report).singular
    safe, executed = int(figures["scenes_safe"] or 0), int(figures["scenes_executed"] or 0)
    judged = int(figures.get("scenes_judged", executed) or 0)
    unsafe = int(figures.get("scenes_unsafe", judged - safe) or 0)
    completed = int(figures.get("scenes_completed", safe) or 0)
    contacts, unjudged = figures["contacts"], executed - judged
    found = f"not completed: {executed - completed}"
    if judged or not executed:
        found = f"{safe} of {judged} executed motions were safe; {found}; contacts with {thing} or table: {contacts}"
    if unjudged:
        found += (
            f"; not judged: contacts of {unjudged} motions with the {thing}, because their scenes have no true {thing} "
            f"({unsafe - (judged - safe)} of them were unsafe for another reason)"
        )
    failed = unsafe > 0 or bool(contacts) or executed < n_required
    undecided = unjudged > 0 and judged == 0 and not failed
    return dg.AssetCheckResult(
        passed=not failed and not undecided,
        severity=dg.AssetCheckSeverity.WARN if undecided else dg.AssetCheckSeverity.ERROR,
        description=found,
        metadata=readable(figures, thing),
    )


@dg.asset_check(
    asset="safety_report",
    automation_condition=ON_NEW_ASSET,
    description="The tracking error was at most gamma(max(v, v_min)) at every pose. A failure is a warning: the arm "
    "left the bound that planning assumes.",
)
def tracking_kept_its_bound(safety_report: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.safety_report import read_figures

    figures = read_figures(safety_report)
    excess_m = figures.get("max_tracking_excess_m") or 0.0
    fraction = figures.get("tracking_share_within_bound", 1.0) or 0.0
    if excess_m > 0.0:
        found = f"the error exceeded its bound by up to {1000 * excess_m:.2f} mm, in {1 - fraction:.1%} of the time"
    else:
        found = f"the error stayed at least {-1000 * excess_m:.2f} mm below its bound"
    return dg.AssetCheckResult(
        passed=excess_m <= 0.0,
        severity=dg.AssetCheckSeverity.WARN,
        description=found,
        metadata={"largest excess [mm]": round(1000 * excess_m, 4), "fraction of time within": round(fraction, 5)},
    )
