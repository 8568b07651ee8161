"""Each measure of the benchmark: what is run in turns, and what follows from it. Times are those of the thread."""

import functools
import itertools
import math
import pathlib
import statistics
import time
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.planner.asking import segments_asked
from benchmarks.planner.ompl import harness, wheel
from benchmarks.planner.problems import DELTA, DELTA_P_M, MARGIN_M, Problem
from deltasafe.planning import is_segment_safe
from deltasafe.planning.audit import audit_path
from deltasafe.planning.collision.yaw_clearance_table import yaw_clearance_table
from deltasafe.studies.planner.scenes import EllipticDisc, crowded_scene

__all__ = [
    "against_ompl",
    "at_equal_time",
    "audit",
    "cold_compile_s",
    "flatness",
    "growth",
    "missed_by_sampling",
    "turns",
    "yaw_certificate_ms",
]

REACH_M = EllipticDisc().semi_axis_x_m
Run = Callable[[int], tuple[float, float]]


def turns(contenders: Mapping[str, Run], repeats: int, twice: bool = True) -> dict[str, dict[str, Any]]:
    """Seconds and costs of each contender, called in turns with the same seeds after one call to warm up.

    ``twice``: in each turn as well the first call is for warming up: what was called before it has emptied the caches.
    """
    for run in contenders.values():
        run(0)
    seconds: dict[str, list[float]] = {name: [] for name in contenders}
    costs: dict[str, list[float]] = {name: [] for name in contenders}
    for seed in range(repeats):
        for name, run in contenders.items():
            if twice:
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
        for name in contenders
    }


def ratio(found: Mapping[str, Mapping[str, Any]], slow: str, fast: str) -> float:
    """Median over turns of the ratio of two contenders' times."""
    return statistics.median(a / b for a, b in zip(found[slow]["seconds"], found[fast]["seconds"], strict=True))


def against_ompl(
    problem: Problem,
    iterations: int,
    repeats: int,
    program: pathlib.Path | None,
    files: Mapping[str, pathlib.Path],
    with_wheel: bool,
) -> tuple[dict[str, Any], dict[str, float]]:
    """RRT* of so many iterations with each test, and OMPL's with the sampled one; neither informed nor refined.

    OMPL is given the test as one writes it (samples, and the certificate without yaw), and ``..._by_yaw`` all that ours
    has. Both give the same answers.
    """
    tests = {method: problem.test(method) for method in ("sampled", "exact", "continuous")}
    runs: dict[str, Run] = {
        method: functools.partial(problem.iterations, test, iterations) for method, test in tests.items()
    }
    for name, by_yaw in (("", False), ("_by_yaw", True)):
        if program is not None:
            runs["ompl_cpp" + name] = functools.partial(harness, program, files[name], "RRTstar", iterations)
        if with_wheel:
            test = problem.test("sampled", by_yaw=by_yaw)
            runs["ompl_wheel_numba" + name] = functools.partial(wheel, problem, test, "RRTstar", iterations)
    found = turns(runs, repeats)
    figures = {"ratio_exact_to_sampled": ratio(found, "continuous", "sampled")}
    for name in found:
        if name.startswith("ompl"):
            figures[f"ratio_{name}"] = ratio(found, name, "sampled")
            figures[f"cost_to_{name}"] = found["sampled"]["mean_cost"] / found[name]["mean_cost"]
    return found, figures


def flatness(problem: Problem, iterations: int, repeats: int) -> tuple[dict[str, Any], dict[str, float]]:
    """Time over the number of obstacles and over N_x, the field given."""
    runs: dict[str, Run] = {}
    crowds = {count: Problem(crowded_scene(count, seed=0, radius_m=0.02)) for count in (1, 10, 100)}
    for count, crowd in crowds.items():
        runs[f"{count} obstacles"] = functools.partial(crowd.iterations, crowd.test("sampled"), iterations)
    for n_samples in (20, 100, 1000):
        test = problem.test("sampled", n_samples)
        runs[f"N_x = {n_samples}"] = functools.partial(problem.iterations, test, iterations)
    found = turns(runs, repeats)
    for count, crowd in crowds.items():
        found[f"{count} obstacles"] |= segments_asked(crowd, iterations, repeats)
    return found, {
        "ratio_100_to_1_obstacles": ratio(found, "100 obstacles", "1 obstacles"),
        "ratio_nx1000_to_nx20": ratio(found, "N_x = 1000", "N_x = 20"),
    }


