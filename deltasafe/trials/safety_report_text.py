"""The safety report as Markdown: `templates/safety_report.md.j2`."""

from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.reporting.templates import render
from deltasafe.trials.safety_report import SafetyReport


def safety_markdown(report: SafetyReport, info: DatasetInfo = HANDS) -> str:
    """Return the report with links to the figures and films beside it; ``info`` names the obstacle."""
    return render("deltasafe.trials", "safety_report.md.j2", **_values(report), info=info, pictures=True)


def safety_summary(report: SafetyReport, info: DatasetInfo = HANDS) -> str:
    """Return the report without figures and films."""
    return render("deltasafe.trials", "safety_report.md.j2", **_values(report), info=info, pictures=False)


def _values(report: SafetyReport) -> dict[str, object]:
    approach = [v.approach_delta_safe_share for v in report.verdicts if v.approach_delta_safe_share is not None]
    return {
        "report": report,
        "figures": report.figures(),
        "approach": (min(approach), max(approach)) if approach else None,
        "films": [scene for scene in report.scenes if scene.film],
        "margins_m": [scene.margin_m for scene in report.scenes],
        "number": _number,
        "mm": lambda length_m, missing="no links": _number("{:.1f} mm", length_m, 1000, missing),
    }


def _number(form: str, value: float | None, factor: float = 1.0, missing: str = "-") -> str:
    return missing if value is None else form.format(factor * value)
