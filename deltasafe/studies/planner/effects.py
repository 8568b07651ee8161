"""Which of the paper's effects hold here, said plainly and judged by numbers."""

import dataclasses
from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtri

from deltasafe.studies.planner.cost_comparison import SCENES, Comparison
from deltasafe.studies.planner.methods import MAIN
from deltasafe.studies.planner.paper_curves import paper_curves
from deltasafe.studies.planner.timing import TIMED, Timing

__all__ = ["Effect", "effects_of_cost", "effects_of_time"]

Array = NDArray[np.float64]
SIGNIFICANT = 2.0
"""Standard errors that a difference of means must exceed to count."""


@dataclasses.dataclass(frozen=True)
class Effect:
    """One statement of the paper.

    Attributes:
        name: short, for figures in JSON.
        claim: what the paper says or shows.
        holds: whether it does here.
        evidence: the numbers on which that rests.
    """

    name: str
    claim: str
    holds: bool
    evidence: str


def effects_of_cost(found: Comparison) -> list[Effect]:
    """The statements about Fig. 5."""
    return [
        *_ours_is_cheapest(found),
        _ours_and_chance_constraint_alike(found),
        _others_deteriorate_faster(found),
        _advantage_grows_with_clutter(found),
        _risk_accumulates(found),
        _max_probability_is_worst(found),
        _chance_constraint_above_bounding_volume(found),
    ]


def effects_of_time(found: Timing) -> list[Effect]:
    """The statements about Fig. 6."""
    return [*_others_grow(found), _order_of_slopes(found), *_ours_is_flat(found), *_crossings(found), _samples(found)]


def _ends(found: Comparison, scene: str, name: str) -> tuple[float, float, float, float]:
    """Normalized cost at no and at the largest uncertainty, each with its standard error; without a path infinite."""
    mean, error = found.normalized_cost(scene, name)
    mean, error = np.where(np.isnan(mean), np.inf, mean), np.nan_to_num(error)
    return float(mean[0]), float(error[0]), float(mean[-1]), float(error[-1])


def _paper(scene: str, name: str) -> Array:
    return np.array(paper_curves()["cost"][scene][name]["normalized_cost"])


def _listed(values: dict[str, float], form: str = "{:.3f}") -> str:
    return ", ".join(
        f"{name.replace('_', ' ')} {form.format(value) if np.isfinite(value) else 'without a path'}"
        for name, value in values.items()
    )


def _percent(values: dict[str, float]) -> str:
    return _listed({name: 100 * value for name, value in values.items()}, "{:.1f}")


def _ours_is_cheapest(found: Comparison) -> Iterator[Effect]:
    for scene in SCENES:
        last = {name: _ends(found, scene, name)[2:] for name in MAIN}
        mean, error = last["ours"]
        holds = all(mean + SIGNIFICANT * np.hypot(error, last[name][1]) < last[name][0] for name in MAIN[1:])
        means = {name: value[0] for name, value in last.items()}
        yield Effect(
            f"ours_cheapest_{scene}",
            f"At the largest uncertainty our method has the lowest cost ({scene} scene).",
            holds,
            f"here {_listed(means)}; paper {_listed({name: _paper(scene, name)[-1] for name in MAIN})}",
        )


def _ours_and_chance_constraint_alike(found: Comparison) -> Effect:
    ours, theirs = (found.normalized_cost("simple", name)[0] for name in ("ours", "chance_constraint"))
    apart = float(np.nanmax(np.abs(theirs - ours)))
    risen = float(np.nanmax(np.abs((theirs - theirs[0]) - (ours - ours[0]))))
    paper = float(np.abs(_paper("simple", "chance_constraint") - _paper("simple", "ours")).max())
    return Effect(
        "alike_in_simple_scene",
        "In the simple scene our method and the chance constraint are almost identical.",
        apart <= 1.5 * paper,
        f"at most {apart:.3f} apart (paper {paper:.3f}); {risen:.3f} once the difference at no uncertainty, "
        f"{theirs[0] - ours[0]:+.3f}, is taken off",
    )


