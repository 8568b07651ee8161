"""The safety report as Markdown: `templates/safety_report.md.j2`."""

from deltasafe.reporting.templates import render
from deltasafe.trials.safety_report import SafetyReport, SceneReport

__all__ = ["safety_markdown", "safety_summary"]

_SCENE_HEAD = (
    "scene",
    "outcome",
    "cost",
    "area",
    "length",
    "duration",
    "delta-safe poses",
    "tracking error (error minus bound)",
    "tool to hand",
    "arm to hand",
    "contacts",
)


def safety_markdown(report: SafetyReport) -> str:
    """Return the report with links to the figures and films beside it."""
    return _rendered(report, pictures=True)


def safety_summary(report: SafetyReport) -> str:
    """Return the report without figures and films."""
    return _rendered(report, pictures=False)


def _rendered(report: SafetyReport, *, pictures: bool) -> str:
    figures, verdicts = report.figures(), report.verdicts
    approach = [v.approach_delta_safe_share for v in verdicts if v.approach_delta_safe_share is not None]
    return render(
        "deltasafe.trials",
        "safety_report.md.j2",
        executed=len(verdicts),
        n_scenes=len(report.scenes),
        n_safe=figures["scenes_safe"],
        n_contacts=figures["contacts"],
        delta=f"{report.delta:g}",
        overall=_overall(figures) if verdicts else [],
        scene_head=_SCENE_HEAD,
        scene_rows=[_row(scene) for scene in report.scenes],
        v_min=f"{verdicts[0].min_speed_mps:g} m/s" if verdicts else "the smallest speed",
        approach=f" ({min(approach):.0%} to {max(approach):.0%} of these poses are delta-safe)" if approach else "",
        pictures=pictures,
        films=[scene for scene in report.scenes if scene.film],
        scenes=report.scenes,
    )


def _overall(figures: dict[str, float]) -> list[tuple[str, str]]:
    executed = int(figures["scenes_executed"])
    return [
        ("delta-safe poses", f"{figures['delta_safe_pose_share']:.2%}"),
        ("motions whose poses were all delta-safe", f"{int(figures['motions_wholly_delta_safe'])} of {executed}"),
        ("largest tracking error", _mm(figures["max_tracking_error_m"])),
        ("time with the tracking error within its bound", f"{figures['tracking_share_within_bound']:.2%}"),
        ("largest tracking error minus bound", f"{_mm(figures['max_tracking_excess_m'])} (negative: within the bound)"),
        ("stopped by the monitor", str(executed - int(figures["scenes_completed"]))),
        ("smallest distance of the tool to the true hand", _mm(figures.get("min_tool_to_hand_m"))),
        ("smallest distance of the arm to the true hand", _mm(figures.get("min_arm_to_hand_m"))),
    ]


def _row(scene: SceneReport) -> list[str]:
    verdict, outcome, measured = scene.verdict, scene.outcome, ["-"] * 5
    if verdict is not None:
        measured = [
            f"{verdict.delta_safe_share:.1%}",
            f"{_mm(verdict.max_error_m)} ({_mm(verdict.max_excess_m)})",
            _mm(verdict.min_tool_to_hand_m),
            _mm(verdict.min_arm_to_hand_m),
            str(verdict.contacts),
        ]
        if not verdict.safe:
            outcome = f"**executed, not safe** {verdict.stop_reason}".strip()
    return [
        scene.scene_id,
        outcome,
        "-" if scene.cost is None else f"{scene.cost:.4f}",
        "-" if scene.area_m2 is None else f"{1e4 * scene.area_m2:.1f} cm²",
        "-" if scene.length_m is None else f"{100 * scene.length_m:.1f} cm",
        "-" if scene.duration_s is None else f"{scene.duration_s:.1f} s",
        *measured,
    ]


def _mm(length_m: float | None) -> str:
    return "no hand or no links" if length_m is None else f"{1000 * length_m:.1f} mm"