def growth(problem: Problem, few: int, many: int, repeats: int) -> tuple[dict[str, Any], dict[str, float]]:
    """What many iterations cost, over what few cost."""
    test = problem.test("sampled")
    runs = {f"{count} iterations": functools.partial(problem.iterations, test, count) for count in (few, many)}
    found = turns(runs, repeats)
    return found, {"growth_50k_to_2k": ratio(found, f"{many} iterations", f"{few} iterations")}


def at_equal_time(
    problems: Mapping[str, Problem],
    budgets_s: tuple[float, ...],
    repeats: int,
    program: pathlib.Path | None,
    files: Mapping[str, pathlib.Path],
    with_wheel: bool,
) -> dict[str, Any]:
    """Mean costs within a time: ours with the continuous test, OMPL's with the sampled one and simplified."""
    found: dict[str, Any] = {}
    for name, problem in problems.items():
        for budget_s in budgets_s:
            runs: dict[str, Run] = {
                "ours, continuous": functools.partial(problem.best_within, problem.test("continuous"), budget_s),
                "ours, sampled": functools.partial(problem.best_within, problem.test("sampled"), budget_s),
            }
            if program is not None:
                for planner in ("RRTstar", "InformedRRTstar", "BITstar"):
                    runs[f"OMPL {planner}"] = functools.partial(
                        harness, program, files[name], planner, budget_s, timed=True, simplify=0.2
                    )
            if with_wheel:
                runs["OMPL AORRTC (wheel)"] = functools.partial(
                    wheel, problem, problem.test("sampled"), "AORRTC", budget_s, timed=True, simplify=0.2
                )
            table = turns(runs, repeats, twice=False)
            for row in table.values():
                del row["seconds"]
            found[f"{name}, {1e3 * budget_s:g} ms"] = table
    return found


def audit(problem: Problem, n_paths: int, iterations: int, spacing_m: float = 0.001) -> tuple[int, int, int]:
    """Paths returned under the continuous test, poses looked at, and unsafe poses among them."""
    test, points = problem.test("continuous"), _points_of_disc()
    paths = poses = unsafe = 0
    seed = 0
    while paths < n_paths and seed < 2 * n_paths:
        search = problem.search(test, seed, informed=True)
        search.grow(iterations)
        path = search.tree.path()
        seed += 1
        if path is not None:
            paths += 1
            looked = audit_path(path, problem.field.grid, points, DELTA, REACH_M, spacing_m)
            poses, unsafe = poses + looked.poses, unsafe + looked.unsafe_poses
    return paths, poses, unsafe


def missed_by_sampling(
    problems: Mapping[str, Problem], n_paths: int, iterations: int, n_samples: tuple[int, ...] = (20, 100, 1000)
) -> dict[str, Any]:
    """Of the paths that the sampled test accepts, how many have a segment refused by the continuous one, or a pose
    that is unsafe when looked at every millimetre."""
    points, table = _points_of_disc(), {}
    for name, problem in problems.items():
        exact = problem.test("continuous")
        for count in n_samples:
            paths = refused = unsafe = 0
            for seed in range(n_paths):
                search = problem.search(problem.test("sampled", count, seed), seed)
                search.grow(iterations)
                path = search.tree.path()
                if path is None:
                    continue
                paths += 1
                refused += not all(is_segment_safe(exact, a, b) for a, b in itertools.pairwise(path))
                unsafe += audit_path(path, problem.field.grid, points, DELTA, REACH_M).unsafe_poses > 0
            table[f"{name}, N_x = {count}"] = {"paths": paths, "refused": refused, "unsafe": unsafe}
    return table


def _points_of_disc(spacing_m: float = 0.001) -> NDArray[np.float64]:
    """Points of the disc enlarged by the margin, on a lattice and on its rim: no code of the planner's."""
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
    """Median time in which the certificate that knows the yaw is made, once for a field."""
    taken = []
    for _ in range(repeats + 1):
        problem.field.cache.clear()
        began = time.thread_time()
        yaw_clearance_table(problem.field, EllipticDisc(), MARGIN_M + DELTA_P_M / 2)
        taken.append(1e3 * (time.thread_time() - began))
    return statistics.median(taken[1:])


def cold_compile_s(problem: Problem) -> float:
    """Seconds of the process until a first search of 50 iterations is done."""
    began = time.process_time()
    problem.iterations(problem.test("sampled"), 50, 0)
    return time.process_time() - began
