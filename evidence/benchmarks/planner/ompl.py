"""OMPL as a baseline: its C++ library with a harness compiled here, and its Python wheel with our segment test."""

import contextlib
import dataclasses
import functools
import importlib.util
import math
import pathlib
import shutil
import subprocess
import tempfile
import time
from collections.abc import Callable, Iterator, Mapping
from typing import Any

import numpy as np

from deltasafe.planning.collision.segment_query import segment_passes
from deltasafe.studies.planner.scenes import GOAL, HIGHEST_POSE, LOWEST_POSE, START
from evidence.benchmarks.planner.problems import COST, GOAL_BIAS, STEERING_M, Problem, write_problem

REWIRE_FACTOR = 1.1 / 32
"""OMPL's constant of the k-nearest theorem is 2^(d+1) times ours."""
SCALE = np.array([1.0, 1.0, 1.0, math.sqrt(COST.rotation_weight_m2)])

Run = Callable[[int], tuple[float, float]]
"""Plans with a seed; returns seconds of thread time and the cost of the path."""


@dataclasses.dataclass(frozen=True)
class Budget:
    """Budget of a search: iterations, or seconds of which the fraction ``simplify`` is left for path simplification."""

    amount: float
    timed: bool = False
    simplify: float = 0.0


@dataclasses.dataclass(frozen=True)
class Ompl:
    """What is available of OMPL.

    Attributes:
        program: the compiled harness, or None.
        files: problem files for the harness, by name of the problem and whether they hold the yaw certificate.
        has_wheel: whether the Python wheel is installed.
    """

    program: pathlib.Path | None
    files: Mapping[tuple[str, bool], pathlib.Path]
    has_wheel: bool

    @classmethod
    @contextlib.contextmanager
    def available(cls, problems: Mapping[str, Problem]) -> Iterator["Ompl"]:
        """Compile the harness and write the problems to a temporary folder."""
        with tempfile.TemporaryDirectory() as name:
            folder = pathlib.Path(name)
            program, has_wheel = compiled_harness(folder), importlib.util.find_spec("ompl") is not None
            if program is None:
                print("OMPL's C++ library is not installed (apt: libompl-dev, g++): left out", flush=True)
            if not has_wheel:
                print("OMPL's wheel is not installed (pip install ompl): left out", flush=True)
            files: dict[tuple[str, bool], pathlib.Path] = {}
            for title, problem in problems.items():
                for by_yaw in (True, False):
                    files[title, by_yaw] = folder / f"{len(files)}.bin"
                    write_problem(problem, 100, files[title, by_yaw], by_yaw)
            yield cls(program, files, has_wheel)

    def cpp(self, problem: Problem, planner: str, budget: Budget, by_yaw: bool = True) -> Run | None:
        """Return a run with the C++ library, or None if it is not installed."""
        if self.program is None:
            return None
        file = self.files[problem.scene.name, by_yaw]
        return functools.partial(_run_harness, self.program, file, planner, budget)

    def wheel(self, problem: Problem, planner: str, budget: Budget, by_yaw: bool = True) -> Run | None:
        """Return a run with the wheel and our compiled test in its callback, or None if it is not installed."""
        if not self.has_wheel:
            return None
        return functools.partial(_run_wheel, problem.test("sampled", by_yaw=by_yaw), planner, budget)


def compiled_harness(folder: pathlib.Path) -> pathlib.Path | None:
    """Compile the harness into ``folder``; None if there is no compiler or no OMPL (apt: libompl-dev)."""
    names = ("ompl-1.5", "ompl-1.6", "eigen3")
    includes = [path for name in names if (path := pathlib.Path("/usr/include", name)).is_dir()]
    if shutil.which("g++") is None or not any("ompl" in path.name for path in includes):
        return None
    program = folder / "ompl_harness"
    source = pathlib.Path(__file__).with_name("ompl_harness.cpp")
    flags = ["-O3", "-march=native", "-std=c++17", *(f"-I{path}" for path in includes)]
    subprocess.run(["g++", *flags, str(source), "-o", str(program), "-lompl"], check=True)
    return program


def _run_harness(
    program: pathlib.Path, problem: pathlib.Path, planner: str, budget: Budget, seed: int
) -> tuple[float, float]:
    unit = "seconds" if budget.timed else "iterations"
    words = [program, problem, planner, unit, budget.amount, seed, budget.simplify, REWIRE_FACTOR]
    output = subprocess.run([str(word) for word in words], check=True, capture_output=True, text=True).stdout.split()
    return float(output[0]), float(output[1])


def _run_wheel(test: Any, planner: str, budget: Budget, seed: int) -> tuple[float, float]:
    from ompl import base, geometric, util

    util.setLogLevel(util.LogLevel.LOG_NONE)
    util.RNG.setSeed(seed + 1)
    setup, _callbacks = _wheel_setup(test, planner)
    calls = 0
    began_s = time.thread_time()

    def stop() -> bool:
        nonlocal calls
        calls += 1
        if budget.timed:
            return time.thread_time() - began_s >= budget.amount * (1 - budget.simplify)
        return calls > budget.amount

    setup.getPlanner().solve(base.PlannerTerminationCondition(stop))
    cost = math.inf
    if setup.haveExactSolutionPath():
        path = setup.getSolutionPath()
        if budget.simplify > 0:
            spent = base.PlannerTerminationCondition(lambda: time.thread_time() - began_s >= budget.amount)
            geometric.PathSimplifier(setup.getSpaceInformation()).simplify(path, spent)
        cost = path.length()
    return time.thread_time() - began_s, float(cost)


def _wheel_setup(test: Any, planner: str) -> tuple[Any, object]:
    """Return the setup and the callbacks, which must be kept alive as long as it is used."""
    from ompl import base, geometric

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
        def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: N802 - OMPL's name
            for axis in range(4):
                first[axis], second[axis] = a[axis] / SCALE[axis], b[axis] / SCALE[axis]
            return bool(segment_passes(test, first, second))

    def is_valid(state: Any) -> bool:
        for axis in range(4):
            first[axis] = state[axis] / SCALE[axis]
        return bool(segment_passes(test, first, first))

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
        made.setRewireFactor(REWIRE_FACTOR)
    setup.setPlanner(made)
    setup.setup()
    return setup, (motion, is_valid)