def _rise(found: Comparison, scene: str, name: str) -> tuple[float, float]:
    first, first_error, last, last_error = _ends(found, scene, name)
    return last / first - 1, float(np.hypot(last_error, first_error) / first)


def _others_deteriorate_faster(found: Comparison) -> Effect:
    rises = {name: _rise(found, "cluttered", name) for name in MAIN}
    ours, error = rises["ours"]
    holds = all(rise > ours + SIGNIFICANT * np.hypot(error, theirs) for rise, theirs in list(rises.values())[1:])
    paper = {name: float(_paper("cluttered", name)[-1] / _paper("cluttered", name)[0] - 1) for name in MAIN}
    here = {name: rise for name, (rise, _) in rises.items()}
    return Effect(
        "others_deteriorate_faster",
        "In the cluttered scene the cost of the existing methods rises faster with the uncertainty.",
        holds,
        f"rise from none to the largest uncertainty in %: here {_percent(here)}; paper {_percent(paper)}",
    )


def _advantage_grows_with_clutter(found: Comparison) -> Effect:
    gap, paper = {}, {}
    for scene in SCENES:
        ours, _, last, _ = _ends(found, scene, "ours")
        best = min(MAIN[1:], key=lambda name: _ends(found, scene, name)[2])
        first, _, best_last, _ = _ends(found, scene, best)
        gap[scene] = (best_last - first) / first - (last - ours) / ours
        rest = min(MAIN[1:], key=lambda name: _paper(scene, name)[-1])
        paper[scene] = (
            _paper(scene, rest)[-1] / _paper(scene, rest)[0] - _paper(scene, "ours")[-1] / _paper(scene, "ours")[0]
        )
    return Effect(
        "advantage_grows_with_clutter",
        "The advantage over the best of the others is greater in the cluttered scene.",
        gap["cluttered"] > max(gap["simple"], 0.0),
        f"rise of the best other minus rise of ours, in %: here {_percent(gap)}; paper {_percent(paper)}",
    )


def _risk_accumulates(found: Comparison) -> Effect:
    split, each, exact, equal = (
        _rise(found, "cluttered", name)
        for name in ("chance_constraint", "chance_constraint_each", "exact", "equal_margin")
    )
    ours = _rise(found, "cluttered", "ours")
    holds = each[0] > ours[0] + SIGNIFICANT * np.hypot(each[1], ours[1])
    return Effect(
        "conservatism_accumulates_without_boole",
        "The others lose because the conservatism of the single obstacles accumulates: also without Boole's split.",
        bool(holds),
        f"rise in the cluttered scene in %: ours {100 * ours[0]:.1f}, chance constraint {100 * split[0]:.1f} with "
        f"the split and {100 * each[0]:.1f} without, exact Gaussian {100 * exact[0]:.1f}, any Gaussian method at the "
        f"margin of ours {100 * equal[0]:.1f} (standard errors about {100 * max(each[1], ours[1]):.1f})",
    )


def _max_probability_is_worst(found: Comparison) -> Effect:
    last = {scene: {name: _ends(found, scene, name)[2] for name in MAIN} for scene in SCENES}
    return Effect(
        "max_probability_worst",
        "The maximum-probability approximation is the most conservative.",
        all(max(costs, key=costs.__getitem__) == "max_probability" for costs in last.values()),
        "; ".join(f"{scene}: {_listed(costs)}" for scene, costs in last.items()),
    )


def _chance_constraint_above_bounding_volume(found: Comparison) -> Effect:
    chance, volume = (_ends(found, "cluttered", name)[2] for name in ("chance_constraint", "bounding_volume"))
    return Effect(
        "chance_constraint_above_bounding_volume",
        "In the cluttered scene, at the largest uncertainty, the chance constraint costs more than bounding volumes.",
        chance > volume,
        f"here {chance:.3f} and {volume:.3f}, paper {_paper('cluttered', 'chance_constraint')[-1]:.3f} and "
        f"{_paper('cluttered', 'bounding_volume')[-1]:.3f}: even split over eight obstacles delta asks for "
        f"{-ndtri(found.settings.delta / 8):.2f} sigma beyond a sphere, the bounding volume for 3",
    )


def _ratio(found: Timing, name: str) -> float:
    median = found.median_s(name)
    return float(median[-1] / median[0])


