"""A small study from end to end: resumable, the same with any number of workers, and honest about what holds."""

import dataclasses
import json
import math

import numpy as np
import pytest

from deltasafe.errors import DataError, SettingsError
from deltasafe.studies.planner import (
    MAIN,
    Comparison,
    ComparisonSettings,
    Timing,
    TimingSettings,
    compare,
    contenders,
    effects_of_cost,
    effects_of_time,
    measure_times,
    paper_curves,
    write_study,
)
from deltasafe.studies.planner.cost_comparison import MEASURES, SCENES
from deltasafe.studies.planner.timing import TIMED
from deltasafe.studies.resumable_jobs import Effort, run_batches

COSTS = ComparisonSettings(n_levels=2, n_runs=3, n_runs_beside=2, n_iterations=400, voxel_m=0.01)
TIMES = TimingSettings(counts=(1, 12), n_runs=2, n_iterations=200, voxel_m=0.01)


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    folder = tmp_path_factory.mktemp("study")
    return folder, compare(COSTS, folder / "batches"), measure_times(TIMES, folder / "batches")


def double(value, factor):
    return {"value": np.array(value * factor)}


def fail(value, factor):
    raise RuntimeError("interrupted")


def test_finished_batches_are_found_and_only_those_that_match(tmp_path):
    jobs = [(f"job-{value}", (value, 2)) for value in range(4)]
    told = []
    batches, effort = run_batches(double, jobs, tmp_path, progress=lambda *report: told.append(report))
    assert [int(batch["value"]) for batch in batches] == [0, 2, 4, 6]
    assert effort.minutes >= 0
    assert told[0][:2] == (0, 4)
    assert told[-1][:2] == (4, 4)
    # nothing is left to do, so that work which would fail is never asked
    files = sorted(tmp_path.iterdir())
    stamps = [file.stat().st_mtime_ns for file in files]
    again, _ = run_batches(double, jobs, tmp_path, workers=2)
    assert [int(batch["value"]) for batch in again] == [0, 2, 4, 6]
    assert [file.stat().st_mtime_ns for file in sorted(tmp_path.iterdir())] == stamps
    files[1].unlink()
    run_batches(double, jobs, tmp_path)
    assert sorted(tmp_path.iterdir()) == files
    # other arguments and other work are other batches
    other, _ = run_batches(double, [("job-0", (5, 2))], tmp_path)
    assert int(other[0]["value"]) == 10
    with pytest.raises(RuntimeError, match="interrupted"):
        run_batches(fail, jobs, tmp_path)


def test_an_interrupted_study_goes_on_where_it_was(tmp_path):
    def stop_after_two(done, total, message):
        if done == 2:
            raise KeyboardInterrupt

    jobs = [(f"job-{value}", (value, 3)) for value in range(4)]
    with pytest.raises(KeyboardInterrupt):
        run_batches(double, jobs, tmp_path, progress=stop_after_two)
    assert len(list(tmp_path.iterdir())) == 2
    told = []
    batches, _ = run_batches(double, jobs, tmp_path, progress=lambda *report: told.append(report))
    assert told[0][0] == 2
    assert [int(batch["value"]) for batch in batches] == [0, 3, 6, 9]


def test_a_damaged_batch_is_named(tmp_path):
    run_batches(double, [("job", (1, 1))], tmp_path)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:40])
    with pytest.raises(DataError, match="delete it"):
        run_batches(double, [("job", (1, 1))], tmp_path)
    with pytest.raises(SettingsError, match="workers"):
        run_batches(double, [], tmp_path, workers=0)


def test_processes_side_by_side_make_the_same_runs(made, tmp_path):
    folder, costs, _ = made
    again = compare(COSTS, tmp_path, workers=2)
    for measure in MEASURES:
        if measure != "seconds":
            np.testing.assert_array_equal(again.runs[measure], costs.runs[measure])
    assert sorted(file.name for file in tmp_path.iterdir()) == sorted(
        file.name for file in (folder / "batches").iterdir() if not file.name.startswith("spheres")
    )


def test_every_method_plans_and_only_its_own_runs_count(made):
    _, costs, _ = made
    for scene in SCENES:
        for one in contenders(COSTS):
            count = COSTS.n_runs if one.is_main else COSTS.n_runs_beside
            assert costs.of("cost_root", scene, one.name).shape == (2, count)
            found = costs.runs["n_nodes"][SCENES.index(scene), :, costs.names.index(one.name)]
            assert np.isfinite(found[:, :count]).all()
            assert np.isnan(found[:, count:]).all()
            root, length = (costs.of(name, scene, one.name) for name in ("cost_root", "length_m"))
            solved = np.isfinite(root)
            assert (root[solved] >= length[solved] - 1e-12).all()
            assert (length[solved] >= math.sqrt(2) * 0.8 - 1e-9).all()
            assert solved[0].all()  # with little uncertainty there is always a way


def test_normalized_costs_follow_decision_20(made):
    _, costs, _ = made
    for scene in SCENES:
        for suffix in ("", "_squared"):
            largest = max(np.nanmax(costs.normalized_cost(scene, name + suffix)[0]) for name in MAIN)
            assert largest == pytest.approx(1.0)
    mean, error = costs.mean_cost("simple", "ours")
    raw = costs.of("cost_root", "simple", "ours")
    assert mean == pytest.approx(np.nanmean(raw, axis=1))
    assert error == pytest.approx(np.nanstd(raw, axis=1, ddof=1) / np.sqrt(np.isfinite(raw).sum(axis=1)))


