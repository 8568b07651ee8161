"""Disturbances that neither the controller nor its model accounts for. For tests only, never in an evidence run."""

import dataclasses
import math
from typing import TypeAlias

from deltasafe.errors import SettingsError

__all__ = ["Disturbance", "Payload", "Push"]


@dataclasses.dataclass(frozen=True)
class Push:
    """A force on a link at its center of mass.

    Attributes:
        force_n: (3) in the world frame.
        start_s: from the start of the execution, the approach included.
        duration_s: of the push.
        link: 1 to 7 for the arm's links, 8 for the tool.
    """

    force_n: tuple[float, float, float]
    start_s: float
    duration_s: float
    link: int = 7

    def __post_init__(self) -> None:
        if len(self.force_n) != 3 or not all(math.isfinite(component) for component in self.force_n):
            raise SettingsError(f"force_n must hold three finite newtons, got {self.force_n}")
        if not (math.isfinite(self.start_s) and self.start_s >= 0):
            raise SettingsError(f"start_s must be finite and not negative, got {self.start_s}")
        if not (math.isfinite(self.duration_s) and self.duration_s > 0):
            raise SettingsError(f"duration_s must be positive, got {self.duration_s}")
        if not 1 <= self.link <= 8:
            raise SettingsError(f"link must be 1 to 7, or 8 for the tool, got {self.link}")


@dataclasses.dataclass(frozen=True)
class Payload:
    """A mass at the flange.

    Attributes:
        mass_kg: of a ball around the flange's center; the arm is rated for 14 kg.
    """

    mass_kg: float

    def __post_init__(self) -> None:
        if not 0 < self.mass_kg <= 14:
            raise SettingsError(f"mass_kg must lie in (0, 14], got {self.mass_kg}")


Disturbance: TypeAlias = Push | Payload
