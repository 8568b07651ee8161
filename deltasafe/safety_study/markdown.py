"""The report of the safety study as Markdown."""

from collections.abc import Mapping, Sequence

import numpy as np

from deltasafe.safety_study.evidence import Rate, by_speed, cell, failures, pairing, step_of_pose_m
from deltasafe.safety_study.settings import CONTENDERS, LABELS, PARAMETRIC
from deltasafe.safety_study.study import SafetyStudy

__all__ = ["safety_study_markdown"]

MOST_LISTED = 60


def safety_study_markdown(study: SafetyStudy, films: Mapping[int, str]) -> str:
    """Tables with intervals, comparisons, failures (with the names of their films) and what the words mean."""
    parts = [
        "# Safety of executed motions",
        _opening(study),
        "## Was what was executed delta-safe?",
        "![Rates](rates.png)",
        _violations(study, "model"),
        "## Did anything touch the true hand?",
        _violations(study, "reality"),
        "![Clearances](clearances.png)",
        _clearances(study),
        *_comparisons(study),
        "## Refused",
        _refusals(study),
        "## Failures",
        _failures(study, films),
        "## What the figures mean",
        _meaning(study),
    ]
    return "\n\n".join(part for part in parts if part) + "\n"


def _comparisons(study: SafetyStudy) -> list[str]:
    parts, beside = [], study.settings.beside
    if "single_member" in beside:
        parts += ["## Does the ensemble protect where a single member misses parts of the hand?", _ensemble(study)]
    if "top_speed" in beside:
        parts += ["## What the velocity schedule buys", _pairs(study, "top_speed")]
    parts += ["## By speed", "![By speed](speed.png)", _speeds(study)]
    methods = [name for name in PARAMETRIC if name in beside]
    if methods:
        parts += ["## The compared methods in the same situations", _parametric_note(study)]
    return parts + [_pairs(study, name) for name in methods]


def _opening(study: SafetyStudy) -> str:
    executed, settings = int(study.executed.sum()), study.settings
    minutes = study.effort.minutes
    situations, scenes = (len(np.unique(study.trials[name])) for name in ("situation", "scene"))
    text = (
        f"**{executed} executed motions** in {situations} situations on {scenes} scenes "
        f"({len(study.executed)} trials, the others were refused): {study.simulated_s / 60:.0f} minutes of the arm's "
        f"time in {minutes:.1f} minutes"
    )
    text += f", {study.simulated_s / 60 / minutes:.1f} times as fast. " if minutes > 0 else ". "
    text += (
        "A situation is a scene, a picture of it (exposure, white balance, noise and compression drawn anew), start "
        "and goal on either side of the hand, an arm (friction, torque sensors) and a single member of the ensemble. "
        f"Ours meets all of them, the others one in {settings.beside_every}; all contenders meet the same."
    )
    least = study.inputs.smallest_supported_delta
    beyond = [f"{delta:g}" for delta in settings.deltas if least is None or delta < least]
    if beyond:
        text += (
            f"\n\nThe calibration of this ensemble supports no delta below {'any' if least is None else f'{least:g}'}: "
            f"the chain refuses to plan at {', '.join(beyond)}. Here it is done all the same, to see what happens."
        )
    return text


def _violations(study: SafetyStudy, kind: str) -> str:
    lines = [
        "| contender | delta | motions | with a violation | 95 % interval | upper 95 % | poses | upper 95 % of poses "
        "| upper 95 %, new scene |",
        "|---|---|---|---|---|---|---|---|---|",
    ]
    for name in study.settings.contenders:
        for delta in study.settings.deltas_of(name):
            found = cell(study, name, delta)
            rate: Rate = found.model if kind == "model" else found.reality
            if not rate.n:
                lines.append(f"| {_label(study, name)} | {delta:g} | 0 | - | - | - | - | - | - |")
                continue
            lines.append(
                f"| {_label(study, name)} | {delta:g} | {rate.n} | {rate.violated} | "
                f"{_percent(rate.interval[0])} to {_percent(rate.interval[1])} | {_percent(rate.upper95)} | "
                f"{_percent(rate.pose_rate)} | {_percent(rate.pose_upper95)} | "
                f"{_percent(rate.scenes_upper95)} ({rate.scenes_violated} of {rate.scenes}) |"
            )
    return "\n".join(lines)


