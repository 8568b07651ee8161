"""A small planner study from end to end, and the paper's statements tested on constructed results."""

import dataclasses
import json
import math
import re

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.studies.planner import (
    Comparison,
    ComparisonSettings,
    Timing,
    TimingSettings,
    n_plans,
    run_comparison,
    run_timing,
    write_report,
)
from deltasafe.studies.planner.cost_comparison import MEASURES, SCENES
from deltasafe.studies.planner.effects import effects_of_cost, effects_of_time
from deltasafe.studies.planner.methods import MAIN, compared_methods
from deltasafe.studies.planner.paper_curves import paper_curves
from deltasafe.studies.planner.timing import TIMED
from deltasafe.studies.resumable_jobs import Effort

COSTS = ComparisonSettings(n_levels=2, n_runs=3, n_runs_reference=2, n_iterations=400, voxel_m=0.01)
TIMES = TimingSettings(counts=(1, 12), n_runs=2, n_iterations=200, voxel_m=0.01)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return folder, run_comparison(COSTS, folder / "batches"), run_timing(TIMES, folder / "batches")


def test_number_of_workers_does_not_change_the_runs(made, tmp_path):
    folder, costs, _ = made
    again = run_comparison(COSTS, tmp_path, workers=2)
    for measure in MEASURES:
        if measure != "seconds":
            np.testing.assert_array_equal(again.runs[measure], costs.runs[measure])
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(
        file.name for file in (folder / "batches").iterdir() if not file.name.startswith("spheres")
    )


def test_every_method_plans_its_own_number_of_runs(made):
    _, costs, _ = made
    for scene in SCENES:
        for one in compared_methods(COSTS):
            count = COSTS.runs_of(one.is_main)
            assert costs.of("cost_root", scene, one.name).shape == (2, count)
            found = costs.runs["n_nodes"][SCENES.index(scene), :, costs.names.index(one.name)]
            assert np.isfinite(found[:, :count]).all()
            assert np.isnan(found[:, count:]).all()
            root, length = (costs.of(name, scene, one.name) for name in ("cost_root", "length_m"))
            solved = np.isfinite(root)
            assert (root[solved] >= length[solved] - 1e-12).all()
            assert (length[solved] >= math.sqrt(2) * 0.8 - 1e-9).all()
            assert solved[0].all()  # at the smallest uncertainty a path exists


def test_costs_are_normalized_as_in_decision_20(made):
    _, costs, _ = made
    for scene in SCENES:
        for suffix in ("", "_squared"):
            largest = max(np.nanmax(costs.normalized_cost(scene, name + suffix)[0]) for name in MAIN)
            assert largest == pytest.approx(1.0)
    mean, error = costs.mean_cost("simple", "ours")
    raw = costs.of("cost_root", "simple", "ours")
    assert mean == pytest.approx(np.nanmean(raw, axis=1))
    assert error == pytest.approx(np.nanstd(raw, axis=1, ddof=1) / np.sqrt(np.isfinite(raw).sum(axis=1)))


def test_saved_studies_load_equal(made, tmp_path):
    _, costs, times = made
    costs.save(tmp_path / "costs")
    times.save(tmp_path / "times")
    again, timed = Comparison.load(tmp_path / "costs"), Timing.load(tmp_path / "times")
    assert (again.settings, again.effort) == (COSTS, costs.effort)
    assert (timed.settings, timed.effort) == (TIMES, times.effort)
    np.testing.assert_array_equal(again.runs["cost_root"], costs.runs["cost_root"])
    np.testing.assert_array_equal(timed.seconds, times.seconds)
    for load, folder in ((Comparison.load, "times"), (Timing.load, "costs"), (Timing.load, "nowhere")):
        with pytest.raises(DataError):
            load(tmp_path / folder)


def test_culling_does_not_change_the_trees(made):
    _, _, times = made
    for name in ("chance_constraint", "bounding_volume", "max_probability"):
        nodes = [times.n_nodes[:, TIMED.index(n)] for n in (name, f"{name}_culled")]
        np.testing.assert_array_equal(*nodes)
    np.testing.assert_array_equal(
        *(times.n_nodes[:, TIMED.index(n)] for n in ("max_probability", "max_probability_numeric"))
    )
    assert (times.seconds > 0).all()
    assert (times.field_s > 0).all()


def test_report_contains_figures_effects_and_tables(made, tmp_path):
    _, costs, times = made
    figures = write_report(costs, times, tmp_path / "report")
    text = (tmp_path / "report" / "report.md").read_text()
    assert figures == json.loads((tmp_path / "report" / "figures.json").read_text())
    assert figures["plans"] == n_plans(COSTS) == 2 * 2 * (4 * 3 + 7 * 2)
    for name in ("fig5", "fig5_references", "fig6", "above", "space"):
        assert f"({name}.png)" in text
        assert (tmp_path / "report" / f"{name}.png").stat().st_size > 10_000
    effects = effects_of_cost(costs) | effects_of_time(times)
    verdicts = re.findall(r"\| \*\*(yes|no)\*\* \| \S", text)
    assert verdicts == ["yes" if effect.holds else "no" for effect in effects.values()]
    assert all(figures[f"holds_{name}"] == effect.holds for name, effect in effects.items())
    assert len({line.count("|") for line in text.splitlines() if "**yes**" in line or "**no**" in line}) == 1
    assert not re.search(r"nan|inf\b|\{", text)


