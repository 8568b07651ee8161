"""The measures of the planner benchmark. Methods run in turn; times are thread times."""

import functools
import itertools
import math
import statistics
import time
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from deltasafe.planning import is_segment_safe
from deltasafe.planning.audit import audit_path
from deltasafe.planning.collision.yaw_clearance_table import yaw_clearance_table
from deltasafe.studies.planner.scenes import EllipticDisc, crowded_scene
from evidence.benchmarks.planner.ompl import Budget, Ompl, Run
from evidence.benchmarks.planner.problems import DELTA, DELTA_P_M, MARGIN_M, Problem
from evidence.benchmarks.planner.segment_count import segment_counts

REACH_M = EllipticDisc().semi_axis_x_m
Found = tuple[dict[str, Any], dict[str, float]]
"""Results of each method, and figures."""


def compare(methods: Mapping[str, Run | None], repeats: int, warm_up: bool = True) -> dict[str, dict[str, Any]]:
    """Run all available methods in turn with the same seeds, after one call each for compilation.

    Args:
        warm_up: run each method twice per repeat and count the second run, because the method before it has evicted
            the caches.
    """
    runs = {name: run for name, run in methods.items() if run is not None}
    for run in runs.values():
        run(0)
    seconds: dict[str, list[float]] = {name: [] for name in runs}
    costs: dict[str, list[float]] = {name: [] for name in runs}
    for seed in range(repeats):
        for name, run in runs.items():
            if warm_up:
                run(seed)
            taken, cost = run(seed)
            seconds[name].append(taken)
            costs[name].append(cost)
    return {
        name: {
            "median_ms": 1e3 * statistics.median(seconds[name]),
            "min_ms": 1e3 * min(seconds[name]),
            "mean_cost": statistics.fmean(costs[name]),
            "solved": sum(map(math.isfinite, costs[name])),
            "seconds": seconds[name],
        }
        for name in runs
    }


def ratio(found: Mapping[str, Mapping[str, Any]], slow: str, fast: str) -> float:
    """Return the median over repeats of the ratio of two methods' times."""
    return statistics.median(a / b for a, b in zip(found[slow]["seconds"], found[fast]["seconds"], strict=True))


def against_ompl(problem: Problem, iterations: int, repeats: int, ompl: Ompl) -> Found:
    """Compare our RRT* under each segment test with OMPL's under the sampled test, without informed sampling.

    OMPL gets the sampled test with the certificate without yaw, and in ``..._by_yaw`` also the yaw certificate, as
    ours. Both give the same answers.
    """
    methods: dict[str, Run | None] = {
        method: functools.partial(problem.iterations, problem.test(method), iterations)
        for method in ("sampled", "exact", "continuous")
    }
    for suffix, by_yaw in (("", False), ("_by_yaw", True)):
        methods[f"ompl_cpp{suffix}"] = ompl.cpp(problem, "RRTstar", Budget(iterations), by_yaw)
        methods[f"ompl_wheel_numba{suffix}"] = ompl.wheel(problem, "RRTstar", Budget(iterations), by_yaw)
    found = compare(methods, repeats)
    figures = {"ratio_exact_to_sampled": ratio(found, "continuous", "sampled")}
    for name in found:
        if name.startswith("ompl"):
            figures[f"ratio_{name}"] = ratio(found, name, "sampled")
            figures[f"cost_to_{name}"] = found["sampled"]["mean_cost"] / found[name]["mean_cost"]
    return found, figures


def flatness(problem: Problem, iterations: int, repeats: int) -> Found:
    """Measure how the time grows with the number of obstacles and with the number of samples N_x."""
    runs: dict[str, Run] = {}
    crowds = {count: Problem(crowded_scene(count, seed=0, radius_m=0.02)) for count in (1, 10, 100)}
    for count, crowd in crowds.items():
        runs[f"{count} obstacles"] = functools.partial(crowd.iterations, crowd.test("sampled"), iterations)
    for n_samples in (20, 100, 1000):
        test = problem.test("sampled", n_samples)
        runs[f"N_x = {n_samples}"] = functools.partial(problem.iterations, test, iterations)
    found = compare(runs, repeats)
    for count, crowd in crowds.items():
        found[f"{count} obstacles"] |= segment_counts(crowd, iterations, repeats)
    return found, {
        "ratio_100_to_1_obstacles": ratio(found, "100 obstacles", "1 obstacles"),
        "ratio_nx1000_to_nx20": ratio(found, "N_x = 1000", "N_x = 20"),
    }


def growth(problem: Problem, few: int, many: int, repeats: int) -> Found:
    """Measure the ratio of the times of many and few iterations."""
    test = problem.test("sampled")
    runs = {f"{count} iterations": functools.partial(problem.iterations, test, count) for count in (few, many)}
    found = compare(runs, repeats)
    return found, {"growth_50k_to_2k": ratio(found, f"{many} iterations", f"{few} iterations")}