def _clearances(study: SafetyStudy) -> str:
    lines = [
        "| contender | delta | tool: least | 5 % | median | arm: least | motions with a contact | stopped | duration "
        "| length |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    for name in study.settings.contenders:
        for delta in study.settings.deltas_of(name):
            found = cell(study, name, delta)
            lines.append(
                f"| {_label(study, name)} | {delta:g} | {_mm(found.min_tool_m)} | {_mm(found.quantiles_tool_m[0])} | "
                f"{_mm(found.quantiles_tool_m[1])} | {_mm(found.min_arm_m)} | {found.contacts} | {found.stopped} | "
                f"{_number(found.duration_s)} s | {_number(100 * found.length_m)} cm |"
            )
    return "\n".join(lines)


def _ensemble(study: SafetyStudy) -> str:
    lines = [
        "| delta | misses more of the hand than delta | worst miss | situations both moved in "
        "| only the single member touched | only the ensemble | sign test |",
        "|---|---|---|---|---|---|---|",
    ]
    for delta in study.settings.deltas:
        pair = pairing(study, "ours", "single_member", delta)
        single, whole = (study.of(name, delta) for name in ("single_member", "ours"))
        miss = study.trials["missed_share"]
        ours_there = whole & np.isin(study.trials["situation"], study.trials["situation"][single])
        count = f"{int((miss[single] > delta).sum())} single, {int((miss[ours_there] > delta).sum())} ensemble"
        worst = f"{_percent(miss[single].max(initial=0))} single, {_percent(miss[ours_there].max(initial=0))} ensemble"
        lines.append(
            f"| {delta:g} | {count} of {int(single.sum())} | {worst} | {pair.n} | {pair.only_second} "
            f"| {pair.only_first} | p = {pair.p_value:.2g} |"
        )
    note = (
        "*Missed* is what of the true hand's pixels the picture shows with p_occupied <= delta; a planner may drive "
        "there. The single member is drawn anew in each situation; its probability is as the network gives it."
    )
    return "\n".join(lines) + "\n\n" + note


def _pairs(study: SafetyStudy, other: str) -> str:
    lines = [
        f"| ours against: {LABELS[other].lower()} | both moved | only ours touched | only the other | sign test "
        "| its clearance less ours (median) | its duration by ours |",
        "|---|---|---|---|---|---|---|",
    ]
    for delta in study.settings.deltas_of(other):
        pair = pairing(study, "ours", other, delta)
        ratio = f"{pair.faster:.2f}" if np.isfinite(pair.faster) else "-"
        lines.append(
            f"| delta = {delta:g} | {pair.n} | {pair.only_first} | {pair.only_second} | p = {pair.p_value:.2g} "
            f"| {_mm(pair.shorter_m)} | {ratio} |"
        )
    return "\n".join(lines)


def _speeds(study: SafetyStudy) -> str:
    lines = [
        "| reference speed | delta | poses | beyond delta | touching | least clearance |",
        "|---|---|---|---|---|---|",
    ]
    for delta in study.settings.deltas:
        for one in by_speed(study, "ours", delta):
            if one.poses:
                high = f" to {1000 * one.to_mps:.0f}" if np.isfinite(one.to_mps) else " and more"
                lines.append(
                    f"| {1000 * one.from_mps:.0f}{high} mm/s | {delta:g} | {one.poses} | {one.unsafe} | {one.touching} "
                    f"| {_mm(one.min_tool_m)} |"
                )
    return "\n".join(lines)


def _parametric_note(study: SafetyStudy) -> str:
    return (
        f"They are told of at most {study.settings.n_obstacles} ellipsoids at Gaussian positions, fitted to the same "
        "picture of p_occupied by a fixed rule (`deltasafe/safety_study/obstacles.py`), and see the border of the view "
        "and the table as we do. The robot is the ball around the disc, several obstacles share delta by Boole, "
        "Kamel's bounding volume keeps 3 sigma whatever delta is, and is run once. They know no velocity schedule: the "
        "tracking error at top speed is part of the ball, and the motion is at top speed. What they are *not* told is "
        "where the picture suspects a hand without reaching 0.5: there they have no obstacle. That is a limit of such "
        "models, not of our fit. *Beyond delta* is about the ensemble's field, which these methods do not know."
    )


def _refusals(study: SafetyStudy) -> str:
    reasons = sorted(
        {r for n in study.settings.contenders for d in study.settings.deltas for r in cell(study, n, d).refusals}
    )
    if not reasons:
        return "None."
    lines = ["| contender | delta | trials | " + " | ".join(reasons) + " |", "|---|---|---|" + "---|" * len(reasons)]
    for name in study.settings.contenders:
        for delta in study.settings.deltas_of(name):
            found = cell(study, name, delta)
            counts = " | ".join(str(found.refusals.get(reason, 0)) for reason in reasons)
            lines.append(f"| {_label(study, name)} | {delta:g} | {found.trials} | {counts} |")
    return "\n".join(lines)


def _failures(study: SafetyStudy, films: Mapping[int, str]) -> str:
    numbers: Sequence[int] = [int(number) for number in failures(study)]
    if not numbers:
        return "None: of no executed motion was a pose beyond delta or in touch, and none was stopped."
    lines = [
        f"{len(numbers)} in all. Trial n is made again by `python -m pipelines.safety_study --film n` (same options).",
        "",
        "| trial | scene | contender | delta | poses beyond delta | poses touching | contacts | stopped | tool | arm |",
        "|---|---|---|---|---|---|---|---|---|---|",
    ]
    listed = sorted(numbers, key=lambda number: (number not in films, study.trials["contender"][number] > 0, number))
    for number in listed[:MOST_LISTED]:
        row = {name: column[number] for name, column in study.trials.items()}
        shown = f"[{number}]({films[number]})" if number in films else str(number)
        lines.append(
            f"| {shown} | {study.inputs.names[row['scene']]} | {_label(study, CONTENDERS[row['contender']])} "
            f"| {row['delta']:g} | {row['unsafe_poses']} of {row['poses']} | {row['touching_poses']} "
            f"| {row['contacts']} | {'yes' if row['stopped'] else 'no'} | {_mm(row['min_tool_m'])} "
            f"| {_mm(row['min_arm_m'])} |"
        )
    if len(numbers) > MOST_LISTED:
        lines.append(f"\n{len(numbers) - MOST_LISTED} more are in `trials.npz`.")
    lines += [f"\n![Trial {number}]({name})" for number, name in films.items()]
    return "\n".join(lines)


def _meaning(study: SafetyStudy) -> str:
    tracking = study.settings.motion.tracking
    return f"""\
* *Delta-safe* is pointwise: every point of the tool, at every instant, has P(occupied) <= delta. A *pose* counts as
  violating as soon as one point does, so that the rate of poses bounds that of points from above. It bounds neither the
  probability that the whole body collides nor that the whole motion does; *motions with a violation* is the joint rate.
* *Beyond delta* is the model's side: p_occupied > delta in the field used, at the measured pose. *Touching* is
  reality's: the tool meets the true hand's surface. Honest probabilities keep the second below delta for each point.
* Intervals of motions are exact (Clopper and Pearson), motions being independent draws of a situation on these scenes.
  The poses of a motion depend on each other: their rate is the mean over motions of the violating share, its bound
  Hoeffding's and Bentkus's, in which motions are the trials. *New scene* counts scenes: it holds for a scene like these
  that was not among them, and is as wide as their number makes it.
* *Upper 95 %* are one-sided bounds, intervals two-sided. Nothing is adjusted for the number of rows.
* Clearances and contacts include the way straight down onto the start and up from the goal, which is not planned. The
  arm's links count as well. The physics counts a contact 1 mm early, with hand or table.
* Poses are recorded at {study.settings.execution.record_rate_hz:g} Hz: at most {_mm(step_of_pose_m(study))} apart.
* gamma(v) = {1000 * tracking.gamma0_m:g} mm + {tracking.gamma1_s:g} s v, in planning, schedule and monitor.
* Rendered hands on rendered tables, one camera model, hands that hold still."""


def _label(study: SafetyStudy, name: str) -> str:
    return LABELS[name].format(members=study.inputs.n_members)


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %" if np.isfinite(value) else "-"


def _number(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"


def _mm(length_m: float) -> str:
    return f"{1000 * length_m:.1f} mm" if np.isfinite(length_m) else "-"
