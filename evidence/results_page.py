"""`docs/results/README.md`: what was recorded, beside what was aimed at. python -m evidence.results_page [--check]

Nothing is measured here. Every figure is read from the records beside the page, which name command, commit and machine.
"""

import argparse
import dataclasses
import math
import pathlib
import sys
from typing import Any

from deltasafe.storage import atomic_file, read_json
from pipelines.home import PROJECT

__all__ = ["LINES", "Line", "main", "results_page"]

RESULTS = PROJECT / "docs" / "results"


@dataclasses.dataclass(frozen=True)
class Line:
    """One figure: where it stands, what it says, and what it should be (nothing where nothing was aimed at)."""

    record: str
    figure: str
    words: str
    form: str = ".3g"
    at_least: float = -math.inf
    at_most: float = math.inf

    @property
    def aim(self) -> str:
        """In words."""
        if math.isfinite(self.at_least):
            return f"at least {self.at_least:g}"
        return f"at most {self.at_most:g}" if math.isfinite(self.at_most) else ""

    def row(self, value: float | None) -> str:
        """Of the table."""
        if value is None:
            return f"| {self.words} | not measured yet | {self.aim} | |"
        held = "" if not self.aim else ("yes" if self.at_least <= value <= self.at_most else "**no**")
        return f"| {self.words} | {float(value):{self.form}} | {self.aim} | {held} |"


