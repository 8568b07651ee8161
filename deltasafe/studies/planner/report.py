"""Report of the planner study: Markdown with figures, and all raw runs beside it."""

import math
import pathlib
from collections.abc import Callable
from typing import Any

import numpy as np

from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.reporting.templates import render
from deltasafe.studies.planner.cost_comparison import SCENES, Comparison, n_plans
from deltasafe.studies.planner.effects import OTHERS, effects_of_cost, effects_of_time
from deltasafe.studies.planner.methods import MAIN, REFERENCES, build_field, build_test, compared_methods, run_search
from deltasafe.studies.planner.scenes import EllipticDisc, cluttered_scene
from deltasafe.studies.planner.timing import TIMED, Timing

Table = tuple[list[str], list[list[str]]]


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
    return render(
        "deltasafe.studies.planner",
        "report.md.j2",
        n_plans=n_plans(comparison.settings),
        settings=comparison.settings,
        timing=timing,
        effects=effects_of_cost(comparison) | effects_of_time(timing),
        others=OTHERS,
        is_finite=math.isfinite,
        cost_table=_cost_table(comparison),
        margin_table=_margin_table(comparison),
        safety_table=_safety_table(comparison),
        time_table=_time_table(timing),
    )


def _cell(value: float, text: Callable[[float], str]) -> str:
    return text(value) if math.isfinite(value) else "no path"


def _with_error(mean: float, error: float) -> str:
    return _cell(mean, lambda value: f"{value:.3f} ± {error:.3f}" if math.isfinite(error) else f"{value:.3f}")


def _change(ratio: float) -> str:
    return _cell(ratio, lambda value: f"{100 * (value - 1):+.1f} %")


def _labels(found: Comparison) -> dict[str, str]:
    return {method.name: method.label for method in compared_methods(found.settings)}


def _cost_table(found: Comparison) -> Table:
    """Normalized costs at six levels, for both line costs."""
    labels, levels_m = _labels(found), found.settings.levels_m
    shown = np.unique(np.linspace(0, len(levels_m) - 1, 6).round().astype(int))
    head = ["scene, line cost, method", *(f"{1000 * levels_m[n]:.0f} mm" for n in shown), "paths found"]
    rows = []
    for scene in SCENES:
        for suffix, kind in (("", "root"), ("_squared", "squared")):
            for name in MAIN:
                mean, error = found.normalized_cost(scene, name + suffix)
                cells = [_with_error(mean[n], error[n]) for n in shown]
                solved = found.solved_fraction(scene, name + suffix).min()
                rows.append([f"{scene}, {kind}, {labels[name]}", *cells, f"≥ {100 * solved:.0f} %"])
    return head, rows


def _margin_table(found: Comparison) -> Table:
    """Cost at no uncertainty relative to ours, and its rise with the uncertainty, references included."""
    labels, rows = _labels(found), []
    for scene in SCENES:
        ours = found.normalized_cost(scene, "ours")[0][0]
        for name in (*MAIN, *REFERENCES):
            mean, _ = found.normalized_cost(scene, name)
            rows.append([f"{scene}, {labels[name]}", _change(mean[0] / ours), _change(mean[-1] / mean[0])])
    return ["scene, method", "at no uncertainty, relative to ours", "rise to the largest uncertainty"], rows


def _safety_table(found: Comparison) -> Table:
    """Fraction of paths that pass the continuous test."""
    labels, rows = _labels(found), []
    for name in (*MAIN, *REFERENCES):
        fractions = [found.safe_fraction(scene, name) for scene in SCENES]
        rows.append([labels[name], *(_cell(value, lambda value: f"{100 * value:.1f} %") for value in fractions)])
    return ["method", *SCENES], rows


def _time_table(found: Timing) -> Table:
    """Median times in milliseconds at four numbers of obstacles."""
    counts = found.settings.counts
    shown = np.unique(np.searchsorted(counts, [counts[0], 10, 50, counts[-1]]).clip(0, len(counts) - 1))
    rows = [[name.replace("_", " "), *(f"{1000 * found.median_s(name)[n]:.1f}" for n in shown)] for name in TIMED]
    rows.append(["building the field", *(f"{1000 * found.field_s[n]:.0f}" for n in shown)])
    return ["ms", *(str(counts[n]) for n in shown)], rows
