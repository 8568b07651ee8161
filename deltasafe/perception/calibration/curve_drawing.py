"""Drawing that the figures of a calibration report share: colors, reliability curves, pixels per bin."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter
from numpy.typing import NDArray

from deltasafe.perception.calibration.reliability import ReliabilityCurve

BLUE = "#0072B2"
RED = "#C8102E"
ORANGE = "#E69F00"
GRAY = "#8a8a8a"


def size_color(n_members: int) -> str:
    """Return the color of an ensemble size: those of M = 2, 5, 10 in Fig. 4 of the paper, blue for other sizes."""
    return {2: RED, 5: "#009E73"}.get(n_members, BLUE)


def observed(curve: ReliabilityCurve) -> list[float]:
    """Return the observed frequencies of the bins that have pixels."""
    return [value for value in curve.observed if value is not None]


def draw_curve(axes: Axes, curve: ReliabilityCurve, *format_string: str, **style: Any) -> None:
    """Draw observed over predicted probability."""
    axes.plot(_filled(curve.predicted), observed(curve), *format_string, **style)


def draw_band(axes: Axes, curve: ReliabilityCurve, color: str) -> None:
    """Shade the interval of the observed frequency."""
    axes.fill_between(_filled(curve.predicted), _filled(curve.low), _filled(curve.high), color=color, alpha=0.15, lw=0)


def draw_pixel_fractions(
    axes: Axes, edges: NDArray[np.float64], counts: Sequence[Sequence[int]], colors: Sequence[str]
) -> None:
    """Draw the fraction of all pixels in each bin as bars, logarithmic, one bar for each entry of ``counts``."""
    fractions = np.array([np.array(count) / sum(count) for count in counts])
    width = np.diff(edges) * (0.84 / len(counts) if len(counts) > 1 else 1.0)
    left = edges[:-1] + (np.diff(edges) - len(counts) * width) / 2
    for index, (fraction, color) in enumerate(zip(fractions, colors, strict=True)):
        axes.bar(left + index * width, fraction, width=width, align="edge", color=color, edgecolor="white", lw=0.6)
    axes.set(yscale="log", ylabel="Pixels")
    axes.set_ylim(10.0 ** np.floor(np.log10(fractions[fractions > 0].min())) / 2, 2)
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{100 * value:g}%"))
    axes.tick_params(axis="y", labelsize=8)


def _filled(values: Sequence[float | None]) -> list[float]:
    return [value for value in values if value is not None]
