"""Tables of the safety report, as head and rows of text."""

from collections.abc import Mapping

import numpy as np

from deltasafe.studies.safety.evidence import Rate, by_speed, evaluate_all, failures, pair
from deltasafe.studies.safety.settings import LABELS, METHODS
from deltasafe.studies.safety.study import SafetyStudy

Table = tuple[list[str], list[list[str]]]
MAX_FAILURES = 60
"""Failures that the report lists."""


def rate_table(study: SafetyStudy, kind: str) -> Table:
    """List the rates of violations or touches (``kind``, a field of ``MethodResult``) with intervals."""
    rows = []
    for found in evaluate_all(study):
        rate: Rate = getattr(found, kind)
        row = [study.label(found.method), f"{found.delta:g}", f"{rate.n}"]
        if rate.n:
            row += [f"{rate.violated}", f"{_percent(rate.interval[0])} to {_percent(rate.interval[1])}"]
            row += map(_percent, (rate.upper95, rate.pose_rate, rate.pose_upper95))
            row.append(f"{_percent(rate.scenes_upper95)} ({rate.scenes_violated} of {rate.scenes})")
        else:
            row += ["-"] * 6
        rows.append(row)
    head = ["method", "delta", "motions", "with a violation", "95 % interval", "upper 95 %", "poses"]
    return [*head, "upper 95 % of poses", "upper 95 %, new scene"], rows


def clearance_table(study: SafetyStudy) -> Table:
    """List clearances, contacts, stops, durations and lengths."""
    rows = [
        [
            *(study.label(found.method), f"{found.delta:g}"),
            *map(millimeters, (found.min_tool_m, *found.quantiles_tool_m[:2], found.min_arm_m)),
            *(f"{found.contacts}", f"{found.stopped}"),
            *(f"{_number(found.duration_s)} s", f"{_number(100 * found.length_m)} cm"),
        ]
        for found in evaluate_all(study)
    ]
    head = ["method", "delta", "tool: minimum", "5 %", "median", "arm: minimum", "motions with a contact", "stopped"]
    return [*head, "duration", "length"], rows


def ensemble_table(study: SafetyStudy) -> Table:
    """Compare the miss rates of ensemble and single member, and what touched the hand."""
    rows = []
    miss_rate, scenario = study.trials["miss_rate"], study.trials["scenario"]
    for delta in study.settings.deltas:
        pairing = pair(study, "single_member", delta)
        single = study.of("single_member", delta)
        ours = study.of("ours", delta) & np.isin(scenario, scenario[single])
        above = f"{int((miss_rate[single] > delta).sum())} single, {int((miss_rate[ours] > delta).sum())} ensemble"
        largest = [_percent(miss_rate[chosen].max(initial=0)) for chosen in (single, ours)]
        counts = [f"{value}" for value in (pairing.n, pairing.only_other, pairing.only_ours)]
        row = [f"{delta:g}", f"{above} of {int(single.sum())}", f"{largest[0]} single, {largest[1]} ensemble"]
        rows.append([*row, *counts, f"p = {pairing.p_value:.2g}"])
    head = ["delta", "miss rate above delta", "largest miss rate", "scenarios in which both moved"]
    return [*head, "only the single member touched", "only the ensemble touched", "sign test"], rows


def pair_table(study: SafetyStudy, other: str) -> Table:
    """Compare our method with another one in the same scenarios."""
    rows = []
    for delta in study.settings.deltas_of(other):
        pairing = pair(study, other, delta)
        ratio = f"{pairing.duration_ratio:.2f}" if np.isfinite(pairing.duration_ratio) else "-"
        counts = [f"{value}" for value in (pairing.n, pairing.only_ours, pairing.only_other)]
        difference = millimeters(pairing.clearance_difference_m)
        rows.append([f"delta = {delta:g}", *counts, f"p = {pairing.p_value:.2g}", difference, ratio])
    head = [f"ours and: {LABELS[other].lower()}", "both moved", "only ours touched", "only the other touched"]
    return [*head, "sign test", "its clearance minus ours (median)", "its duration / ours (median)"], rows


def speed_table(study: SafetyStudy) -> Table:
    """List violations and clearance of our method by reference speed."""
    rows = []
    for delta in study.settings.deltas:
        for one in by_speed(study, "ours", delta):
            if one.poses:
                high = f" to {1000 * one.to_mps:.0f}" if np.isfinite(one.to_mps) else " and more"
                counts = f"{one.poses}", f"{one.unsafe}", f"{one.touching}"
                row = [f"{1000 * one.from_mps:.0f}{high} mm/s", f"{delta:g}", *counts]
                rows.append([*row, millimeters(one.min_tool_m)])
    return ["reference speed", "delta", "poses", "beyond delta", "touching", "smallest clearance"], rows


def refusal_table(study: SafetyStudy) -> Table:
    """Count the refusals of each method by reason; no rows if there are none."""
    found = list(evaluate_all(study))
    reasons = sorted({reason for one in found for reason in one.refusals})
    rows = [
        [study.label(one.method), f"{one.delta:g}", f"{one.trials}", *(f"{one.refusals.get(r, 0)}" for r in reasons)]
        for one in found
    ]
    return ["method", "delta", "trials", *reasons], rows if reasons else []


def failure_table(study: SafetyStudy, films: Mapping[int, str]) -> Table:
    """List at most ``MAX_FAILURES`` failures: filmed ones first, then ours, then by number."""
    trials, rows = study.trials, []
    listed = sorted(map(int, failures(study)), key=lambda n: (n not in films, trials["method"][n] > 0, n))
    for number in listed[:MAX_FAILURES]:
        row = {name: column[number] for name, column in trials.items()}
        shown = f"[{number}]({films[number]})" if number in films else str(number)
        names = study.inputs.names[row["scene"]], study.label(METHODS[row["method"]]), f"{row['delta']:g}"
        poses = f"{row['unsafe_poses']} of {row['poses']}", f"{row['touching_poses']}", f"{row['contacts']}"
        distances = map(millimeters, (row["min_tool_m"], row["min_arm_m"]))
        rows.append([shown, *names, *poses, "yes" if row["stopped"] else "no", *distances])
    head = ["trial", "scene", "method", "delta", "poses beyond delta", "poses touching", "contacts", "stopped"]
    return [*head, "tool", "arm"], rows


def millimeters(length_m: float) -> str:
    """Format a length; a dash stands for NaN."""
    return f"{1000 * length_m:.1f} mm" if np.isfinite(length_m) else "-"


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %" if np.isfinite(value) else "-"


def _number(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"
