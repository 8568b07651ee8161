"""The paper's statements about Fig. 5 and Fig. 6, each tested on the results of this study.

The template ``effects.md.j2`` holds the wording of each statement and of its evidence.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from deltasafe.studies.planner.cost_comparison import SCENES, Comparison
from deltasafe.studies.planner.methods import MAIN
from deltasafe.studies.planner.paper_curves import paper_curves
from deltasafe.studies.planner.timing import TIMED, Timing

Array = NDArray[np.float64]
SIGNIFICANT = 2.0
"""A difference of means counts if it exceeds this many standard errors."""

FLAT = 1.2
"""Times count as constant if the last is at most this multiple of the first."""

OTHERS = TIMED[3:]
"""Timed methods that are not ours."""


@dataclasses.dataclass(frozen=True)
class Effect:
    """One statement of the paper.

    Attributes:
        holds: whether it holds in this study.
        evidence: values that decide it, by name.
    """

    holds: bool
    evidence: dict[str, Any]


def effects_of_cost(found: Comparison) -> dict[str, Effect]:
    """Test the statements about Fig. 5; return the effects by name."""
    return {
        **{f"ours_cheapest_{scene}": _ours_is_cheapest(found, scene) for scene in SCENES},
        "alike_in_simple_scene": _ours_and_chance_constraint_alike(found),
        "others_deteriorate_faster": _others_deteriorate_faster(found),
        "advantage_grows_with_clutter": _advantage_grows_with_clutter(found),
        "conservatism_accumulates_without_boole": _conservatism_accumulates(found),
        "max_probability_worst": _max_probability_is_worst(found),
        "chance_constraint_above_bounding_volume": _chance_constraint_above_bounding_volume(found),
    }


def effects_of_time(found: Timing) -> dict[str, Effect]:
    """Test the statements about Fig. 6; return the effects by name."""
    return {
        "parametric_grow": _others_grow(found),
        "parametric_grow_culled": _others_grow(found, "_culled"),
        "order_of_slopes": _order_of_slopes(found),
        **{f"flat_{name}": _ours_is_flat(found, name) for name in ("ours", "ours_few", "ours_continuous")},
        **{f"slower_than_ours_{name}": _slower_than_ours(found, name) for name in OTHERS},
        "time_depends_on_samples": _depends_on_samples(found),
    }


def _ends(found: Comparison, scene: str, name: str) -> tuple[float, float, float, float]:
    """Normalized cost at no and at the largest uncertainty, each with its standard error; infinite without a path."""
    mean, error = found.normalized_cost(scene, name)
    mean, error = np.where(np.isnan(mean), np.inf, mean), np.nan_to_num(error)
    return float(mean[0]), float(error[0]), float(mean[-1]), float(error[-1])


def _rise(found: Comparison, name: str, scene: str = "cluttered") -> tuple[float, float]:
    """Relative rise of the cost from no to the largest uncertainty, and its standard error."""
    first, first_error, last, last_error = _ends(found, scene, name)
    return last / first - 1, float(np.hypot(last_error, first_error) / first)


def _exceeds(larger: tuple[float, float], smaller: tuple[float, float]) -> bool:
    """Whether one mean exceeds another one significantly; both with their standard errors."""
    return bool(larger[0] > smaller[0] + SIGNIFICANT * np.hypot(larger[1], smaller[1]))


def _paper(scene: str, name: str) -> Array:
    return np.array(paper_curves()["cost"][scene][name]["normalized_cost"])


def _paper_rise(scene: str, name: str) -> float:
    curve = _paper(scene, name)
    return float(curve[-1] / curve[0] - 1)


def _ours_is_cheapest(found: Comparison, scene: str) -> Effect:
    last = {name: _ends(found, scene, name)[2:] for name in MAIN}
    return Effect(
        all(_exceeds(last[name], last["ours"]) for name in MAIN[1:]),
        {
            "here": {name: mean for name, (mean, _) in last.items()},
            "paper": {name: _paper(scene, name)[-1] for name in MAIN},
        },
    )


def _ours_and_chance_constraint_alike(found: Comparison) -> Effect:
    ours, theirs = (found.normalized_cost("simple", name)[0] for name in ("ours", "chance_constraint"))
    apart = float(np.nanmax(np.abs(theirs - ours)))
    paper = float(np.abs(_paper("simple", "chance_constraint") - _paper("simple", "ours")).max())
    return Effect(
        apart <= 1.5 * paper,
        {
            "apart": apart,
            "paper": paper,
            "offset": float(theirs[0] - ours[0]),
            "apart_without_offset": float(np.nanmax(np.abs((theirs - theirs[0]) - (ours - ours[0])))),
        },
    )


def _others_deteriorate_faster(found: Comparison) -> Effect:
    rises = {name: _rise(found, name) for name in MAIN}
    return Effect(
        all(_exceeds(rises[name], rises["ours"]) for name in MAIN[1:]),
        {
            "here": {name: rise for name, (rise, _) in rises.items()},
            "paper": {name: _paper_rise("cluttered", name) for name in MAIN},
        },
    )


def _advantage_grows_with_clutter(found: Comparison) -> Effect:
    here, paper = {}, {}
    for scene in SCENES:
        best = min(MAIN[1:], key=lambda name: _ends(found, scene, name)[2])
        here[scene] = _rise(found, best, scene)[0] - _rise(found, "ours", scene)[0]
        best = min(MAIN[1:], key=lambda name: _paper(scene, name)[-1])
        paper[scene] = _paper_rise(scene, best) - _paper_rise(scene, "ours")
    return Effect(here["cluttered"] > max(here["simple"], 0.0), {"here": here, "paper": paper})


def _conservatism_accumulates(found: Comparison) -> Effect:
    names = ("ours", "chance_constraint", "chance_constraint_each", "exact", "equal_margin")
    rises = {name: _rise(found, name) for name in names}
    each, ours = rises["chance_constraint_each"], rises["ours"]
    evidence = {"rise": {name: rise for name, (rise, _) in rises.items()}, "error": max(each[1], ours[1])}
    return Effect(_exceeds(each, ours), evidence)


def _max_probability_is_worst(found: Comparison) -> Effect:
    last = {scene: {name: _ends(found, scene, name)[2] for name in MAIN} for scene in SCENES}
    return Effect(all(max(costs, key=costs.__getitem__) == "max_probability" for costs in last.values()), last)


def _chance_constraint_above_bounding_volume(found: Comparison) -> Effect:
    names = ("chance_constraint", "bounding_volume")
    here = {name: _ends(found, "cluttered", name)[2] for name in names}
    return Effect(
        here["chance_constraint"] > here["bounding_volume"],
        {
            "here": here,
            "paper": {name: _paper("cluttered", name)[-1] for name in names},
            "sigmas": -float(ndtri(found.settings.delta / 8)),
        },
    )


def _ratio(found: Timing, name: str) -> float:
    """Time with the most obstacles over the time with the fewest."""
    median = found.median_s(name)
    return float(median[-1] / median[0])


def _others_grow(found: Timing, suffix: str = "") -> Effect:
    ratios = {name: _ratio(found, name + suffix) for name in MAIN[1:]}
    return Effect(min(ratios.values()) > FLAT, {"ratios": ratios})


def _slope_ms(found: Timing, name: str) -> float:
    """Milliseconds per obstacle up to ten obstacles, the range in which the paper shows all methods."""
    counts = np.array(found.settings.counts)
    few = counts <= max(10, counts[1])
    return 1000 * float(np.polyfit(counts[few], found.median_s(name)[few], 1)[0])


def _order_of_slopes(found: Timing) -> Effect:
    names = ("max_probability_numeric", "chance_constraint", "bounding_volume")
    here = [_slope_ms(found, name) for name in names]
    curves = [paper_curves()["time"][name.removesuffix("_numeric")] for name in names]
    paper = [float(np.polyfit(curve["n_obstacles"][:10], curve["seconds"][:10], 1)[0]) for curve in curves]
    closed_form = _slope_ms(found, "max_probability")
    return Effect(here[0] > here[1] > here[2], {"here": here, "paper": paper, "closed_form": closed_form})


def _ours_is_flat(found: Timing, name: str) -> Effect:
    ratio = _ratio(found, name)
    return Effect(ratio <= FLAT, {"ratio": ratio})


def _slower_than_ours(found: Timing, name: str) -> Effect:
    """Find the smallest number of obstacles from which on the method is always slower than ours."""
    faster = np.flatnonzero(found.median_s(name) <= found.median_s("ours"))
    first = int(faster[-1]) + 1 if len(faster) else 0
    slower = first < len(found.settings.counts)
    return Effect(slower, {"n_obstacles": found.settings.counts[first] if slower else None})


def _depends_on_samples(found: Timing) -> Effect:
    ratio = float(np.median(found.median_s("ours") / found.median_s("ours_few")))
    curves = paper_curves()["time"]
    paper = curves["ours_100"]["seconds"][0] / curves["ours_20"]["seconds"][0]
    return Effect(ratio > FLAT, {"here": ratio, "paper": paper})
