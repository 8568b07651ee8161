"""The paper's curves: coordinates of Fig. 5 and Fig. 6 as printed."""

import functools
import pathlib
from typing import Any

from deltasafe.io.storage import read_json


@functools.cache
def paper_curves() -> dict[str, Any]:
    """Read the curves: ``cost[scene][method]`` and ``time[method]``.

    Cost curves have ``level`` (d-tilde = 2 sigma, units of 0.1 m) and ``normalized_cost``; time curves have
    ``n_obstacles`` and ``seconds``. The paper measured the times of its method once and drew them at both ends
    (decision 22).
    """
    curves: dict[str, Any] = read_json(pathlib.Path(__file__).with_name("paper_curves.json"))
    return curves