def _others_grow(found: Timing) -> Iterator[Effect]:
    first, last = found.settings.counts[0], found.settings.counts[-1]
    for suffix, way, expected in (("", "asked for every obstacle at every pose", True), ("_culled", "culled", False)):
        names = [name + suffix for name in ("chance_constraint", "bounding_volume", "max_probability")]
        ratios = {name.removesuffix("_culled"): _ratio(found, name) for name in names}
        claim = f"The parametric methods take longer the more obstacles there are ({way})."
        if not expected:
            claim = "The same with far obstacles culled, which changes no answer."
        yield Effect(
            f"parametric_grow{suffix}",
            claim,
            min(ratios.values()) > 1.2,
            f"time at {last} over time at {first}: {_listed(ratios, '{:.2f}')}",
        )


def _slope(found: Timing, name: str) -> float:
    """Milliseconds an obstacle up to ten, where the paper shows all methods."""
    counts = np.array(found.settings.counts)
    few = counts <= max(10, counts[1])
    return 1000 * float(np.polyfit(counts[few], found.median_s(name)[few], 1)[0])


def _order_of_slopes(found: Timing) -> Effect:
    names = ("max_probability_numeric", "chance_constraint", "bounding_volume")
    slopes = [_slope(found, name) for name in names]
    curves: dict[str, Any] = paper_curves()["time"]
    paper = [
        float(np.polyfit(curves[name]["n_obstacles"][:10], curves[name]["seconds"][:10], 1)[0])
        for name in ("max_probability", "chance_constraint", "bounding_volume")
    ]
    return Effect(
        "order_of_slopes",
        "An obstacle costs the maximum-probability method most, then the chance constraint, then the bounding volume.",
        slopes[0] > slopes[1] > slopes[2],
        f"here {slopes[0]:.2f}, {slopes[1]:.2f} and {slopes[2]:.2f} ms an obstacle with a numeric search "
        f"({_slope(found, 'max_probability'):.2f} ms in closed form), paper {paper[0]:.0f}, {paper[1]:.2f} and "
        f"{paper[2]:.2f} s",
    )


def _ours_is_flat(found: Timing) -> Iterator[Effect]:
    for name, what in (("ours", "N_x = 100"), ("ours_few", "N_x = 20"), ("ours_continuous", "continuous")):
        ratio = _ratio(found, name)
        yield Effect(
            f"flat_{name}",
            f"The time of our method does not depend on the number of obstacles ({what}).",
            ratio <= 1.2,
            f"time at {found.settings.counts[-1]} over time at {found.settings.counts[0]}: {ratio:.2f}; the field, "
            f"built once, takes {1000 * found.field_s[0]:.0f} to {1000 * found.field_s[-1]:.0f} ms more",
        )


def _crossings(found: Timing) -> Iterator[Effect]:
    ours = found.median_s("ours")
    printed = {"chance_constraint": "9", "bounding_volume": "35", "max_probability_numeric": "1"}
    for name in TIMED[3:]:
        slower = found.median_s(name) > ours
        settled = np.flatnonzero(~slower)
        place = 0 if not len(settled) else int(settled[-1]) + 1
        crossed = place < len(slower)
        evidence = f"from {found.settings.counts[place]} obstacles on" if crossed else "at no number of obstacles"
        label = name.replace("_", " ")
        yield Effect(
            f"slower_than_ours_{name}",
            f"With enough obstacles our method (N_x = 100) is faster than: {label}.",
            bool(crossed),
            f"{evidence} (paper: from {printed[name]} on)" if name in printed else evidence,
        )


def _samples(found: Timing) -> Effect:
    ratio = float(np.median(found.median_s("ours") / found.median_s("ours_few")))
    curves = paper_curves()["time"]
    paper = curves["ours_100"]["seconds"][0] / curves["ours_20"]["seconds"][0]
    return Effect(
        "time_depends_on_samples",
        "The time of our method depends on the number of samples.",
        ratio > 1.2,
        f"N_x = 100 takes {ratio:.2f} times as long as N_x = 20 (paper {paper:.2f}): poses far from everything are "
        "settled without looking at samples",
    )
