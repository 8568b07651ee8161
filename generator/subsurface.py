"""Subsurface scattering of skin in screen space; red light travels farther below the surface than blue light.

The diffuse irradiance is the picture without specular highlights, divided by the albedo. It is blurred with the
diffusion profile of skin, a sum of Gaussians for each color channel (d'Eon and Luebke 2007). The blur also removes the
noise of the path tracer.
"""

import dataclasses

import numpy as np
from scipy.ndimage import gaussian_filter

from generator.aliases import Array, Mask

# (weight, standard deviation in millimeters) for red, green, blue
PROFILES = (((0.45, 0.7), (0.3, 2.2), (0.25, 5.0)), ((0.6, 0.6), (0.4, 1.6)), ((0.7, 0.5), (0.3, 1.0)))
FULL_COVERAGE = 0.995


@dataclasses.dataclass(frozen=True)
class SkinBuffers:
    """Auxiliary images of the skin.

    Attributes:
        specular: (H, W, 3) radiance of the specular highlights.
        albedo: (H, W, 3).
        pixel_mm: (H, W) width of a pixel, projected to the surface.
        coverage: (H, W) fraction of skin.
    """

    specular: Array
    albedo: Array
    pixel_mm: Array
    coverage: Array


def scatter(radiance: Array, skin: SkinBuffers) -> Array:
    """Apply subsurface scattering to a picture (H, W, 3); pixels that are not fully skin do not change."""
    inside = skin.coverage > FULL_COVERAGE
    if not inside.any():
        return radiance
    pixel_mm = float(np.median(skin.pixel_mm[inside]))
    irradiance = np.maximum(radiance - skin.specular, 0) / np.maximum(skin.albedo, 0.004)
    irradiance = np.where(inside[..., None], irradiance, 0)
    diffused = np.stack([_diffuse(irradiance[..., c], inside, pixel_mm, PROFILES[c]) for c in range(3)], axis=-1)
    highlights = np.minimum(skin.specular, np.percentile(skin.specular[inside], 99.5))
    highlights = gaussian_filter(highlights, (0.8, 0.8, 0))
    return np.where(inside[..., None], skin.albedo * diffused + highlights, radiance)


def _diffuse(irradiance: Array, inside: Mask, pixel_mm: float, profile: tuple[tuple[float, float], ...]) -> Array:
    total = np.zeros_like(irradiance)
    for weight, sigma_mm in profile:
        sigma_px = sigma_mm / pixel_mm
        inside_fraction = np.maximum(gaussian_filter(inside.astype(float), sigma_px), 1e-3)
        total += weight * gaussian_filter(irradiance, sigma_px) / inside_fraction
    return total
