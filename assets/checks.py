"""What must hold at each hand-over; the checks before the freeze block what comes after them.

Each says in a sentence what it found, so that nobody has to guess why one failed.
"""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.perception import members
from assets.policies import ON_NEW_ASSET
from assets.reporting import Metadata, readable
from assets.run_settings import planning_delta
from deltasafe import presets

PRESET = presets.active()

GateConfig = configurable(PRESET.gate)


@dg.asset_check(
    asset="test_hands",
    additional_ins={"raw_hands": dg.AssetIn("raw_hands")},
    blocking=True,
    description="No image is in both sets, under whatever name: compared by decoded pixels.",
)
def no_image_in_both_sets(test_hands: pathlib.Path, raw_hands: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.errors import DataError
    from deltasafe.perception.data.labeled_images import LabeledImageSet, check_disjoint

    train, test = LabeledImageSet.load(raw_hands), LabeledImageSet.load(test_hands)
    try:
        check_disjoint(train, test)
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    counts = {"training images": len(train), "test images": len(test)}
    found = f"none of the {len(test)} test images is among the {len(train)} training images"
    return dg.AssetCheckResult(passed=True, description=found, metadata=counts)


@dg.asset_check(
    asset="augmented_hands",
    blocking=True,
    description="Every stored image is the one in its recipe, and nearly all of them show a hand.",
)
def images_match_their_recipes(augmented_hands: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.errors import DataError
    from deltasafe.perception.data.augmented_set import AugmentedSet

    data = AugmentedSet.load(augmented_hands)
    try:
        data.verify()
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    with_hand = float((data.masks.reshape(data.n, -1).max(axis=1) > 0).mean())
    hand_share = float(data.masks.mean())
    passed = with_hand >= 0.95 and 0.02 <= hand_share <= 0.6
    found = (
        f"{with_hand:.1%} of the images show a hand, at least 95 % must; "
        f"hands cover {hand_share:.1%} of them, 2 to 60 % is expected"
    )
    shares = {"images with a hand": round(with_hand, 4), "share of hand": round(hand_share, 4)}
    return dg.AssetCheckResult(passed=passed, description=found, metadata=shares)


@dg.asset_check(
    asset="ensemble_member",
    partitions_def=members,
    blocking=True,
    description="It learned: its loss fell to less than half of where it began.",
)
def learned(context: dg.AssetCheckExecutionContext, ensemble_member: dict[str, pathlib.Path]) -> dg.AssetCheckResult:
    falls = {name: _fall_of_loss(folder) for name, folder in sorted(ensemble_member.items())}
    told = {name: f"{name} ended at {fall:.0%} of its first loss" for name, fall in falls.items()}
    if len(falls) > 1:  # a run of several partitions: Dagster would take the result for none of them
        for name, fall in falls.items():
            evaluation = dg.AssetCheckEvaluation(
                asset_key=dg.AssetKey("ensemble_member"),
                check_name="learned",
                passed=fall < _LEARNED,
                metadata={"last loss / first loss": dg.FloatMetadataValue(round(fall, 4))},
                description=told[name],
                blocking=True,
                partition=name,
            )
            context.op_execution_context.log_event(evaluation)  # type: ignore[arg-type] # what it also takes
    failed = [name for name, fall in falls.items() if fall >= _LEARNED]
    return dg.AssetCheckResult(
        passed=not failed,
        description="; ".join(told[name] for name in failed or falls),
        metadata={"last loss / first loss": round(max(falls.values()), 4)},
    )


_LEARNED = 0.5


def _fall_of_loss(folder: pathlib.Path) -> float:
    """Mean of the last losses over that of the first."""
    from deltasafe.perception.training.member import Member

    losses = Member.load(folder).losses
    n = max(1, min(20, len(losses) // 5))
    return (sum(losses[-n:]) / n) / (sum(losses[:n]) / n)


@dg.asset_check(
    asset="calibration_report",
    blocking=True,
    description="The gate: accurate enough, and the test images support the delta that planning will use.",
)
def may_be_frozen(calibration_report: pathlib.Path, config: GateConfig) -> dg.AssetCheckResult:
    from deltasafe.perception.calibration.report import CalibrationReport, gate

    report = CalibrationReport.load(calibration_report)
    thresholds = config.settings()
    failures = gate(report, thresholds)
    supported, needed = report.smallest_supported_delta, report.settings.planning_delta
    found = (
        "; ".join(failures) or f"accurate enough; the images support a delta of {supported}, planning needs {needed}"
    )
    return dg.AssetCheckResult(passed=not failures, description=found, metadata=readable(report.figures()))


@dg.asset_check(
    asset="frozen_ensemble",
    blocking=True,
    description="The folder is intact, loads, and answers its golden image as it did when it was frozen.",
)
def answers_its_golden_image(frozen_ensemble: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.errors import DataError
    from deltasafe.perception.artifact.frozen_ensemble import golden_difference, load_ensemble

    try:
        difference = golden_difference(load_ensemble(frozen_ensemble))
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    found = f"every file is as it was written, and no probability differs by more than {difference:.1e}"
    return dg.AssetCheckResult(
        passed=True, description=found, metadata={"largest difference in probability": difference}
    )


@dg.asset_check(
    asset="occupancy_fields",
    automation_condition=ON_NEW_ASSET,
    additional_ins={"logged_scenes": dg.AssetIn("logged_scenes")},
    description="In no scene would the planner take more than 5 % of the true hand for free.",
)
def true_hands_are_seen(
    context: dg.AssetCheckExecutionContext, occupancy_fields: pathlib.Path, logged_scenes: pathlib.Path
) -> dg.AssetCheckResult:
    from deltasafe.trials.occupancy_fields import missed_hand
    from deltasafe.trials.selection import load_selection

    delta = planning_delta(context.run.run_config)
    missed = missed_hand(load_selection(logged_scenes), occupancy_fields, delta)
    worst = max(missed, key=lambda scene: missed[scene])
    return dg.AssetCheckResult(
        passed=missed[worst] <= 0.05,
        severity=dg.AssetCheckSeverity.WARN,
        description=f"at most {missed[worst]:.1%} of a hand would be taken for free (in {worst})",
        metadata={
            "largest share of a hand taken for free": round(missed[worst], 4),
            "share of the hand taken for free, by scene": missed,
        },
    )


@dg.asset_check(
    asset="planned_motions",
    automation_condition=ON_NEW_ASSET,
    additional_ins={
        "occupancy_fields": dg.AssetIn("occupancy_fields"),
        "logged_scenes": dg.AssetIn("logged_scenes"),
    },
    blocking=True,
    description="An audit that shares no code with the planner finds no unsafe point on any trajectory.",
)
def audit_finds_no_unsafe_point(
    planned_motions: pathlib.Path, occupancy_fields: pathlib.Path, logged_scenes: pathlib.Path
) -> dg.AssetCheckResult:
    from deltasafe.trials.motions import audit_motions
    from deltasafe.trials.selection import load_selection

    audited = audit_motions(load_selection(logged_scenes), occupancy_fields, planned_motions)
    unsafe = {name: result.unsafe_poses for name, result in audited.items() if result.unsafe_poses}
    poses = sum(result.poses for result in audited.values())
    where = f", in {', '.join(unsafe)}" if unsafe else ""
    return dg.AssetCheckResult(
        passed=not unsafe,
        description=f"{sum(unsafe.values())} of {poses} poses on {len(audited)} trajectories are unsafe{where}",
        metadata={"poses": poses, "unsafe poses": sum(unsafe.values()), "unsafe poses by scene": unsafe},
    )


@dg.asset_check(
    asset="executed_motions",
    automation_condition=ON_NEW_ASSET,
    blocking=True,
    description="Every scene has an outcome, and every recording is complete and unaltered.",
)
def recordings_are_intact(executed_motions: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.executions import load_execution, load_outcomes

    outcomes = load_outcomes(executed_motions)
    samples = {o.scene_id: len(load_execution(executed_motions, o.scene_id).time_s) for o in outcomes if o.executed}
    found = f"{len(samples)} recordings of {len(outcomes)} scenes are complete" if outcomes else "there is no outcome"
    counts: Metadata = {"scenes": len(outcomes), "recordings": len(samples), "samples by scene": samples}
    return dg.AssetCheckResult(passed=bool(outcomes), description=found, metadata=counts)


@dg.asset_check(
    asset="safety_report",
    automation_condition=ON_NEW_ASSET,
    description="Every motion that was executed was completed, touched nothing, and was delta-safe at every pose.",
)
def executions_were_safe(safety_report: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.safety_report import read_figures

    figures = read_figures(safety_report)
    safe, executed, contacts = (int(figures[name]) for name in ("scenes_safe", "scenes_executed", "contacts"))
    completed = int(figures.get("scenes_completed", safe))
    found = (
        f"{safe} of {executed} executed motions were safe; not completed: {executed - completed}; "
        f"contacts with hand or table: {contacts}"
    )
    return dg.AssetCheckResult(
        passed=contacts == 0 and safe == executed > 0, description=found, metadata=readable(figures)
    )


@dg.asset_check(
    asset="safety_report",
    automation_condition=ON_NEW_ASSET,
    description="The tracking error stayed within gamma(max(v, v_min)) at every pose.",
)
def tracking_kept_its_bound(safety_report: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.safety_report import read_figures

    figures = read_figures(safety_report)
    excess_m = figures.get("max_tracking_excess_m", 0.0)
    share = figures.get("tracking_share_within_bound", 1.0)
    left = f"it was left by at most {1000 * excess_m:.2f} mm, in {1 - share:.1%} of the time"
    return dg.AssetCheckResult(
        passed=excess_m <= 0.0,
        severity=dg.AssetCheckSeverity.WARN,
        description=left if excess_m > 0.0 else f"the error stayed {-1000 * excess_m:.2f} mm or more below its bound",
        metadata={"largest excess [mm]": round(1000 * excess_m, 4), "share of time within": round(share, 5)},
    )
