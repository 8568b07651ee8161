"""Report of the tracking study: Markdown with its figure."""

import pathlib

from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.reporting.templates import render
from deltasafe.studies.tracking.bound import coverage_of
from deltasafe.studies.tracking.study import PAPER_MIN_SPEED_MPS, TrackingStudy


def write_report(study: TrackingStudy, folder: str | pathlib.Path) -> dict[str, float]:
    """Write report.md, tracking.png and figures.json atomically; return the figures."""
    from deltasafe.studies.tracking.figures import plot_tracking

    figures = study.figures()
    with atomic_folder(folder) as temporary:
        plot_tracking(study, temporary / "tracking.png")
        (temporary / "report.md").write_text(_markdown(study), encoding="utf-8")
        write_json(temporary / "figures.json", figures)
    return figures


def _markdown(study: TrackingStudy) -> str:
    settings, identified = study.settings, study.coverage()
    return render(
        "deltasafe.studies.tracking",
        "report.md.j2",
        settings=settings,
        bound=study.bound,
        confidence=1 - settings.content**settings.n_bound_runs,
        paper_slope_bound=study.paper_slope_bound,
        paper_min_speed_mps=PAPER_MIN_SPEED_MPS,
        whole=identified[0],
        identified=identified,
        paper_slope=coverage_of(study.paper_slope_bound, study.held_out),
        paper_line=coverage_of(TrackingBound(), study.held_out, PAPER_MIN_SPEED_MPS),
    )
