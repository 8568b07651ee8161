"""The planner beside OMPL: `python -m evidence.benchmarks.planner [--record docs/results/planner.json]`.

Contenders run in turns, warm, each on one thread whose own time is counted; figures are medians over the turns.
"""

import pathlib
import tempfile
from typing import Any

from evidence.benchmarks.measuring import conclude, foreign_cores, parser, say
from evidence.benchmarks.planner import measures
from evidence.benchmarks.planner.ompl import compiled_harness, has_wheel
from evidence.benchmarks.planner.problems import problems, write_problem
from evidence.benchmarks.planner.scene_time import scene_times

__all__ = ["main"]


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options_of = parser(__doc__)
    options_of.add_argument("--paths", type=int, default=1000, help="paths audited (default 1000)")
    options = options_of.parse_args(arguments)
    small = options.tiny
    iterations, many, repeats = (200, 1000, 2) if small else (2000, 50_000, options.repeats)
    n_paths = 3 if small else options.paths
    made = problems()
    cluttered = made["cluttered"]
    record: dict[str, Any] = {"seeds": {"searches": [0, repeats - 1]}}
    figures: dict[str, float] = {}
    record["cold_compile_cpu_s"] = measures.cold_compile_s(cluttered)
    say(f"first search, compiled or from the cache: {record['cold_compile_cpu_s']:.1f} s of this process")
    record["yaw_certificate_ms"] = measures.yaw_certificate_ms(cluttered, repeats)
    say(f"certificate that knows the yaw, once for the field: {record['yaw_certificate_ms']:.1f} ms")
    with tempfile.TemporaryDirectory() as folder, foreign_cores() as others:
        program, wheel = compiled_harness(pathlib.Path(folder)), has_wheel()
        files = {name: pathlib.Path(folder) / f"{number}.bin" for number, name in enumerate(made)}
        for name, problem in made.items():
            write_problem(problem, 100, files[name])
        given = {"_by_yaw": files["cluttered"], "": pathlib.Path(folder) / "without-yaw.bin"}
        write_problem(cluttered, 100, given[""], with_yaw=False)
        if program is None:
            say("no OMPL in C++ here (apt: libompl-dev, g++): left out")
        if not wheel:
            say("no wheel of OMPL here (pip install ompl): left out")
        for title, (found, gained) in {
            "ompl": measures.against_ompl(cluttered, iterations, repeats, program, given, wheel),
            "flatness": measures.flatness(cluttered, iterations, repeats),
            "growth": measures.growth(cluttered, iterations, many, max(2, repeats // 3)),
        }.items():
            record[title] = found
            figures |= gained
            _print(found)
        budgets_s = (0.005,) if small else (0.005, 0.05, 0.2)
        turns = 2 if small else max(5, 2 * repeats)
        record["equal_time"] = measures.at_equal_time(made, budgets_s, turns, program, files, wheel)
        for where, table in record["equal_time"].items():
            say(f"{where}: " + ", ".join(f"{name} {row['mean_cost']:.4f}" for name, row in table.items()))
        scene = scene_times(2 if small else repeats, n_scenes=1 if small else 5)
        record["scene"], figures["scene_ms"] = scene, scene["median_ms"]["whole"]
        say("from image to trajectory: " + ", ".join(f"{name} {ms:.1f} ms" for name, ms in scene["median_ms"].items()))
    paths, poses, unsafe = measures.audit(cluttered, n_paths, iterations)
    figures |= {"audit_paths": paths, "audit_poses": poses, "audit_unsafe": unsafe}
    record["missed_by_sampling"] = measures.missed_by_sampling(made, 3 if small else 100, iterations)
    for where, row in record["missed_by_sampling"].items():
        say(f"{where}: of {row['paths']} paths {row['refused']} refused, {row['unsafe']} with an unsafe pose")
    record["foreign_cores"] = others.cores
    record["figures"] = figures
    for name, value in figures.items():
        say(f"{name}: {value:.4g}")
    repeats = f" --repeats {options.repeats}" if options.repeats != 9 else ""
    command = f"python -m evidence.benchmarks.planner{repeats}"
    conclude(record, options.record, command)
    return 0


def _print(found: dict[str, Any]) -> None:
    for name, row in found.items():
        say(f"{name}: {row['median_ms']:.2f} ms (least {row['min_ms']:.2f}), cost {row['mean_cost']:.4f}")


if __name__ == "__main__":
    raise SystemExit(main())
