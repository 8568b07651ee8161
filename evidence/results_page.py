"""Write `docs/results/README.md`, and the blocks of figures in README.md and docs/ (`evidence.result_blocks`).

Nothing is measured here. Every figure is read from the records in docs/results, which name command, commit and machine.
"""

import argparse
import dataclasses
import math
import pathlib
import sys
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import DataError
from deltasafe.io.storage import atomic_file, read_json
from evidence.result_blocks import filled_pages
from pipelines.home import PROJECT


@dataclasses.dataclass(frozen=True)
class Line:
    """One figure: its record and name there, a description, a format, and a target, if a bound is finite."""

    record: str
    figure: str
    description: str
    form: str = ".3g"
    at_least: float = -math.inf
    at_most: float = math.inf

    @property
    def target(self) -> str:
        """Return the target in words."""
        if math.isfinite(self.at_least):
            return f"at least {_plain(self.at_least)}"
        return f"at most {_plain(self.at_most)}" if math.isfinite(self.at_most) else ""

    def row(self, figures: Mapping[str, float]) -> str:
        """Return the row of the table, with the interval ``NAME_low`` to ``NAME_high`` if the record has one."""
        value = figures.get(self.figure)
        if value is None:
            return f"| {self.description} | not measured | | {self.target} | |"
        low, high = figures.get(f"{self.figure}_low"), figures.get(f"{self.figure}_high")
        interval = "" if low is None or high is None else f"{low:{self.form}} to {high:{self.form}}"
        met = "" if not self.target else ("yes" if self.at_least <= value <= self.at_most else "**no**")
        return f"| {self.description} | {float(value):{self.form}} | {interval} | {self.target} | {met} |"


