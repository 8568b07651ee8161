"""OMPL as a contender: its C++ library with a harness compiled here, and its wheel with our test in the callback."""

import importlib.util
import math
import pathlib
import shutil
import subprocess
import time
from typing import Any

import numpy as np

from deltasafe.planner_study.scenes import GOAL, HIGHEST_POSE, LOWEST_POSE, START
from deltasafe.planning.constraint import ask_segment
from evidence.benchmarks.planner.problems import COST, GOAL_BIAS, STEERING_M, Problem

__all__ = ["REWIRE_FACTOR", "compiled_harness", "harness", "has_wheel", "wheel"]

REWIRE_FACTOR = 1.1 / 32
"""OMPL's constant of the k-nearest theorem is 2^(d+1) times that of decision 19."""

SCALE = np.array([1.0, 1.0, 1.0, math.sqrt(COST.rotation_weight_m2)])


def compiled_harness(folder: pathlib.Path) -> pathlib.Path | None:
    """The harness, compiled into ``folder``; None where there is no compiler or no OMPL (apt: libompl-dev)."""
    includes = [
        path for name in ("ompl-1.5", "ompl-1.6", "eigen3") if (path := pathlib.Path("/usr/include", name)).is_dir()
    ]
    if shutil.which("g++") is None or not any("ompl" in path.name for path in includes):
        return None
    program = folder / "ompl_harness"
    source = pathlib.Path(__file__).with_name("ompl_harness.cpp")
    flags = ["-O3", "-march=native", "-std=c++17", *(f"-I{path}" for path in includes)]
    subprocess.run(["g++", *flags, str(source), "-o", str(program), "-lompl"], check=True)
    return program


def harness(
    program: pathlib.Path,
    problem: pathlib.Path,
    planner: str,
    budget: float,
    seed: int,
    timed: bool = False,
    simplify: float = 0.0,
    rewire_factor: float = REWIRE_FACTOR,
) -> tuple[float, float]:
    """Seconds of its thread and cost: ``budget`` iterations or seconds, of which a share may go to simplification."""
    words = [program, problem, planner, "seconds" if timed else "iterations", budget, seed, simplify, rewire_factor]
    answer = subprocess.run([str(word) for word in words], check=True, capture_output=True, text=True).stdout.split()
    return float(answer[0]), float(answer[1])


def has_wheel() -> bool:
    """Whether OMPL's wheel is installed."""
    return importlib.util.find_spec("ompl") is not None


def wheel(
    problem: Problem,
    constraint: Any,
    planner: str,
    budget: float,
    seed: int,
    timed: bool = False,
    simplify: float = 0.0,
    rewire_factor: float | None = REWIRE_FACTOR,
) -> tuple[float, float]:
    """As ``harness``, with our compiled test behind a callback in Python."""
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    space = base.RealVectorStateSpace(4)
    bounds = base.RealVectorBounds(4)
    for axis in range(4):
        bounds.setLow(axis, LOWEST_POSE[axis] * SCALE[axis])
        bounds.setHigh(axis, HIGHEST_POSE[axis] * SCALE[axis])
    space.setBounds(bounds)
    setup = geometric.SimpleSetup(space)
    information = setup.getSpaceInformation()
    first, second = np.empty(4), np.empty(4)

    class Motion(base.MotionValidator):
        def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802 - OMPL calls it so
            for axis in range(4):
                first[axis], second[axis] = a[axis] / SCALE[axis], b[axis] / SCALE[axis]
            return bool(ask_segment(constraint, first, second))

    def is_valid(state: Any) -> bool:
        for axis in range(4):
            first[axis] = state[axis] / SCALE[axis]
        return bool(ask_segment(constraint, first, first))

    motion = Motion(information)
    information.setMotionValidator(motion)
    setup.setStateValidityChecker(is_valid)
    ends = []
    for pose in (START, GOAL):
        state = space.allocState()
        for axis in range(4):
            state[axis] = pose[axis] * SCALE[axis]
        ends.append(state)
    setup.setStartAndGoalStates(ends[0], ends[1], 1e-6)
    setup.setOptimizationObjective(base.PathLengthOptimizationObjective(information))
    made = getattr(geometric, planner)(information)
    if planner.endswith("RRTstar"):
        made.setRange(STEERING_M)
        made.setGoalBias(GOAL_BIAS)
        made.setKNearest(True)
        if rewire_factor is not None:
            made.setRewireFactor(rewire_factor)
    setup.setPlanner(made)
    setup.setup()
    asked = 0
    began = time.thread_time()

    def stop() -> bool:
        nonlocal asked
        asked += 1
        return time.thread_time() - began >= budget * (1 - simplify) if timed else asked > budget

    made.solve(base.PlannerTerminationCondition(stop))
    cost = math.inf
    if setup.haveExactSolutionPath():
        path = setup.getSolutionPath()
        if simplify > 0:
            enough = base.PlannerTerminationCondition(lambda: time.thread_time() - began >= budget)
            geometric.PathSimplifier(information).simplify(path, enough)
        cost = path.length()
    return time.thread_time() - began, float(cost)
