"""Report of the planner study: Markdown with figures, and all raw runs beside it."""

import math
import pathlib
from typing import Any

import numpy as np

from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.reporting.templates import render
from deltasafe.studies.planner.cost_comparison import SCENES, Comparison, n_plans
from deltasafe.studies.planner.effects import OTHERS, effects_of_cost, effects_of_time
from deltasafe.studies.planner.methods import MAIN, REFERENCES, build_field, build_test, compared_methods, run_search
from deltasafe.studies.planner.scenes import EllipticDisc, cluttered_scene
from deltasafe.studies.planner.timing import TIMED, Timing


def figures_of(comparison: Comparison, timing: Timing) -> dict[str, float]:
    """Collect the figures of a record, by name."""
    figures: dict[str, Any] = {
        "plans": n_plans(comparison.settings),
        "fig5_minutes": comparison.effort.minutes,
        "fig5_cpu_minutes": comparison.effort.cpu_minutes,
        "fig6_minutes": timing.effort.minutes,
        "fig6_cpu_minutes": timing.effort.cpu_minutes,
    }
    for scene in SCENES:
        for name in (*MAIN, *REFERENCES):
            mean, _ = comparison.normalized_cost(scene, name)
            figures[f"cost_{scene}_{name}_none"] = mean[0]
            figures[f"cost_{scene}_{name}_largest"] = mean[-1]
            figures[f"safe_share_{scene}_{name}"] = comparison.safe_fraction(scene, name)
            figures[f"solved_share_{scene}_{name}"] = comparison.solved_fraction(scene, name).min()
    for name in TIMED:
        median = timing.median_s(name)
        figures[f"ms_{name}_first"], figures[f"ms_{name}_last"] = 1000 * median[0], 1000 * median[-1]
    figures["field_ms_first"], figures["field_ms_last"] = 1000 * timing.field_s[0], 1000 * timing.field_s[-1]
    for name, effect in (effects_of_cost(comparison) | effects_of_time(timing)).items():
        figures[f"holds_{name}"] = effect.holds
    return {name: round(float(value), 6) for name, value in figures.items() if np.isfinite(value)}


def write_report(comparison: Comparison, timing: Timing, folder: str | pathlib.Path) -> dict[str, float]:
    """Write report.md with its figures, all runs and figures.json atomically; return the figures."""
    from deltasafe.studies.planner.figures import plot_cost, plot_references, plot_time

    figures = figures_of(comparison, timing)
    with atomic_folder(folder) as temporary:
        comparison.save(temporary / "fig5_runs")
        timing.save(temporary / "fig6_runs")
        plot_cost(comparison, temporary / "fig5.png")
        plot_references(comparison, temporary / "fig5_references.png")
        plot_time(timing, temporary / "fig6.png")
        _draw_search(comparison, temporary)
        write_json(temporary / "figures.json", figures)
        (temporary / "report.md").write_text(_markdown(comparison, timing), encoding="utf-8")
    return figures


def _draw_search(comparison: Comparison, folder: pathlib.Path) -> None:
    """Draw above.png and space.png: a search in the cluttered scene at half of the largest uncertainty."""
    from deltasafe.studies.planner.search_figures import search_from_above, search_in_space

    settings = comparison.settings
    shapes, level_m = cluttered_scene().shapes, settings.largest_level_m / 2
    field = build_field(shapes, level_m, settings)
    tree = run_search(build_test(None, shapes, field, level_m / 2, settings, "continuous"), "root", settings, 0)
    title = f"Cluttered scene, {len(tree.nodes)} nodes, every segment tested continuously"
    for draw, name in ((search_from_above, "above"), (search_in_space, "space")):
        draw(tree, field, EllipticDisc(), folder / f"{name}.png", title)


def _markdown(comparison: Comparison, timing: Timing) -> str:
    counts, n_levels = timing.settings.counts, comparison.settings.n_levels
    shown_counts = np.searchsorted(counts, [counts[0], 10, 50, counts[-1]]).clip(0, len(counts) - 1)
    return render(
        "deltasafe.studies.planner",
        "report.md.j2",
        n_plans=n_plans(comparison.settings),
        settings=comparison.settings,
        comparison=comparison,
        timing=timing,
        effects=effects_of_cost(comparison) | effects_of_time(timing),
        others=OTHERS,
        is_finite=math.isfinite,
        scenes=SCENES,
        main=MAIN,
        references=REFERENCES,
        timed=TIMED,
        labels={method.name: method.label for method in compared_methods(comparison.settings)},
        shown_levels=np.unique(np.linspace(0, n_levels - 1, 6).round().astype(int)).tolist(),
        shown_counts=np.unique(shown_counts).tolist(),
    )
