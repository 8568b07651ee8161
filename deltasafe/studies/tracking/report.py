"""The study as a folder that people read: report, picture, figures."""

import pathlib

from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.planning.tracking_bound import TrackingBound
from deltasafe.reporting.markdown import table
from deltasafe.studies.tracking.bound import Coverage, coverage_of
from deltasafe.studies.tracking.study import TrackingStudy

__all__ = ["write_tracking_report"]


def write_tracking_report(study: TrackingStudy, folder: str | pathlib.Path) -> dict[str, float]:
    """Write `report.md`, `tracking.png` and `figures.json` as a whole; returns the figures."""

    from deltasafe.studies.tracking.figures import plot_tracking

    figures = study.figures()
    with atomic_folder(folder) as temporary:
        plot_tracking(study, temporary / "tracking.png")
        (temporary / "report.md").write_text(_markdown(study), encoding="utf-8")
        write_json(temporary / "figures.json", figures)
    return figures


def _markdown(study: TrackingStudy) -> str:
    settings, bound, lifted = study.settings, study.bound, study.lifted_paper_line
    whole = study.coverage()[0]
    confidence = 1 - settings.content**settings.n_bound_runs
    paper = TrackingBound()
    return f"""# The tracking bound

Identified: **gamma(v) = {1e3 * bound.gamma0_m:.3f} mm + {bound.gamma1_s:.5f} s v**. With a confidence of
{confidence:.1%} at least {settings.content:.0%} of all such runs keep to it throughout: the largest excess of
{settings.n_bound_runs} runs, over a slope that {settings.n_slope_runs} other runs gave (Wilks; asked for are
{settings.confidence:.0%}, {settings.least_bound_runs} runs). With the paper's slope, {paper.gamma1_s:g} s, the constant
that does the same is {1e3 * lifted.gamma0_m:.3f} mm.

On {whole.runs} other runs: {whole.runs_within} wholly within, {whole.of_runs:.2%}, lower 95 % bound
{whole.runs_lower95:.2%} (Clopper and Pearson); {whole.of_samples:.3%} of their samples.

![error over speed](tracking.png)

## The identified bound on held-out runs

{_table(study.coverage())}

## The paper's slope with its constant

{_table(coverage_of(lifted, study.held_out))}

## The paper's line, read at no less than 0.01 m/s

{_table(coverage_of(paper, study.held_out, least_speed_mps=0.01))}

A run counts in a bin if one of its samples lies there, and as within if all of these are. Samples of a run depend on
one another: no interval is stated for them. Speed is that of the tool's center; the error is e_pos + rho_max
e_rotation. The arm is a simulated one, whose friction and sensors are drawn for each run.
"""


def _table(coverage: tuple[Coverage, ...]) -> str:
    head = "", "runs", "within", "lower 95 %", "samples", "within", "largest error", "largest excess"
    rows = [
        [
            *(one.name, f"{one.runs}", f"{one.of_runs:.2%}", f"{one.runs_lower95:.2%}"),
            *(f"{one.samples}", f"{one.of_samples:.3%}"),
            *(f"{1e3 * one.largest_error_m:.3f} mm", f"{1e3 * one.largest_excess_m:+.3f} mm"),
        ]
        for one in coverage
    ]
    return table(head, rows)
