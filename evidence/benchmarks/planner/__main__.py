"""Time the planner against OMPL, and its scaling.

Methods run in turn, each with a warm cache on one thread whose CPU time is counted. Figures are medians over repeats.
"""

import argparse
import dataclasses
import sys
from typing import Any

from evidence.benchmarks.measuring import benchmark_parser, foreign_cores
from evidence.benchmarks.planner import measures
from evidence.benchmarks.planner.ompl import Ompl
from evidence.benchmarks.planner.problems import problems
from evidence.benchmarks.planner.scene_time import scene_times
from evidence.reporting import finish


@dataclasses.dataclass(frozen=True)
class Sizes:
    """Number of iterations, repeats, paths and scenes."""

    iterations: int
    many_iterations: int
    repeats: int
    equal_time_repeats: int
    audited_paths: int
    sampled_paths: int
    n_scenes: int
    budgets_s: tuple[float, ...]

    @classmethod
    def chosen(cls, options: argparse.Namespace) -> "Sizes":
        """Take the sizes of the options, or tiny ones."""
        if options.tiny:
            return cls(200, 1000, 2, 2, 3, 3, 1, (0.005,))
        repeats = options.repeats
        return cls(2000, 50_000, repeats, max(5, 2 * repeats), options.paths, 100, 5, (0.005, 0.05, 0.2))


def measure(sizes: Sizes) -> tuple[dict[str, float], dict[str, Any]]:
    """Return figures and details of all measures."""
    scenes = problems()
    cluttered, iterations, repeats = scenes["cluttered"], sizes.iterations, sizes.repeats
    figures: dict[str, float] = {}
    details: dict[str, Any] = {
        "cold_compile_cpu_s": measures.cold_compile_s(cluttered),
        "yaw_certificate_ms": measures.yaw_certificate_ms(cluttered, repeats),
    }
    with Ompl.available(scenes) as ompl, foreign_cores() as others:
        for name, (found, gained) in {
            "ompl": measures.against_ompl(cluttered, iterations, repeats, ompl),
            "flatness": measures.flatness(cluttered, iterations, repeats),
            "growth": measures.growth(cluttered, iterations, sizes.many_iterations, max(2, repeats // 3)),
        }.items():
            details[name] = found
            figures |= gained
        details["equal_time"] = measures.at_equal_time(scenes, sizes.budgets_s, sizes.equal_time_repeats, ompl)
        details["scene"] = scene_times(repeats, sizes.n_scenes)
        figures["scene_ms"] = details["scene"]["median_ms"]["whole"]
    paths, poses, unsafe = measures.audit(cluttered, sizes.audited_paths, iterations)
    figures |= {"audit_paths": paths, "audit_poses": poses, "audit_unsafe": unsafe}
    details["missed_by_sampling"] = measures.missed_by_sampling(scenes, sizes.sampled_paths, iterations)
    details["foreign_cores"] = others.cores
    return figures, details


def _print_details(details: dict[str, Any]) -> None:
    print(f"first search, compiled or from the cache: {details['cold_compile_cpu_s']:.1f} s of this process")
    print(f"yaw certificate, once per field: {details['yaw_certificate_ms']:.1f} ms")
    for name in ("ompl", "flatness", "growth"):
        for method, row in details[name].items():
            print(f"{method}: {row['median_ms']:.2f} ms (min {row['min_ms']:.2f}), cost {row['mean_cost']:.4f}")
    for where, table in details["equal_time"].items():
        print(f"{where}: " + ", ".join(f"{method} {row['mean_cost']:.4f}" for method, row in table.items()))
    steps = details["scene"]["median_ms"]
    print("from image to trajectory: " + ", ".join(f"{step} {ms:.1f} ms" for step, ms in steps.items()))
    for where, row in details["missed_by_sampling"].items():
        print(f"{where}: of {row['paths']} paths {row['refused']} refused, {row['unsafe']} with an unsafe pose")


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.benchmarks.planner``."""
    parser = benchmark_parser("planner", __doc__)
    parser.add_argument("--paths", type=int, default=1000, help="audited paths (default 1000)")
    options = parser.parse_args(arguments)
    sizes = Sizes.chosen(options)
    figures, details = measure(sizes)
    _print_details(details)
    return finish(options, figures, seeds={"searches": [0, sizes.repeats - 1]}, **details)


if __name__ == "__main__":
    sys.exit(main())
