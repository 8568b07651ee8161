"""What must hold at each hand-over; the checks before the freeze block what comes after them."""

import pathlib

import dagster as dg

from assets.config import configurable
from assets.operation import ON_NEW_ASSET
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
    from deltasafe.perception.hands import HandSet, check_disjoint

    train, test = HandSet.load(raw_hands), HandSet.load(test_hands)
    try:
        check_disjoint(train, test)
    except DataError as error:
        return dg.AssetCheckResult(passed=False, description=str(error))
    return dg.AssetCheckResult(passed=True, metadata={"training images": len(train), "test images": len(test)})


@dg.asset_check(
    asset="augmented_hands",
    blocking=True,
    description="Every stored image is the one in its recipe, and nearly all of them show a hand.",
)
def images_match_their_recipes(augmented_hands: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.perception.augmented_set import AugmentedSet

    data = AugmentedSet.load(augmented_hands)
    data.verify()
    with_hand = float((data.masks.reshape(data.n, -1).max(axis=1) > 0).mean())
    hand_share = float(data.masks.mean())
    passed = with_hand >= 0.95 and 0.02 <= hand_share <= 0.6
    return dg.AssetCheckResult(passed=passed, metadata={"images with a hand": with_hand, "share of hand": hand_share})


@dg.asset_check(
    asset="calibration_report",
    additional_ins={"ensemble_member": dg.AssetIn("ensemble_member")},
    blocking=True,
    description="Every member learned: its loss fell to less than half of where it began.",
)
def every_member_learned(
    calibration_report: pathlib.Path, ensemble_member: dict[str, pathlib.Path]
) -> dg.AssetCheckResult:
    from deltasafe.perception.member import Member

    falls = {}
    for name, folder in ensemble_member.items():
        losses = Member.load(folder).losses
        n = max(1, min(20, len(losses) // 5))
        falls[name] = (sum(losses[-n:]) / n) / (sum(losses[:n]) / n)
    return dg.AssetCheckResult(passed=max(falls.values()) < 0.5, metadata={"last loss / first loss": falls})


@dg.asset_check(
    asset="calibration_report",
    blocking=True,
    description="The gate: accurate enough, and the test images support the delta that planning will use.",
)
def may_be_frozen(calibration_report: pathlib.Path, config: GateConfig) -> dg.AssetCheckResult:
    from deltasafe.perception.calibration_report import CalibrationReport, gate

    report = CalibrationReport.load(calibration_report)
    failures = gate(report, config.settings())
    return dg.AssetCheckResult(passed=not failures, description="; ".join(failures), metadata=report.figures())


@dg.asset_check(
    asset="frozen_ensemble",
    blocking=True,
    description="The folder is intact, loads, and answers its golden image as it did when it was frozen.",
)
def answers_its_golden_image(frozen_ensemble: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.perception.artifact import golden_difference, load_ensemble

    difference = golden_difference(load_ensemble(frozen_ensemble))
    return dg.AssetCheckResult(passed=True, metadata={"largest difference in probability": difference})


@dg.asset_check(
    asset="occupancy_fields",
    automation_condition=ON_NEW_ASSET,
    additional_ins={"logged_scenes": dg.AssetIn("logged_scenes")},
    description="In no scene would the planner take more than 5 % of the true hand for free.",
)
def true_hands_are_seen(occupancy_fields: pathlib.Path, logged_scenes: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.fields import missed_hand
    from deltasafe.trials.selection import load_selection

    missed = missed_hand(load_selection(logged_scenes), occupancy_fields, PRESET.motion.delta)
    return dg.AssetCheckResult(
        passed=max(missed.values()) <= 0.05,
        severity=dg.AssetCheckSeverity.WARN,
        metadata={"share of the hand taken for free, by scene": missed},
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
    from deltasafe.trials.audit import audit_motions
    from deltasafe.trials.selection import load_selection

    audited = audit_motions(load_selection(logged_scenes), occupancy_fields, planned_motions)
    unsafe = {name: result.unsafe_poses for name, result in audited.items() if result.unsafe_poses}
    poses = sum(result.poses for result in audited.values())
    return dg.AssetCheckResult(passed=not unsafe, metadata={"poses": poses, "unsafe poses by scene": unsafe})


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
    return dg.AssetCheckResult(passed=bool(outcomes), metadata={"scenes": len(outcomes), "samples": samples})


@dg.asset_check(
    asset="safety_report",
    automation_condition=ON_NEW_ASSET,
    description="Every motion that was executed was completed, touched nothing, and was delta-safe at every pose.",
)
def executions_were_safe(safety_report: pathlib.Path) -> dg.AssetCheckResult:
    from deltasafe.trials.safety_report import read_figures

    figures = read_figures(safety_report)
    passed = figures["contacts"] == 0 and figures["scenes_safe"] == figures["scenes_executed"] > 0
    return dg.AssetCheckResult(passed=passed, metadata=figures)


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
    return dg.AssetCheckResult(
        passed=excess_m <= 0.0,
        severity=dg.AssetCheckSeverity.WARN,
        metadata={"largest excess [m]": excess_m, "share of time within": share},
    )
