"""A picture in the making: the hand in front, its coverage, and what lies behind."""

import dataclasses

import cv2
import numpy as np

from deltasafe.perception.data.augmentation.background import Backgrounds, draw_background
from deltasafe.perception.data.augmentation.cutout import CutOut
from deltasafe.perception.data.augmentation.worn import add_rings, add_sleeve, add_strap

__all__ = ["Layers"]

SHADOW_SHARE = 0.65


@dataclasses.dataclass
class Layers:
    """Hand and surroundings on one canvas, not yet joined.

    Attributes:
        rgb: ``(H, W, 3)`` float32 in [0, 1], the hand; meaningless where ``alpha`` is 0.
        alpha: ``(H, W)`` float32 in [0, 1], coverage by the hand: what the mask is made of.
        background: ``(H, W, 3)`` float32 in [0, 1], all that is not hand.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    background: np.ndarray

    @classmethod
    def sample(cls, hand: CutOut, points: np.ndarray) -> "Layers":
        """The cut-out as seen at points ``(H, W, 2)`` of its image, in front of its own surroundings.

        Outside the image there is no hand, except where the arm goes on.
        """
        on_arm = points if hand.arm is None else hand.arm.continued(points, *hand.alpha.shape[::-1])
        x, y = np.ascontiguousarray(on_arm[..., 0]), np.ascontiguousarray(on_arm[..., 1])
        rgb = cv2.remap(hand.rgb, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
        alpha = cv2.remap(hand.alpha, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT, borderValue=0)
        if hand.arm is not None:
            along, _ = hand.arm.coordinates(points)
            smooth = cv2.remap(hand.smooth, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
            rgb = rgb + (smooth - rgb) * np.clip(along / (0.2 * hand.arm.width), 0.0, 1.0)[..., None]
        x, y = np.ascontiguousarray(points[..., 0]), np.ascontiguousarray(points[..., 1])
        behind = cv2.remap(hand.surroundings, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT)
        return cls(rgb, alpha, behind)

    def put_elsewhere(
        self, rng: np.random.Generator, hand: CutOut, points: np.ndarray, backgrounds: Backgrounds
    ) -> dict[str, object]:
        """Replace all that is not hand, dress the arm, cast its shadow; returns what was drawn."""
        height, width = self.alpha.shape
        self.background, drawn = draw_background(rng, backgrounds, width, height)
        sleeve, cover = np.zeros_like(self.rgb), np.zeros_like(self.alpha)
        if hand.arm is not None:
            along, across = hand.arm.coordinates(points)
            drawn["strap"] = add_strap(rng, hand.arm, along, across, self.rgb)
            sleeve, cover, self.alpha, drawn["sleeve"] = add_sleeve(rng, hand.arm, along, across, self.alpha)
        drawn["rings"] = add_rings(rng, self.rgb, self.alpha)
        drawn["shadow"] = self._cast_shadow(rng, np.maximum(self.alpha, cover))
        self.background += (sleeve - self.background) * cover[..., None]
        return {name: value for name, value in drawn.items() if value}

    def composed(self) -> np.ndarray:
        """The hand in front of the background, ``(H, W, 3)`` float32 in [0, 1]."""
        return self.background + (self.rgb - self.background) * self.alpha[..., None]

    def _cast_shadow(self, rng: np.random.Generator, cover: np.ndarray) -> dict[str, float]:
        if rng.random() >= SHADOW_SHARE:
            return {}
        height, width = cover.shape
        x, y = rng.uniform(-0.08, 0.08, 2) * width
        softness = float(np.exp(rng.uniform(*np.log((0.003, 0.05))))) * width
        strength = float(rng.uniform(0.15, 0.75))
        moved = cv2.warpAffine(
            cover,
            np.array([[1, 0, x], [0, 1, y]], np.float32),
            (width, height),
            borderMode=cv2.BORDER_REPLICATE,
        )
        shadow = cv2.GaussianBlur(moved, (0, 0), softness, borderType=cv2.BORDER_REPLICATE)
        self.background *= (1 - np.float32(strength) * shadow)[..., None]
        return {"x_px": float(x), "y_px": float(y), "softness_px": softness, "strength": strength}