def constructed_costs(rises):
    """Construct a comparison in which each method's cost rises by a given fraction, almost without spread."""
    names = [one.name for one in compared_methods(COSTS)]
    runs = {name: np.ones((2, 2, len(names), 3)) for name in MEASURES}
    for index, name in enumerate(names):
        for scene in range(2):
            rise = rises.get(name.removesuffix("_squared"), (0.1, 0.1))[scene]
            for measure in ("cost_root", "cost_squared"):
                runs[measure][scene, 1, index] = 1 + rise + 1e-4 * np.arange(3)
                runs[measure][scene, 0, index] = 1 + 1e-4 * np.arange(3)
    return Comparison(COSTS, runs, Effort(1.0, 1.0))


def test_effects_of_cost_hold_for_results_like_the_papers_only():
    like_the_paper = {
        "ours": (0.11, 0.24),
        "chance_constraint": (0.12, 0.33),
        "bounding_volume": (0.15, 0.27),
        "max_probability": (0.3, 0.4),
        "chance_constraint_each": (0.1, 0.3),
    }
    effects = {name: effect.holds for name, effect in effects_of_cost(constructed_costs(like_the_paper)).items()}
    assert all(effects.values()), effects
    reversed_rises = dict(zip(MAIN, reversed([like_the_paper[name] for name in MAIN]), strict=True))
    reversed_rises["chance_constraint_each"] = (0.0, 0.0)
    effects = {name: effect.holds for name, effect in effects_of_cost(constructed_costs(reversed_rises)).items()}
    assert not any(effects.values()), effects


def test_effects_of_time_follow_the_measured_times():
    settings = dataclasses.replace(TIMES, counts=(1, 10, 100))
    seconds = np.ones((3, len(TIMED), 2))

    def timing(**slopes):
        made = seconds.copy()
        for name, slope in slopes.items():
            made[:, TIMED.index(name)] += slope * np.array([1, 10, 100])[:, None]
        return Timing(settings, made, made, np.ones(3), Effort(1.0, 1.0))

    like_the_paper = timing(
        chance_constraint=0.02, bounding_volume=0.01, max_probability=0.03, max_probability_numeric=1.0
    )
    effects = {name: effect.holds for name, effect in effects_of_time(like_the_paper).items()}
    assert effects["parametric_grow"]
    assert not effects["parametric_grow_culled"]
    assert effects["order_of_slopes"]
    assert effects["flat_ours"]
    assert effects["slower_than_ours_chance_constraint"]
    assert not effects["slower_than_ours_chance_constraint_culled"]
    ours = {name: effect.holds for name, effect in effects_of_time(timing(ours=0.1)).items()}
    assert not ours["flat_ours"]
    assert ours["time_depends_on_samples"]
    assert not ours["parametric_grow"]


def test_paper_curves_are_the_printed_ones():
    """Spot checks against the coordinates in the paper's source."""
    curves = paper_curves()
    assert curves["cost"]["cluttered"]["chance_constraint"]["normalized_cost"][-1] == pytest.approx(0.953051, abs=1e-6)
    assert curves["cost"]["simple"]["ours"]["normalized_cost"][0] == pytest.approx(0.757430, abs=1e-6)
    assert curves["time"]["bounding_volume"]["seconds"][-1] == pytest.approx(15.23865, abs=1e-5)
    for scene in SCENES:
        for name in MAIN:
            curve = curves["cost"][scene][name]
            assert len(curve["level"]) == len(curve["normalized_cost"]) == 26
            assert curve["level"][-1] == 0.5
        assert max(max(curves["cost"][scene][name]["normalized_cost"]) for name in MAIN) == 1.0


@pytest.mark.parametrize(
    ("settings", "change", "message"),
    [
        (ComparisonSettings, {"n_levels": 1}, "n_levels"),
        (ComparisonSettings, {"n_runs": 10, "n_runs_reference": 11}, "n_runs_reference"),
        (ComparisonSettings, {"least_level_m": 0.0}, "levels"),
        (ComparisonSettings, {"delta": 0.6}, "delta"),
        (ComparisonSettings, {"voxel_m": -1.0}, "voxel_m"),
        (TimingSettings, {"counts": (3, 2)}, "counts"),
        (TimingSettings, {"counts": ()}, "counts"),
        (TimingSettings, {"n_runs": 0}, "n_runs"),
        (TimingSettings, {"radius_m": 0.0}, "radius_m"),
    ],
)
def test_impossible_settings_are_refused(settings, change, message):
    with pytest.raises(SettingsError, match=message):
        settings(**change)


def test_default_study_has_the_papers_size():
    settings = ComparisonSettings()
    assert (settings.n_levels, settings.n_runs, settings.n_iterations, settings.n_samples) == (26, 100, 2000, 100)
    assert settings.n_levels * settings.n_runs * len(MAIN) * len(SCENES) == 20_800
    assert settings.levels_m[-1] == pytest.approx(0.05)
    assert settings.levels_m[1] == pytest.approx(0.002)
    assert (TimingSettings().counts[0], TimingSettings().counts[-1]) == (1, 100)
