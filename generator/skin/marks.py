"""What is drawn onto the skin adds up here before it becomes colour and relief."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

__all__ = ["Marks"]

Array = NDArray[np.float64]
DARKENING = np.array([0.75, 1.0, 1.05])
REDDENING = np.array([0.02, -0.22, -0.20])


@dataclasses.dataclass
class Marks:
    """Sums over all marks at V vertices.

    Attributes:
        darkness: (V,) share of light that a fold swallows.
        redness: (V,) strength of blood near the surface.
        relief_mm: (V,) height along the normal.
        tint: (V, 3) factor on the albedo.
    """

    darkness: Array
    redness: Array
    relief_mm: Array
    tint: Array

    @classmethod
    def none(cls, n_vertices: int) -> "Marks":
        """Unmarked skin."""
        return cls(np.zeros(n_vertices), np.zeros(n_vertices), np.zeros(n_vertices), np.ones((n_vertices, 3)))

    def add(self, strength: Array, darkness: float = 0.0, redness: float = 0.0, relief_mm: float = 0.0) -> None:
        """Add a mark of the given strength (V,)."""
        self.darkness += darkness * strength
        self.redness += redness * strength
        self.relief_mm += relief_mm * strength

    def absorb(self, strength: Array, rgb: tuple[float, float, float]) -> None:
        """Take away a share of each colour where the mark is."""
        self.tint *= 1 - strength[:, None] * np.array(rgb)

    def applied(self, albedo: Array, redness: float) -> Array:
        """Albedo (V, 3) with all marks; ``redness`` is the person's."""
        reddened = 1 + redness * self.redness[:, None] * REDDENING
        return np.asarray(albedo * self.tint * reddened * (1 - np.clip(self.darkness, 0, 0.6)[:, None] * DARKENING))
