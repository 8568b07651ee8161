"""The safety report as Markdown, for the asset's page and for files."""

from deltasafe.trials.safety_report import SafetyReport, SceneReport

__all__ = ["safety_markdown", "safety_summary"]


def safety_markdown(report: SafetyReport) -> str:
    """Summary, a table of all scenes, and the pictures that lie beside the report."""
    parts = [_summary(report), _table(report), _meaning(report), _films(report), _pictures(report)]
    return "\n\n".join(part for part in parts if part) + "\n"


def safety_summary(report: SafetyReport) -> str:
    """The same without pictures."""
    return "\n\n".join([_summary(report), _table(report), _meaning(report)]) + "\n"


def _summary(report: SafetyReport) -> str:
    figures = report.figures()
    executed = int(figures["scenes_executed"])
    lines = [
        "# Safety report",
        "",
        f"**{executed} of {int(figures['scenes'])} scenes were executed** at delta = {report.delta:g}; "
        f"{int(figures['scenes_safe'])} of them were delta-safe as a whole, completed, and touched nothing. "
        f"Contacts with the true hand or the table: **{int(figures['contacts'])}**.",
    ]
    if executed:
        lines += [
            "",
            "| over all executions | |",
            "|---|---|",
            f"| poses that were delta-safe | {figures['delta_safe_pose_share']:.2%} |",
            f"| motions delta-safe as a whole | {int(figures['motions_wholly_delta_safe'])} of {executed} |",
            f"| largest tracking error | {_mm(figures['max_tracking_error_m'])} |",
            f"| time that the tracking error was within its bound | {figures['tracking_share_within_bound']:.2%} |",
            f"| tracking error over its bound at most | {_mm(figures['max_tracking_excess_m'])} (negative: inside) |",
            f"| stopped by the monitor | {executed - int(figures['scenes_completed'])} |",
            f"| smallest distance of the tool to the true hand | {_mm(figures.get('min_tool_to_hand_m'))} |",
            f"| smallest distance of the arm to the true hand | {_mm(figures.get('min_arm_to_hand_m'))} |",
        ]
    return "\n".join(lines)


def _table(report: SafetyReport) -> str:
    lines = [
        "## Scene by scene",
        "",
        "| scene | outcome | cost | area | length | duration | delta-safe poses | tracking error (excess over bound) "
        "| tool to hand | arm to hand | contacts |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    return "\n".join(lines + [_row(scene) for scene in report.scenes])


def _row(scene: SceneReport) -> str:
    verdict = scene.verdict
    planned = [
        "-" if scene.cost is None else f"{scene.cost:.4f}",
        "-" if scene.area_m2 is None else f"{1e4 * scene.area_m2:.1f} cm²",
        "-" if scene.length_m is None else f"{100 * scene.length_m:.1f} cm",
        "-" if scene.duration_s is None else f"{scene.duration_s:.1f} s",
    ]
    if verdict is None:
        measured = ["-"] * 5
    else:
        measured = [
            f"{verdict.delta_safe_share:.1%}",
            f"{_mm(verdict.max_error_m)} ({_mm(verdict.max_excess_m)})",
            _mm(verdict.min_tool_to_hand_m),
            _mm(verdict.min_arm_to_hand_m),
            str(verdict.contacts),
        ]
    outcome = scene.outcome
    if verdict is not None and not verdict.safe:
        outcome = f"**executed, not safe** {verdict.stop_reason}".strip()
    return "| " + " | ".join([scene.scene_id, outcome, *planned, *measured]) + " |"


def _films(report: SafetyReport) -> str:
    films = [f"![{scene.scene_id}]({scene.film})" for scene in report.scenes if scene.film]
    return "## Films\n\n" + "\n\n".join(films) if films else ""


def _pictures(report: SafetyReport) -> str:
    parts = ["## Plans and executions"]
    for scene in report.scenes:
        parts.append(f"### {scene.scene_id}: {scene.outcome}\n\n![plan of {scene.scene_id}]({scene.scene_id}-plan.png)")
        if scene.verdict is not None:
            parts.append(f"![executed path of {scene.scene_id}]({scene.scene_id}-executed.png)")
            parts.append(f"![execution of {scene.scene_id} over time]({scene.scene_id}-execution.png)")
    return "\n\n".join(parts)


def _meaning(report: SafetyReport) -> str:
    speed = f"{report.verdicts[0].min_speed_mps:g} m/s" if report.verdicts else "the smallest speed"
    return f"""## What the figures mean

* *Delta-safe* is pointwise (each point of the tool, each instant): p_occupied <= delta in the field that the planner
  had, at the measured pose. It bounds neither the probability that the tool as a whole collides nor that the whole
  motion does; the count of motions that were delta-safe as a whole stands beside it.
* The tracking error is e_pos + rho_max e_rotation of the tool, held against gamma(v) at the reference speed v, read at
  no less than {speed}: the paper's line is 0 at rest, where no controller with friction can be.
* Distances and contacts are to the scene's *true* hand mesh, which neither the ensemble nor the planner has seen. They
  include the way straight down onto the start and up from the goal.
* That way is not planned, and not part of the delta-safe poses: high above start and goal the tool leaves what the
  camera sees, and there the field calls everything occupied{_approach(report)}.
* The hand holds still: this is no speed-and-separation monitoring."""


def _approach(report: SafetyReport) -> str:
    shares = [v.approach_delta_safe_share for v in report.verdicts if v.approach_delta_safe_share is not None]
    return f" ({min(shares):.0%} to {max(shares):.0%} of its poses are delta-safe all the same)" if shares else ""


def _mm(length_m: float | None) -> str:
    return "none within reach" if length_m is None else f"{1000 * length_m:.1f} mm"
