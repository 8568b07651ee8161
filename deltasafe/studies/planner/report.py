"""The report of the study: Markdown with its pictures and all raw runs beside it."""

import pathlib
from collections.abc import Sequence

import numpy as np

from deltasafe.io.storage import atomic_folder, write_json
from deltasafe.studies.planner.cost_comparison import SCENES, Comparison
from deltasafe.studies.planner.effects import Effect, effects_of_cost, effects_of_time
from deltasafe.studies.planner.methods import MAIN, constraint_of, contenders, field_of, search
from deltasafe.studies.planner.scenes import EllipticDisc, cluttered_scene
from deltasafe.studies.planner.timing import TIMED, Timing

__all__ = ["figures_of", "write_study"]


def figures_of(comparison: Comparison, timing: Timing) -> dict[str, float]:
    """The figures that a record holds, by name."""
    runs = sum(comparison.n_runs(one.name) for one in contenders(comparison.settings))
    figures = {
        "plans": comparison.settings.n_levels * len(SCENES) * runs,
        "fig5_minutes": comparison.effort.minutes,
        "fig5_cpu_minutes": comparison.effort.cpu_minutes,
        "fig6_minutes": timing.effort.minutes,
        "fig6_cpu_minutes": timing.effort.cpu_minutes,
    }
    for scene in SCENES:
        for name in (*MAIN, "chance_constraint_each", "exact", "equal_margin"):
            mean, _ = comparison.normalized_cost(scene, name)
            figures[f"cost_{scene}_{name}_none"] = float(mean[0])
            figures[f"cost_{scene}_{name}_largest"] = float(mean[-1])
            figures[f"safe_share_{scene}_{name}"] = comparison.safe_share(scene, name)
            figures[f"solved_share_{scene}_{name}"] = float(comparison.solved_share(scene, name).min())
    for name in TIMED:
        median = timing.median_s(name)
        figures[f"ms_{name}_first"], figures[f"ms_{name}_last"] = 1000 * float(median[0]), 1000 * float(median[-1])
    figures["field_ms_first"], figures["field_ms_last"] = 1000 * timing.field_s[0], 1000 * timing.field_s[-1]
    for effect in (*effects_of_cost(comparison), *effects_of_time(timing)):
        figures[f"holds_{effect.name}"] = float(effect.holds)
    return {name: round(float(value), 6) for name, value in figures.items() if np.isfinite(value)}


def write_study(comparison: Comparison, timing: Timing, folder: str | pathlib.Path) -> dict[str, float]:
    """Write `report.md` with its pictures, the runs and `figures.json`, as a whole; the figures are returned."""
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
    """`above.png` and `space.png`: a search in the cluttered scene at half of the largest uncertainty."""
    from deltasafe.studies.planner.search_figures import search_from_above, search_in_space

    settings = comparison.settings
    shapes, level_m = cluttered_scene().shapes, settings.largest_level_m / 2
    field = field_of(shapes, level_m, settings)
    constraint = constraint_of(None, shapes, field, level_m / 2, settings, "continuous")
    tree = search(constraint, "root", settings, 0)
    title = f"Cluttered scene, {len(tree.nodes)} nodes, every segment tested continuously"
    for draw, name in ((search_from_above, "above"), (search_in_space, "space")):
        draw(tree, field, EllipticDisc(), folder / f"{name}.png", title=title)


def _markdown(comparison: Comparison, timing: Timing) -> str:
    settings = comparison.settings
    plans = int(figures_of(comparison, timing)["plans"])
    parts = [
        "# The planner against the compared methods",
        f"{plans} plans: {settings.n_levels} levels of uncertainty, {settings.n_runs} runs of each of the four methods "
        f"({settings.n_runs_beside} of each reference and of the squared cost), two scenes, "
        f"{settings.n_iterations} iterations, N_x = {settings.n_samples}, delta = {settings.delta:g}. Runs of all "
        "methods share their seeds.",
        "One level of uncertainty is the same d-tilde = 2 sigma for all: our probability falls linearly to zero at "
        "d-tilde / 0.95, so that P(occupied) = 0.05 lies at d-tilde; the others get sigma = d-tilde / 2 and follow "
        "their own rules. Two sigma is 95 % neither one-sided (1.645) nor for a ball (2.795); the bounding volume "
        "takes three. Hence the comparison at an equal margin below.",
        "![A search in space](space.png)",
        "![The same from above](above.png)",
        "## Cost of the path (Fig. 5)",
        "![Fig. 5](fig5.png)",
        _effects(effects_of_cost(comparison)),
        "Normalized by the largest mean of the four methods over all levels of the scene; raw costs are in "
        "`fig5_runs/runs.npz`. The line cost is the additive root; the paper's squared one, which n equal pieces make "
        "n times cheaper, stands beside it.",
        _cost_table(comparison),
        "### At no uncertainty, and at an equal margin",
        _parts_table(comparison),
        "What the others lose at no uncertainty is the geometry that they need: the disc becomes a ball, a cuboid an "
        "ellipsoid. With a margin of 2 sigma for all, every Gaussian method is the same ball around a sphere.",
        "![References](fig5_references.png)",
        "### Every path checked again",
        "Share of the paths that the continuous test of the field passes. Ours is the paper's sampled test here: "
        "it lets through what lies between its samples and poses, and RRT\\* finds such places.",
        _safety_table(comparison),
        "## Time of a search (Fig. 6)",
        "![Fig. 6](fig6.png)",
        f"CPU time of {timing.settings.n_iterations} iterations, medians of {timing.settings.n_runs} runs, "
        f"all methods compiled. Spheres of radius {1000 * timing.settings.radius_m:.0f} mm at random places, "
        f"d-tilde = {1000 * timing.settings.level_m:.0f} mm.",
        _effects(effects_of_time(timing)),
        _time_table(timing),
    ]
    return "\n\n".join(parts) + "\n"


