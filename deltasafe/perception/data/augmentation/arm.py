"""The arm at the image border: found in a mask, and continued beyond the border."""

import dataclasses

import cv2
import numpy as np


@dataclasses.dataclass(frozen=True)
class Arm:
    """The place where the arm crosses the image border.

    Arm coordinates of a point, in pixels: ``along`` is positive beyond the crossing and negative inside the image;
    ``across`` is perpendicular to it.

    Attributes:
        crossing: ``(2,)`` x and y of the center of the crossing, in pixels.
        direction: ``(2,)`` unit vector along the arm, out of the image.
        width_px: of the arm at the crossing, perpendicular to ``direction``.
        across_px: least and greatest ``across`` of the crossing.
        narrowing: width of the wrist relative to ``width_px``; 1 where the arm is cut at wrist or forearm.
    """

    crossing: np.ndarray
    direction: np.ndarray
    width_px: float
    across_px: tuple[float, float]
    narrowing: float

    @classmethod
    def from_mask(cls, mask: np.ndarray) -> "Arm | None":
        """Find the arm of a mask ``(H, W)``: its longest run along the border. None if it does not reach the border."""
        height, width = mask.shape
        ring = np.zeros_like(mask)
        ring[[0, -1], :] = mask[[0, -1], :]
        ring[:, [0, -1]] = mask[:, [0, -1]]
        n_labels, labels, stats, centers = cv2.connectedComponentsWithStats(ring, connectivity=8)
        if n_labels == 1:
            return None
        label = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
        if stats[label, cv2.CC_STAT_AREA] < 0.02 * (height + width):
            return None
        crossing = centers[label]
        ys, xs = np.nonzero(labels == label)
        ys_hand, xs_hand = np.nonzero(mask)
        radius = 1.2 * float(np.hypot(np.ptp(xs), np.ptp(ys)) + 1)
        near = np.hypot(xs_hand - crossing[0], ys_hand - crossing[1]) < radius
        inward = np.array([xs_hand[near].mean(), ys_hand[near].mean()]) - crossing
        n_first, n_last = [(xs == 0).sum(), (ys == 0).sum()], [(xs == width - 1).sum(), (ys == height - 1).sum()]
        normal = np.subtract(n_last, n_first).astype(float)
        crossed = np.abs(normal) > 0.12 * np.abs(normal).sum()
        direction = _direction(inward, normal, crossed)
        perpendicular = np.array([-direction[1], direction[0]])
        across = (xs - crossing[0]) * perpendicular[0] + (ys - crossing[1]) * perpendicular[1]
        across_px = (float(across.min()), float(across.max()))
        arm_extent = across_px[1] - across_px[0] + 1.0
        hand_across = xs_hand * perpendicular[0] + ys_hand * perpendicular[1]
        hand_extent = np.ptp(np.quantile(hand_across, (0.02, 0.98))) + 1
        # at an image corner the crossing has a bend, and a narrower arm would leave a gap to the border
        narrowing = 1.0 if crossed.all() else float(np.clip(0.6 * hand_extent / arm_extent, 0.62, 1.0))
        return cls(crossing.astype(np.float32), direction.astype(np.float32), arm_extent, across_px, narrowing)

    def coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``along`` and ``across`` of points ``(..., 2)`` in pixels of the source image."""
        x, y = points[..., 0] - self.crossing[0], points[..., 1] - self.crossing[1]
        along = x * self.direction[0] + y * self.direction[1]
        return along, y * self.direction[0] - x * self.direction[1]

    def profile(self, beyond_px: np.ndarray) -> np.ndarray:
        """Width relative to the crossing, ``beyond_px`` outside the image: narrower up to the wrist, then wider."""
        steps = np.clip(beyond_px / self.width_px, 0.0, 4.0)
        ease = np.clip(steps / 0.7, 0.0, 1.0)
        ease = ease * ease * (3.0 - 2.0 * ease)
        return (1.0 - (1.0 - self.narrowing) * ease) * (1.0 + 0.08 * np.clip(steps - 0.3, 0.0, 2.5))

    def extend(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """Map points ``(..., 2)`` on the continued arm to the border pixel that they repeat.

        Points inside the image do not change. All other points outside of it are mapped to (-10, -10).
        """
        x, y = points[..., 0], points[..., 1]
        outside = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
        result = points.copy()
        result[outside] = self._at_border(points[outside], np.array([width, height], np.float32))
        return result

    def _at_border(self, points: np.ndarray, size: np.ndarray) -> np.ndarray:
        steps = np.where(np.abs(self.direction) > 0.05, self.direction, np.float32(np.inf))
        overshoot = np.where(steps > 0, points - (size - 1), points)
        beyond_px = np.maximum((overshoot / steps).max(-1), 0.0)
        profile = self.profile(beyond_px)
        base = points - beyond_px[:, None] * self.direction
        base = self.crossing + (base - self.crossing) / profile[:, None]
        _, across = self.coordinates(base)
        on_arm = (beyond_px > 0) & (across > self.across_px[0] - 2.0) & (across < self.across_px[1] + 2.0)
        on_arm &= ((base >= -0.5) & (base < size - 0.5)).all(-1)
        return np.where(on_arm[:, None], np.clip(base, 0, size - 1), np.float32(-10.0))


def _direction(inward: np.ndarray, normal: np.ndarray, crossed: np.ndarray) -> np.ndarray:
    """Unit vector out of the image, away from the hand, with a component through every image side that is crossed."""
    direction = _unit(_unit(-inward) + 0.25 * _unit(normal))
    # an arm that is continued along a side would repeat the same border pixels without end
    least = 0.35 if crossed.all() else 0.5
    outward = np.maximum(direction * np.sign(normal), least) * np.sign(normal)
    return _unit(np.where(crossed, outward, direction))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