def test_what_is_saved_is_loaded(made, tmp_path):
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


def test_culled_and_plain_formulas_grow_the_same_trees(made):
    _, _, times = made
    for name in ("chance_constraint", "bounding_volume", "max_probability"):
        nodes = [times.n_nodes[:, TIMED.index(n)] for n in (name, f"{name}_culled")]
        np.testing.assert_array_equal(*nodes)
    np.testing.assert_array_equal(
        *(times.n_nodes[:, TIMED.index(n)] for n in ("max_probability", "max_probability_numeric"))
    )
    assert (times.seconds > 0).all()
    assert (times.field_s > 0).all()


def test_the_report_shows_figures_effects_and_pictures(made, tmp_path):
    _, costs, times = made
    figures = write_study(costs, times, tmp_path / "report")
    text = (tmp_path / "report" / "report.md").read_text()
    assert figures == json.loads((tmp_path / "report" / "figures.json").read_text())
    assert figures["plans"] == 2 * 2 * (4 * 3 + 7 * 2)
    for name in ("fig5", "fig5_references", "fig6", "above", "space"):
        assert f"({name}.png)" in text
        assert (tmp_path / "report" / f"{name}.png").stat().st_size > 10_000
    for effect in (*effects_of_cost(costs), *effects_of_time(times)):
        assert f"| {effect.claim} | **{'yes' if effect.holds else 'no'}** | {effect.evidence} |" in text
        assert figures[f"holds_{effect.name}"] == float(effect.holds)
    assert "nan" not in text


def invented_costs(rises):
    """A comparison in which each method's cost rises linearly, with hardly any spread."""
    names = [one.name for one in contenders(COSTS)]
    runs = {name: np.ones((2, 2, len(names), 3)) for name in MEASURES}
    for index, name in enumerate(names):
        for scene in range(2):
            rise = rises.get(name.removesuffix("_squared"), (0.1, 0.1))[scene]
            for measure in ("cost_root", "cost_squared"):
                runs[measure][scene, 1, index] = 1 + rise + 1e-4 * np.arange(3)
                runs[measure][scene, 0, index] = 1 + 1e-4 * np.arange(3)
    return Comparison(COSTS, runs, Effort(1.0, 1.0))


def test_effects_hold_where_the_paper_is_right_and_only_there():
    like_the_paper = {
        "ours": (0.11, 0.24),
        "chance_constraint": (0.12, 0.33),
        "bounding_volume": (0.15, 0.27),
        "max_probability": (0.3, 0.4),
        "chance_constraint_each": (0.1, 0.3),
    }
    effects = {effect.name: effect.holds for effect in effects_of_cost(invented_costs(like_the_paper))}
    assert all(effects.values()), effects
    turned = dict(zip(MAIN, reversed([like_the_paper[name] for name in MAIN]), strict=True))
    turned["chance_constraint_each"] = (0.0, 0.0)
    effects = {effect.name: effect.holds for effect in effects_of_cost(invented_costs(turned))}
    assert not any(effects.values()), effects


def test_effects_of_time_are_judged_by_times():
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
    effects = {effect.name: effect.holds for effect in effects_of_time(like_the_paper)}
    assert effects["parametric_grow"]
    assert not effects["parametric_grow_culled"]
    assert effects["order_of_slopes"]
    assert effects["flat_ours"]
    assert effects["slower_than_ours_chance_constraint"]
    assert not effects["slower_than_ours_chance_constraint_culled"]
    ours = {effect.name: effect.holds for effect in effects_of_time(timing(ours=0.1))}
    assert not ours["flat_ours"]
    assert ours["time_depends_on_samples"]
    assert not ours["parametric_grow"]


def test_the_papers_curves_are_the_printed_ones():
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
    ("settings", "change", "told"),
    [
        (ComparisonSettings, {"n_levels": 1}, "two levels"),
        (ComparisonSettings, {"n_runs": 10, "n_runs_beside": 11}, "beside"),
        (ComparisonSettings, {"least_level_m": 0.0}, "levels"),
        (ComparisonSettings, {"delta": 0.6}, "delta"),
        (ComparisonSettings, {"voxel_m": -1.0}, "voxel_m"),
        (TimingSettings, {"counts": (3, 2)}, "counts"),
        (TimingSettings, {"counts": ()}, "counts"),
        (TimingSettings, {"n_runs": 0}, "n_runs"),
        (TimingSettings, {"radius_m": 0.0}, "radius_m"),
    ],
)
def test_impossible_studies_are_refused(settings, change, told):
    with pytest.raises(SettingsError, match=told):
        settings(**change)


def test_the_study_is_the_papers():
    settings = ComparisonSettings()
    assert (settings.n_levels, settings.n_runs, settings.n_iterations, settings.n_samples) == (26, 100, 2000, 100)
    assert settings.n_levels * settings.n_runs * len(MAIN) * len(SCENES) == 20_800
    assert settings.levels_m[-1] == pytest.approx(0.05)
    assert settings.levels_m[1] == pytest.approx(0.002)
    assert (TimingSettings().counts[0], TimingSettings().counts[-1]) == (1, 100)
