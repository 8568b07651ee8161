"""The report of the safety study as Markdown."""

from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from deltasafe.reporting.markdown import table
from deltasafe.studies.safety.evidence import Cell, Rate, by_speed, cell, failures, pairing, step_of_pose_m
from deltasafe.studies.safety.settings import CONTENDERS, LABELS, PARAMETRIC
from deltasafe.studies.safety.study import SafetyStudy

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
    rows = []
    for name, delta, found in _cells(study):
        rate: Rate = found.model if kind == "model" else found.reality
        if not rate.n:
            rows.append([study.label(name), f"{delta:g}", "0", *["-"] * 6])
            continue
        rows.append(
            [
                *(study.label(name), f"{delta:g}", f"{rate.n}", f"{rate.violated}"),
                f"{_percent(rate.interval[0])} to {_percent(rate.interval[1])}",
                *(_percent(rate.upper95), _percent(rate.pose_rate), _percent(rate.pose_upper95)),
                f"{_percent(rate.scenes_upper95)} ({rate.scenes_violated} of {rate.scenes})",
            ]
        )
    head = "contender", "delta", "motions", "with a violation", "95 % interval", "upper 95 %", "poses"
    return table([*head, "upper 95 % of poses", "upper 95 %, new scene"], rows)


def _clearances(study: SafetyStudy) -> str:
    rows = [
        [
            *(study.label(name), f"{delta:g}", _mm(found.min_tool_m), *map(_mm, found.quantiles_tool_m[:2])),
            *(_mm(found.min_arm_m), f"{found.contacts}", f"{found.stopped}"),
            *(f"{_number(found.duration_s)} s", f"{_number(100 * found.length_m)} cm"),
        ]
        for name, delta, found in _cells(study)
    ]
    head = "contender", "delta", "tool: least", "5 %", "median", "arm: least", "motions with a contact", "stopped"
    return table([*head, "duration", "length"], rows)


def _cells(study: SafetyStudy) -> Iterator[tuple[str, float, Cell]]:
    """Every contender at each of its levels."""
    for name in study.settings.contenders:
        for delta in study.settings.deltas_of(name):
            yield name, delta, cell(study, name, delta)


def _ensemble(study: SafetyStudy) -> str:
    head = "delta", "misses more of the hand than delta", "worst miss", "situations both moved in"
    rows = []
    for delta in study.settings.deltas:
        pair = pairing(study, "ours", "single_member", delta)
        single, whole = (study.of(name, delta) for name in ("single_member", "ours"))
        miss = study.trials["missed_share"]
        ours_there = whole & np.isin(study.trials["situation"], study.trials["situation"][single])
        count = f"{int((miss[single] > delta).sum())} single, {int((miss[ours_there] > delta).sum())} ensemble"
        worst = f"{_percent(miss[single].max(initial=0))} single, {_percent(miss[ours_there].max(initial=0))} ensemble"
        touched = f"{pair.n}", f"{pair.only_second}", f"{pair.only_first}", f"p = {pair.p_value:.2g}"
        rows.append([f"{delta:g}", f"{count} of {int(single.sum())}", worst, *touched])
    note = (
        "*Missed* is what of the true hand's pixels the picture shows with p_occupied <= delta; a planner may drive "
        "there. The single member is drawn anew in each situation; its probability is as the network gives it."
    )
    return table([*head, "only the single member touched", "only the ensemble", "sign test"], rows) + "\n\n" + note


def _pairs(study: SafetyStudy, other: str) -> str:
    head = f"ours against: {LABELS[other].lower()}", "both moved", "only ours touched", "only the other", "sign test"
    rows = []
    for delta in study.settings.deltas_of(other):
        pair = pairing(study, "ours", other, delta)
        ratio = f"{pair.faster:.2f}" if np.isfinite(pair.faster) else "-"
        touched = f"{pair.n}", f"{pair.only_first}", f"{pair.only_second}", f"p = {pair.p_value:.2g}"
        rows.append([f"delta = {delta:g}", *touched, _mm(pair.shorter_m), ratio])
    return table([*head, "its clearance less ours (median)", "its duration by ours"], rows)


def _speeds(study: SafetyStudy) -> str:
    rows = []
    for delta in study.settings.deltas:
        for one in by_speed(study, "ours", delta):
            if one.poses:
                high = f" to {1000 * one.to_mps:.0f}" if np.isfinite(one.to_mps) else " and more"
                counts = f"{one.poses}", f"{one.unsafe}", f"{one.touching}"
                rows.append([f"{1000 * one.from_mps:.0f}{high} mm/s", f"{delta:g}", *counts, _mm(one.min_tool_m)])
    return table(["reference speed", "delta", "poses", "beyond delta", "touching", "least clearance"], rows)


def _parametric_note(study: SafetyStudy) -> str:
    return (
        f"They are told of at most {study.settings.n_obstacles} ellipsoids at Gaussian positions, fitted to the same "
        "picture of p_occupied by a fixed rule (`deltasafe/studies/safety/obstacle_fit.py`), and see the border of the view "
        "and the table as we do. The robot is the ball around the disc, several obstacles share delta by Boole, "
        "Kamel's bounding volume keeps 3 sigma whatever delta is, and is run once. They know no velocity schedule: the "
        "tracking error at top speed is part of the ball, and the motion is at top speed. What they are *not* told is "
        "where the picture suspects a hand without reaching 0.5: there they have no obstacle. That is a limit of such "
        "models, not of our fit. *Beyond delta* is about the ensemble's field, which these methods do not know."
    )


def _refusals(study: SafetyStudy) -> str:
    reasons = sorted({reason for _, _, found in _cells(study) for reason in found.refusals})
    if not reasons:
        return "None."
    rows = []
    for name, delta, found in _cells(study):
        counts = [f"{found.refusals.get(reason, 0)}" for reason in reasons]
        rows.append([study.label(name), f"{delta:g}", f"{found.trials}", *counts])
    return table(["contender", "delta", "trials", *reasons], rows)


def _failures(study: SafetyStudy, films: Mapping[int, str]) -> str:
    numbers: Sequence[int] = [int(number) for number in failures(study)]
    if not numbers:
        return "None: of no executed motion was a pose beyond delta or in touch, and none was stopped."
    listed = sorted(numbers, key=lambda number: (number not in films, study.trials["contender"][number] > 0, number))
    rows = []
    for number in listed[:MOST_LISTED]:
        row = {name: column[number] for name, column in study.trials.items()}
        shown = f"[{number}]({films[number]})" if number in films else str(number)
        who = study.inputs.names[row["scene"]], study.label(CONTENDERS[row["contender"]]), f"{row['delta']:g}"
        poses = f"{row['unsafe_poses']} of {row['poses']}", f"{row['touching_poses']}", f"{row['contacts']}"
        stopped = "yes" if row["stopped"] else "no"
        rows.append([shown, *who, *poses, stopped, _mm(row["min_tool_m"]), _mm(row["min_arm_m"])])
    head = "trial", "scene", "contender", "delta", "poses beyond delta", "poses touching", "contacts", "stopped"
    lines = [
        f"{len(numbers)} in all. Trial n is made again by `python -m pipelines.commands.safety_study --film n` (same options).",
        "",
        table([*head, "tool", "arm"], rows),
    ]
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


def _percent(value: float) -> str:
    return f"{100 * value:.2f} %" if np.isfinite(value) else "-"


def _number(value: float) -> str:
    return f"{value:.1f}" if np.isfinite(value) else "-"


def _mm(length_m: float) -> str:
    return f"{1000 * length_m:.1f} mm" if np.isfinite(length_m) else "-"
