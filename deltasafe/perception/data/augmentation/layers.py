"""Composition of an image from layers: the hand in front, its coverage, and the background."""

import dataclasses

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.accessories import add_rings, add_sleeve, add_strap
from deltasafe.perception.data.augmentation.background import Backgrounds, draw_background
from deltasafe.perception.data.augmentation.geometry import sample
from deltasafe.perception.data.augmentation.hand_cutout import HandCutout
from deltasafe.perception.data.augmentation.skin import mean_lab, recolor

P_SHADOW = 0.65
P_SAME_COLOR = 0.2


@dataclasses.dataclass
class Layers:
    """Hand and background on one canvas, before they are blended.

    Attributes:
        rgb: ``(H, W, 3)`` float32 in [0, 1], the hand; undefined where ``alpha`` is 0.
        alpha: ``(H, W)`` float32 in [0, 1], coverage by the hand; the mask is computed from it.
        background: ``(H, W, 3)`` float32 in [0, 1], everything except the hand.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    background: np.ndarray

    @classmethod
    def sample(cls, hand: HandCutout, points: np.ndarray) -> "Layers":
        """Sample the cut-out and its own background at points ``(H, W, 2)`` of its image.

        Outside the image there is no hand, except where the arm is continued.
        """
        on_arm = points if hand.arm is None else hand.arm.extend(points, *hand.alpha.shape[::-1])
        rgb = sample(hand.rgb, on_arm, cv2.BORDER_REPLICATE)
        alpha = sample(hand.alpha, on_arm, cv2.BORDER_CONSTANT)
        if hand.arm is not None:
            along, _ = hand.arm.coordinates(points)
            smooth = sample(hand.smooth_rgb, on_arm, cv2.BORDER_REPLICATE)
            rgb = rgb + (smooth - rgb) * np.clip(along / (0.2 * hand.arm.width_px), 0.0, 1.0)[..., None]
        return cls(rgb, alpha, sample(hand.background, points, cv2.BORDER_REFLECT))

    def replace_background(
        self,
        rng: np.random.Generator,
        hand: HandCutout,
        points: np.ndarray,
        backgrounds: Backgrounds,
        clothed: bool = True,
    ) -> dict[str, object]:
        """Draw a background, clothing and jewelry if ``clothed``, and the shadow; returns the drawn parameters."""
        height, width = self.alpha.shape
        self.background, drawn = draw_background(rng, backgrounds, width, height)
        drawn["same_color"] = self._recolor_background(rng)
        sleeve, sleeve_alpha = np.zeros_like(self.rgb), np.zeros_like(self.alpha)
        if clothed and hand.arm is not None:
            along, across = hand.arm.coordinates(points)
            drawn["strap"] = add_strap(rng, hand.arm, along, across, self.rgb)
            sleeve, sleeve_alpha, self.alpha, drawn["sleeve"] = add_sleeve(rng, hand.arm, along, across, self.alpha)
        if clothed:
            drawn["rings"] = add_rings(rng, self.rgb, self.alpha)
        drawn["shadow"] = self._cast_shadow(rng, np.maximum(self.alpha, sleeve_alpha))
        self.background += (sleeve - self.background) * sleeve_alpha[..., None]
        return {name: value for name, value in drawn.items() if value}

    def compose(self) -> np.ndarray:
        """Blend the hand over the background: ``(H, W, 3)`` float32 in [0, 1]."""
        return self.background + (self.rgb - self.background) * self.alpha[..., None]

    def _recolor_background(self, rng: np.random.Generator) -> dict[str, float]:
        """Give one background in five about the hand's own color, which must not be enough to recognize a hand."""
        if rng.random() >= P_SAME_COLOR or not (self.alpha > 0.5).any():
            return {}
        lab = mean_lab(self.rgb, self.alpha) + rng.normal(0.0, (14.0, 5.0, 6.0)).astype(np.float32)
        lab[0] = np.clip(lab[0], 8.0, 95.0)
        contrast, chroma = rng.uniform((0.5, 0.2), (1.2, 0.8)).tolist()
        everywhere = np.ones_like(self.alpha)
        self.background = np.ascontiguousarray(recolor(self.background, everywhere, lab, contrast, chroma), np.float32)
        return {"lightness": float(lab[0]), "a": float(lab[1]), "b": float(lab[2])}

    def _cast_shadow(self, rng: np.random.Generator, coverage: np.ndarray) -> dict[str, float]:
        if rng.random() >= P_SHADOW:
            return {}
        height, width = coverage.shape
        x, y = rng.uniform(-0.08, 0.08, 2) * width
        softness = float(np.exp(rng.uniform(*np.log((0.003, 0.05))))) * width
        strength = float(rng.uniform(0.15, 0.75))
        shift = np.array([[1, 0, x], [0, 1, y]], np.float32)
        shadow = cv2.warpAffine(coverage, shift, (width, height), borderMode=cv2.BORDER_REPLICATE)
        shadow = cv2.GaussianBlur(shadow, (0, 0), softness, borderType=cv2.BORDER_REPLICATE)
        self.background *= (1 - np.float32(strength) * shadow)[..., None]
        return {"x_px": float(x), "y_px": float(y), "softness_px": softness, "strength": strength}
