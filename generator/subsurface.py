"""Light that enters skin leaves it some millimetres away, red farther than blue: scattering in screen space.

The diffuse light on the skin is what is left of the picture without its highlights, divided by the albedo. Blurring it
by the skin's diffusion profile (a sum of Gaussians for each colour, after d'Eon and Luebke 2007) also takes the noise
out.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

__all__ = ["SkinLayers", "scatter"]

Array = NDArray[np.float64]
# (weight, standard deviation in millimetres) for red, green, blue
PROFILES = (((0.45, 0.7), (0.3, 2.2), (0.25, 5.0)), ((0.6, 0.6), (0.4, 1.6)), ((0.7, 0.5), (0.3, 1.0)))
WHOLLY_SKIN = 0.995


@dataclasses.dataclass(frozen=True)
class SkinLayers:
    """What scattering needs beside the picture.

    Attributes:
        specular: (H, W, 3) highlights alone.
        albedo: (H, W, 3).
        pixel_mm: (H, W) width of a pixel on the surface that it shows.
        coverage: (H, W) share of skin.
    """

    specular: Array
    albedo: Array
    pixel_mm: Array
    coverage: Array


def scatter(full: Array, skin: SkinLayers) -> Array:
    """The picture (H, W, 3) with light scattered below the skin; pixels that are not wholly skin stay as they are."""
    inside = skin.coverage > WHOLLY_SKIN
    if not inside.any():
        return full
    pixel_mm = float(np.median(skin.pixel_mm[inside]))
    light = np.where(inside[..., None], np.maximum(full - skin.specular, 0) / np.maximum(skin.albedo, 0.004), 0)
    diffused = np.stack([_diffused(light[..., c], inside, pixel_mm, PROFILES[c]) for c in range(3)], axis=-1)
    highlights = np.minimum(skin.specular, np.percentile(skin.specular[inside], 99.5))
    highlights = gaussian_filter(highlights, (0.8, 0.8, 0))
    return np.where(inside[..., None], skin.albedo * diffused + highlights, full)


def _diffused(
    light: Array, inside: NDArray[np.bool_], pixel_mm: float, profile: tuple[tuple[float, float], ...]
) -> Array:
    total = np.zeros_like(light)
    for weight, spread_mm in profile:
        sigma = spread_mm / pixel_mm
        share = np.maximum(gaussian_filter(inside.astype(float), sigma), 1e-3)
        total += weight * gaussian_filter(light, sigma) / share
    return total