LINES: dict[str, tuple[Line, ...]] = {
    "Perception": (
        Line("perception", "pa_m10", "pixel accuracy, M = 10, packaged test images", ".4f", 0.985),
        Line("perception", "miou_m10", "mIoU, M = 10", ".4f", 0.96),
        Line("perception", "nll_m10", "NLL, M = 10, without temperature", ".4f", at_most=0.04),
        Line("perception", "bs_m10", "Brier score, M = 10, without temperature", ".4f", at_most=0.011),
        Line(
            "perception",
            "ours_best_in_all_cells",
            "our method is best in all cells of Tables I and II (1: yes)",
            "g",
            1,
        ),
        Line("perception", "training_ratio", "training speedup over a plain loop", ".2f", 1.5),
        Line("perception", "training_peak_share", "training: fraction of the matrix-multiplication peak", ".2f"),
        Line("perception", "inference_ratio", "inference speedup over members in sequence", ".2f", 2.5),
        Line("paper_preset", "paper_preset_s_per_step", "paper preset: measured seconds per step", ".2f"),
        Line("paper_preset", "paper_preset_projected_cpu_hours", "paper preset: projected CPU hours", ".0f"),
        Line("paper_preset", "paper_preset_projected_gpu_hours", "paper preset: projected GPU hours", ".1f"),
    ),
    "Planner": (
        Line("planner", "ratio_ompl_cpp", "speedup over RRT* of OMPL in C++", ".1f", 6),
        Line("planner", "ratio_ompl_cpp_by_yaw", "the same, OMPL with our yaw certificate", ".1f"),
        Line(
            "planner", "ratio_ompl_wheel_numba", "speedup over RRT* of OMPL's wheel with our compiled test", ".1f", 15
        ),
        Line("planner", "ratio_ompl_wheel_numba_by_yaw", "the same, OMPL with our yaw certificate", ".1f"),
        Line("planner", "cost_to_ompl_cpp", "path cost relative to OMPL in C++", ".3f", at_most=1),
        Line(
            "planner",
            "ratio_exact_to_sampled",
            "time of the continuous test relative to the sampled test",
            ".2f",
            at_most=1.5,
        ),
        Line("planner", "audit_unsafe", "unsafe poses in 1000 paths, audited every mm", "g", at_most=0),
        Line("planner", "ratio_100_to_1_obstacles", "time with 100 obstacles relative to 1", ".2f", at_most=1.2),
        Line("planner", "ratio_nx1000_to_nx20", "time with N_x = 1000 relative to 20", ".2f", at_most=1.5),
        Line("planner", "growth_50k_to_2k", "time of 50,000 iterations relative to 2,000", ".0f", at_most=60),
        Line("planner", "scene_ms", "from image to trajectory, ms", ".0f", at_most=60),
        Line("planner", "fig5_minutes", "Fig. 5, minutes", ".1f", at_most=5),
        Line("planner", "fig6_minutes", "Fig. 6, minutes", ".1f", at_most=5),
    ),
    "Execution": (
        Line("safety", "executions", "executed motions", "g", 3000),
        Line(
            "safety",
            "violation_upper95_delta_001",
            "violation rate at delta = 0.01, upper 95 % bound",
            ".2g",
            at_most=0.01,
        ),
        Line("safety", "violation_upper95_delta_005", "the same at delta = 0.05", ".2g", at_most=0.05),
        Line("safety", "violation_upper95_delta_020", "the same at delta = 0.2", ".2g", at_most=0.2),
        Line("safety", "contacts_delta_005", "contacts at delta = 0.05", "g", at_most=0),
        Line("safety", "tracking_coverage", "held-out runs within the tracking bound", ".4f", 0.99),
        Line("safety", "tracking_coverage_lower95", "the same, lower 95 % bound", ".4f"),
        Line("safety", "realtime_factor", "execution speed relative to real time", ".1f"),
    ),
    "Operation": (
        Line("operation", "orchestration_share", "fraction of the default run outside the library", ".3f", at_most=0.1),
        Line("operation", "browser_test_passed", "browser tests of the UI (1: passed)", "g", 1),
        Line(
            "operation",
            "sensor_to_challenger_passed",
            "new images lead to a new challenger without user action (1: passed)",
            "g",
            1,
        ),
        Line("operation", "worse_ensemble_refused", "a worse ensemble is rejected (1: passed)", "g", 1),
        Line("operation", "rollback_passed", "rollback (1: passed)", "g", 1),
        Line("operation", "consumer_ways", "ways of loading the ensemble that passed", "g", 3),
    ),
    "Scale": (
        Line("scale", "workers", "hosts of the cluster", "g", 2),
        Line("scale", "plans", "plans of the study", "g", 1000),
        Line("scale", "digests_equal", "chain and study have the digests of one machine (1: yes)", "g", 1),
        Line(
            "scale",
            "killed_worker_completed",
            "study with a killed process and host has the same plans (1: yes)",
            "g",
            1,
        ),
        Line("scale", "killed_driver_left_nothing", "no work is left after a killed driver (1: yes)", "g", 1),
        Line("scale", "concurrent_runs_both_ran", "two concurrent runs of one job both ran (1: yes)", "g", 1),
        Line("scale", "speedup", "speedup of two hosts over one", ".2f", 1.5),
    ),
    "Reliability": (
        Line("reliability", "bad_inputs", "malformed inputs", "g", 300),
        Line("reliability", "bad_inputs_untyped", "accepted or without a typed error", "g", at_most=0),
        Line("reliability", "flips", "changed bytes in a frozen ensemble", "g", 10_000),
        Line("reliability", "flips_missed", "of them undetected", "g", at_most=0),
        Line("reliability", "kills", "kills of writers", "g", 500),
        Line("reliability", "kills_lost", "of them with torn or lost data", "g", at_most=0),
        Line("reliability", "dagster_kills", "kills of steps, run workers and daemons under Dagster", "g", 100),
        Line("reliability", "dagster_kills_stuck", "stuck runs or leftover processes", "g", at_most=0),
        Line(
            "reliability",
            "dagster_kills_longest_s",
            "longest time from a kill to the end of the run, s",
            ".0f",
            at_most=120,
        ),
        Line("reliability", "denials", "denials of space, permission, server or database", "g"),
        Line("reliability", "denials_failed", "of them without an error, or with lost data", "g", at_most=0),
        Line("reliability", "races", "pairs of concurrent writers of one artifact", "g", 100),
        Line("reliability", "races_mixed", "of them with mixed data", "g", at_most=0),
        Line("reliability", "digests_differing", "artifacts that differ between three processes", "g", at_most=0),
        Line("reliability", "property_scenes", "random planner scenes", "g", 10_000),
        Line("reliability", "property_failures", "violated properties", "g", at_most=0),
        Line("reliability", "pickles_loaded", "pickles loaded, without numba's cache", "g", at_most=0),
        Line("reliability", "soak_materialisations", "materializations in one process", "g", 200),
        Line("reliability", "soak_growth", "relative growth of its memory", ".3f", at_most=0.05),
        Line("reliability", "soak_handles_growth", "growth of its open files and threads", "g", at_most=0),
        Line("reliability", "dependencies_unpinned", "installed packages that are not pinned", "g", at_most=0),
        Line("reliability", "dependencies_audited", "packages checked for known vulnerabilities", "g"),
        Line("reliability", "vulnerabilities", "known vulnerabilities", "g", at_most=0),
    ),
    "Repository": (
        Line("house", "python_lines", "lines of Python without tests", ",.0f", at_most=36_967),
        Line("house", "modules", "modules", "g"),
        Line("house", "longest_module", "longest module, lines", "g", at_most=400),
        Line("house", "longest_function", "longest function, lines", "g", at_most=60),
        Line("house", "most_parameters", "most parameters of a function", "g", at_most=7),
        Line("house", "import_cycles", "import cycles between modules or rooms", "g", at_most=0),
        Line("house", "docs_warnings", "warnings of the documentation build", "g", at_most=0),
        Line("house", "reader_found_of_15", "answers that a new reader found, of 15 questions", "g"),
    ),
}