def at_equal_time(
    problems: Mapping[str, Problem], budgets_s: tuple[float, ...], repeats: int, ompl: Ompl
) -> dict[str, Any]:
    """Compare mean costs within a time: ours with both tests, OMPL's with the sampled test and simplification."""
    found: dict[str, Any] = {}
    for name, problem in problems.items():
        for budget_s in budgets_s:
            budget = Budget(budget_s, timed=True, simplify=0.2)
            methods: dict[str, Run | None] = {
                f"ours, {method}": functools.partial(problem.best_within, problem.test(method), budget_s)
                for method in ("continuous", "sampled")
            }
            for planner in ("RRTstar", "InformedRRTstar", "BITstar"):
                methods[f"OMPL {planner}"] = ompl.cpp(problem, planner, budget)
            methods["OMPL AORRTC (wheel)"] = ompl.wheel(problem, "AORRTC", budget)
            table = compare(methods, repeats, warm_up=False)
            for row in table.values():
                del row["seconds"]
            found[f"{name}, {1e3 * budget_s:g} ms"] = table
    return found


def audit(problem: Problem, n_paths: int, iterations: int) -> tuple[int, int, int]:
    """Return the number of paths found with the continuous test, of poses audited every mm, and of unsafe poses."""
    test, points = problem.test("continuous"), _disc_points()
    paths = poses = unsafe = 0
    for seed in range(2 * n_paths):
        if paths == n_paths:
            break
        path = problem.path(test, iterations, seed, informed=True)
        if path is not None:
            audited = audit_path(path, problem.field.grid, points, DELTA, REACH_M)
            paths, poses, unsafe = paths + 1, poses + audited.poses, unsafe + audited.unsafe_poses
    return paths, poses, unsafe


def missed_by_sampling(
    problems: Mapping[str, Problem], n_paths: int, iterations: int, n_samples: tuple[int, ...] = (20, 100, 1000)
) -> dict[str, Any]:
    """Count paths found with the sampled test that the continuous test refuses, or that have an unsafe pose."""
    points, table = _disc_points(), {}
    for name, problem in problems.items():
        continuous = problem.test("continuous")
        for count in n_samples:
            found = [problem.path(problem.test("sampled", count, seed), iterations, seed) for seed in range(n_paths)]
            paths = [path for path in found if path is not None]
            audits = [audit_path(path, problem.field.grid, points, DELTA, REACH_M) for path in paths]
            table[f"{name}, N_x = {count}"] = {
                "paths": len(paths),
                "refused": sum(
                    not all(is_segment_safe(continuous, a, b) for a, b in itertools.pairwise(path)) for path in paths
                ),
                "unsafe": sum(audited.unsafe_poses > 0 for audited in audits),
            }
    return table


def _disc_points(spacing_m: float = 0.001) -> NDArray[np.float64]:
    """Create points of the disc enlarged by the margin, on a grid and on the rim, without code of the planner."""
    disc = EllipticDisc()
    a, b = disc.semi_axis_x_m + MARGIN_M, disc.semi_axis_y_m + MARGIN_M
    x, y = np.meshgrid(np.arange(-a, a + spacing_m, spacing_m), np.arange(-b, b + spacing_m, spacing_m))
    flat = np.column_stack([x.ravel(), y.ravel()])
    flat = flat[(flat[:, 0] / a) ** 2 + (flat[:, 1] / b) ** 2 <= 1]
    angle = np.linspace(0, 2 * np.pi, 400, endpoint=False)
    flat = np.concatenate(
        [flat, np.column_stack([disc.semi_axis_x_m * np.cos(angle), disc.semi_axis_y_m * np.sin(angle)])]
    )
    flat = flat[(flat[:, 0] / disc.semi_axis_x_m) ** 2 + (flat[:, 1] / disc.semi_axis_y_m) ** 2 <= 1]
    half = disc.thickness_m / 2 + MARGIN_M
    return np.concatenate([np.column_stack([flat, np.full(len(flat), height)]) for height in (-half, 0.0, half)])


def yaw_certificate_ms(problem: Problem, repeats: int) -> float:
    """Return the median time to build the yaw certificate, which is built once per field."""
    taken = []
    for _ in range(repeats + 1):
        problem.field.cache.clear()
        began_s = time.thread_time()
        yaw_clearance_table(problem.field, EllipticDisc(), MARGIN_M + DELTA_P_M / 2)
        taken.append(1e3 * (time.thread_time() - began_s))
    return statistics.median(taken[1:])


def cold_compile_s(problem: Problem) -> float:
    """Return the process time of a first search of 50 iterations, compilation included."""
    began_s = time.process_time()
    problem.iterations(problem.test("sampled"), 50, 0)
    return time.process_time() - began_s
