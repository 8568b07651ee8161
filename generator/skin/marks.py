"""Accumulators of all marks on the skin; they are converted to albedo and relief at the end."""

import dataclasses

import numpy as np

from generator.aliases import Array

DARKENING_RGB = np.array([0.75, 1.0, 1.05])
REDDENING_RGB = np.array([0.02, -0.22, -0.20])


@dataclasses.dataclass
class Marks:
    """Sums over all marks at V vertices.

    Attributes:
        darkness: (V,) fraction of light that folds absorb.
        redness: (V,) amount of blood near the surface.
        relief_mm: (V,) height along the normal.
        albedo_factor: (V, 3) factor on the albedo.
    """

    darkness: Array
    redness: Array
    relief_mm: Array
    albedo_factor: Array

    @classmethod
    def none(cls, n_vertices: int) -> "Marks":
        """Return the accumulators of unmarked skin."""
        return cls(np.zeros(n_vertices), np.zeros(n_vertices), np.zeros(n_vertices), np.ones((n_vertices, 3)))

    def add(self, strength: Array, darkness: float = 0.0, redness: float = 0.0, relief_mm: float = 0.0) -> None:
        """Add a mark of the given strength (V,)."""
        self.darkness += darkness * strength
        self.redness += redness * strength
        self.relief_mm += relief_mm * strength

    def absorb(self, strength: Array, rgb: tuple[float, float, float]) -> None:
        """Reduce each color channel of the albedo by the fraction ``rgb`` times the strength (V,)."""
        self.albedo_factor *= 1 - strength[:, None] * np.array(rgb)

    def apply_to(self, albedo: Array, redness: float) -> Array:
        """Return the albedo (V, 3) with all marks; ``redness`` is the person's."""
        reddened = 1 + redness * self.redness[:, None] * REDDENING_RGB
        darkened = 1 - np.clip(self.darkness, 0, 0.6)[:, None] * DARKENING_RGB
        return np.asarray(albedo * self.albedo_factor * reddened * darkened)