def _effects(effects: Sequence[Effect]) -> str:
    rows = [f"| {effect.claim} | **{'yes' if effect.holds else 'no'}** | {effect.evidence} |" for effect in effects]
    return "\n".join(["| The paper says or shows | holds here | evidence |", "|---|---|---|", *rows])


def _cell(mean: float, error: float) -> str:
    if not np.isfinite(mean):
        return "no path"
    return f"{mean:.3f} ± {error:.3f}" if np.isfinite(error) else f"{mean:.3f}"


def _change(ratio: float) -> str:
    return f"{100 * (ratio - 1):+.1f} %" if np.isfinite(ratio) else "no path"


def _cost_table(found: Comparison) -> str:
    label = {one.name: one.label for one in contenders(found.settings)}
    shown = np.unique(np.linspace(0, found.settings.n_levels - 1, 6).round().astype(int))
    levels = " | ".join(f"{1000 * found.settings.levels_m[n]:.0f} mm" for n in shown)
    lines = [f"| scene, line cost, method | {levels} | paths found |", "|---|" + "---|" * (len(shown) + 1)]
    for scene in SCENES:
        for suffix, kind in (("", "root"), ("_squared", "squared")):
            for name in MAIN:
                mean, error = found.normalized_cost(scene, name + suffix)
                cells = " | ".join(_cell(mean[n], error[n]) for n in shown)
                share = 100 * float(found.solved_share(scene, name + suffix).min())
                lines.append(f"| {scene}, {kind}, {label[name]} | {cells} | ≥ {share:.0f} % |")
    return "\n".join(lines)


def _parts_table(found: Comparison) -> str:
    label = {one.name: one.label for one in contenders(found.settings)}
    lines = ["| scene, method | at none, against ours | rise to the largest |", "|---|---|---|"]
    for scene in SCENES:
        ours = found.normalized_cost(scene, "ours")[0][0]
        for name in (*MAIN, "chance_constraint_each", "exact", "equal_margin"):
            mean, _ = found.normalized_cost(scene, name)
            lines.append(f"| {scene}, {label[name]} | {_change(mean[0] / ours)} | {_change(mean[-1] / mean[0])} |")
    return "\n".join(lines)


def _safety_table(found: Comparison) -> str:
    lines = ["| method | " + " | ".join(SCENES) + " |", "|---|" + "---|" * len(SCENES)]
    for one in contenders(found.settings):
        if not one.name.endswith("_squared"):
            shares = " | ".join(_share(found.safe_share(scene, one.name)) for scene in SCENES)
            lines.append(f"| {one.label} | {shares} |")
    return "\n".join(lines)


def _share(value: float) -> str:
    return f"{100 * value:.1f} %" if np.isfinite(value) else "no path"


def _time_table(found: Timing) -> str:
    counts = found.settings.counts
    shown = np.unique(np.searchsorted(counts, [counts[0], 10, 50, counts[-1]]).clip(0, len(counts) - 1))
    lines = ["| ms | " + " | ".join(str(counts[n]) for n in shown) + " |", "|---|" + "---|" * len(shown)]
    for name in TIMED:
        median = 1000 * found.median_s(name)
        lines.append(f"| {name.replace('_', ' ')} | " + " | ".join(f"{median[n]:.1f}" for n in shown) + " |")
    built = 1000 * found.field_s
    lines.append("| field built | " + " | ".join(f"{built[n]:.0f}" for n in shown) + " |")
    return "\n".join(lines)