def _plain(bound: float) -> str:
    return f"{bound:,.0f}" if bound >= 10_000 else f"{bound:g}"


def generated_pages(root: pathlib.Path = PROJECT) -> dict[pathlib.Path, str]:
    """Create the text of every page of a checkout that holds figures.

    Raises:
        DataError: a block of a page cannot be filled.
    """
    results = root / "docs" / "results"
    return {results / "README.md": results_page(results), **filled_pages(root)}


def results_page(results: pathlib.Path) -> str:
    """Create the page from the records in a folder."""
    text = [
        "# Measured figures\n",
        "Generated by `make results` from the records in this folder. Missed targets say **no**.",
        "Each command is valid at its commit; its module may have moved since.",
        "Reports with figures and tables: "
        + ", ".join(f"[{name}]({name}/report.md)" for name in _reports(results))
        + ".",
    ]
    for title, lines in LINES.items():
        text += [f"\n## {title}\n", "| figure | measured | 95 % interval | target | met |", "|---|---|---|---|---|"]
        records = {name: _record(results, name) for name in dict.fromkeys(line.record for line in lines)}
        text += [line.row(records[line.record].get("figures", {})) for line in lines]
        text += ["", *_origins(records)]
    return "\n".join(text) + "\n"


def _reports(results: pathlib.Path) -> list[str]:
    return sorted(path.parent.name for path in results.glob("*/report.md"))


def _record(results: pathlib.Path, name: str) -> dict[str, Any]:
    file = results / f"{name}.json"
    found: dict[str, Any] = read_json(file) if file.is_file() else {}
    return found


def _origins(records: dict[str, dict[str, Any]]) -> list[str]:
    rows = []
    for name, record in records.items():
        for part in record.get("parts", {"": record} if record else {}).values():
            rows.append(f"* [{name}.json]({name}.json): `{part['command']}` at {part['commit']}, {part['machine']}")
    return rows


def main(arguments: list[str] | None = None, root: pathlib.Path = PROJECT) -> int:
    """Run ``python -m evidence.results_page``."""
    parser = argparse.ArgumentParser(prog="python -m evidence.results_page", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; exit with 1 if a page is outdated")
    options = parser.parse_args(arguments)
    try:
        pages = generated_pages(root)
    except DataError as error:
        sys.exit(f"results_page: {error}")
    outdated = [page for page, text in pages.items() if not page.is_file() or page.read_text(encoding="utf-8") != text]
    for page in outdated:
        print(f"{'outdated' if options.check else 'written'}: {page.relative_to(root)}")
        if not options.check:
            with atomic_file(page) as temporary:
                temporary.write_text(pages[page], encoding="utf-8")
    return int(options.check and bool(outdated))


if __name__ == "__main__":
    sys.exit(main())
