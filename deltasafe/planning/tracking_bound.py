"""gamma(v), the bound on the tracking error at reference speed v (assumption 1 of the paper)."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from deltasafe.setting_ranges import check_range


@dataclasses.dataclass(frozen=True)
class TrackingBound:
    """gamma(v) = gamma0 + gamma1 * v in meters of workspace error, with the factor eta applied (gamma tilde).

    The default is the line of section V-C of the paper, v / 0.2 m/s * 0.01 m.
    """

    gamma0_m: float = 0.0
    gamma1_s: float = 0.05

    def __post_init__(self) -> None:
        check_range(self, "[0, inf)", *dataclasses.asdict(self))

    def error_m(self, speed_mps: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return gamma(v), the largest workspace error in meters, at each speed in m/s."""
        return np.asarray(self.gamma0_m + self.gamma1_s * np.asarray(speed_mps, dtype=np.float64))

    def speed_mps(self, error_m: NDArray[np.float64] | float) -> NDArray[np.float64]:
        """Return the largest speed in m/s with gamma(v) <= ``error_m``; 0 where gamma(0) is larger already."""
        if self.gamma1_s == 0.0:
            return np.where(np.asarray(error_m) >= self.gamma0_m, np.inf, 0.0)
        return np.asarray(np.maximum(np.asarray(error_m, dtype=np.float64) - self.gamma0_m, 0.0) / self.gamma1_s)


def tracking_of(settings: object, tracking: TrackingBound | None) -> TrackingBound:
    """Return ``tracking`` if given, else the bound of the settings, else the line of the paper.

    ``MotionSettings`` has a bound; the settings of a search or of a schedule alone have none.
    """
    if tracking is not None:
        return tracking
    of_settings = getattr(settings, "tracking", None)
    return of_settings if isinstance(of_settings, TrackingBound) else TrackingBound()