LINES: dict[str, tuple[Line, ...]] = {
    "Perception": (
        Line("perception", "pa_m10", "pixel accuracy, M = 10, embedded test images", ".4f", 0.985),
        Line("perception", "miou_m10", "mIoU, M = 10", ".4f", 0.96),
        Line("perception", "nll_m10", "NLL, M = 10, without a temperature", ".4f", at_most=0.04),
        Line("perception", "bs_m10", "Brier score, M = 10, without a temperature", ".4f", at_most=0.011),
        Line("perception", "ours_best_in_all_cells", "best in all cells of Tables I and II (1: yes)", "g", 1),
        Line("perception", "training_ratio", "training: images/s over those of a plain loop", ".2f", 1.5),
        Line("perception", "training_peak_share", "training: share of the matrix-multiplication peak", ".2f"),
        Line("perception", "inference_ratio", "inference: times as fast as the members one by one", ".2f", 2.5),
        Line("paper_preset", "paper_preset_s_per_step", "paper's preset, trained for real: seconds a step", ".2f"),
        Line("paper_preset", "paper_preset_projected_cpu_hours", "paper's preset, projected: CPU hours", ".0f"),
        Line("paper_preset", "paper_preset_projected_gpu_hours", "paper's preset, projected: GPU hours", ".1f"),
    ),
    "Planner": (
        Line("planner", "ratio_ompl_cpp", "RRT* of OMPL in C++ takes so many times as long", ".1f", 6),
        Line("planner", "ratio_ompl_cpp_by_yaw", "the same, given our certificate that knows the yaw", ".1f"),
        Line("planner", "ratio_ompl_wheel_numba", "that of its wheel, with a compiled test", ".1f", 15),
        Line("planner", "ratio_ompl_wheel_numba_by_yaw", "the same, given that certificate", ".1f"),
        Line("planner", "cost_to_ompl_cpp", "cost of our path over that of OMPL's", ".3f", at_most=1),
        Line("planner", "ratio_exact_to_sampled", "continuous test over sampled one, in time", ".2f", at_most=1.5),
        Line("planner", "audit_unsafe", "unsafe poses in 1000 returned paths, looked at every mm", "g", at_most=0),
        Line("planner", "ratio_100_to_1_obstacles", "time with 100 obstacles over that with 1", ".2f", at_most=1.2),
        Line("planner", "ratio_nx1000_to_nx20", "time with N_x = 1000 over that with 20", ".2f", at_most=1.5),
        Line("planner", "growth_50k_to_2k", "50,000 iterations over 2,000, in time", ".0f", at_most=60),
        Line("planner", "scene_ms", "from image to trajectory, ms", ".0f", at_most=60),
        Line("planner", "fig5_minutes", "Fig. 5 whole, minutes", ".1f", at_most=5),
        Line("planner", "fig6_minutes", "Fig. 6 whole, minutes", ".1f", at_most=5),
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
        Line("safety", "violation_upper95_delta_005", "at delta = 0.05", ".2g", at_most=0.05),
        Line("safety", "violation_upper95_delta_020", "at delta = 0.2", ".2g", at_most=0.2),
        Line("safety", "contacts_delta_005", "contacts at delta = 0.05", "g", at_most=0),
        Line("safety", "tracking_coverage", "runs within the tracking bound, held out", ".4f", 0.99),
        Line("safety", "tracking_coverage_lower95", "the same, lower 95 % bound", ".4f"),
        Line("safety", "realtime_factor", "executions: times faster than real time", ".1f"),
    ),
    "Operation": (
        Line("operation", "orchestration_share", "share of the default run outside the library", ".3f", at_most=0.1),
        Line("operation", "browser_test_passed", "the UI, used by clicks (1: passed)", "g", 1),
        Line("operation", "sensor_to_challenger_passed", "new images lead to a new challenger, unattended", "g", 1),
        Line("operation", "worse_ensemble_refused", "a worse ensemble is refused", "g", 1),
        Line("operation", "rollback_passed", "rolling back", "g", 1),
        Line("operation", "consumer_ways", "ways of pulling the ensemble that work", "g", 3),
    ),
    "Scale": (
        Line("scale", "workers", "hosts of the cluster", "g", 2),
        Line("scale", "plans", "plans of the study", "g", 1000),
        Line("scale", "digests_equal", "chain and study as on one machine (1: every digest)", "g", 1),
        Line("scale", "killed_worker_completed", "a process and a host killed: completed, the same plans", "g", 1),
        Line("scale", "killed_driver_left_nothing", "a killed driver leaves nothing at work", "g", 1),
        Line("scale", "concurrent_runs_both_ran", "two runs of one job at once: both really ran", "g", 1),
        Line("scale", "speedup", "two hosts over one: times as fast", ".2f", 1.5),
    ),
    "Reliability": (
        Line("reliability", "bad_inputs", "malformed inputs", "g", 300),
        Line("reliability", "bad_inputs_untyped", "of them without a typed error", "g", at_most=0),
        Line("reliability", "flips", "changed bytes in a frozen ensemble", "g", 10_000),
        Line("reliability", "flips_missed", "of them missed", "g", at_most=0),
        Line("reliability", "kills", "writers killed at work", "g", 500),
        Line("reliability", "kills_lost", "of them with something torn or lost", "g", at_most=0),
        Line("reliability", "dagster_kills", "steps, run workers and daemons killed under Dagster", "g", 100),
        Line("reliability", "dagster_kills_stuck", "runs stuck or processes left over after them", "g", at_most=0),
        Line("reliability", "dagster_kills_longest_s", "the longest time from a kill to an end, s", ".0f", at_most=120),
        Line("reliability", "denials", "denials of room, permission, server or database", "g"),
        Line(
            "reliability", "denials_failed", "writers without room or permission, that did not say so", "g", at_most=0
        ),
        Line("reliability", "races", "pairs of runs of the same thing", "g", 100),
        Line("reliability", "races_mixed", "of them mixed", "g", at_most=0),
        Line("reliability", "digests_differing", "things that differ between three processes", "g", at_most=0),
        Line("reliability", "property_scenes", "random planner scenes", "g", 10_000),
        Line("reliability", "property_failures", "properties that did not hold", "g", at_most=0),
        Line("reliability", "pickles_loaded", "pickles loaded, numba's cache apart", "g", at_most=0),
        Line("reliability", "soak_materialisations", "materialisations in one process", "g", 200),
        Line("reliability", "soak_growth", "by which its memory grew, as a fraction", ".3f", at_most=0.05),
        Line("reliability", "soak_handles_growth", "open files and threads more at the end", "g", at_most=0),
        Line("reliability", "dependencies_unpinned", "installed packages that are not pinned", "g", at_most=0),
        Line("reliability", "dependencies_audited", "packages that a database of vulnerabilities was asked about", "g"),
        Line("reliability", "vulnerabilities", "known vulnerabilities among them", "g", at_most=0),
    ),
}


def results_page(results: pathlib.Path = RESULTS) -> str:
    """The page as the records beside it have it."""
    text = [
        "# What was measured\n",
        "Written by `make results` from the records in this folder; nothing here was typed. Aims that were missed say",
        "**no**. Pictures and tables: " + ", ".join(f"[{name}]({name}/report.md)" for name in _reports(results)) + ".",
    ]
    for title, lines in LINES.items():
        text += [f"\n## {title}\n", "| what | measured | aim | held |", "|---|---|---|---|"]
        records = {name: _record(results, name) for name in dict.fromkeys(line.record for line in lines)}
        text += [line.row(records[line.record].get("figures", {}).get(line.figure)) for line in lines]
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


def main(arguments: list[str] | None = None) -> int:
    """Write the page, or say whether it is that of the records."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; 1 if the page is another one")
    options = parser.parse_args(arguments)
    page, made = RESULTS / "README.md", results_page()
    if options.check:
        return int(not page.is_file() or page.read_text(encoding="utf-8") != made)
    with atomic_file(page) as temporary:
        temporary.write_text(made, encoding="utf-8")
    print(f"written: {page}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
