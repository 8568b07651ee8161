"""The paper's own curves: the coordinates of Fig. 5 and Fig. 6 as printed."""

import functools
import pathlib
from typing import Any

from deltasafe.io.storage import read_json

__all__ = ["paper_curves"]


@functools.cache
def paper_curves() -> dict[str, Any]:
    """``cost[scene][method]`` with ``level`` (d-tilde = 2 sigma, units of 0.1 m) and ``normalized_cost``;
    ``time[method]`` with ``n_obstacles`` and ``seconds``.

    The paper measured our method's times once and drew them at both ends (decision 22).
    """
    curves: dict[str, Any] = read_json(pathlib.Path(__file__).with_name("paper_curves.json"))
    return curves
