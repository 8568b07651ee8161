"""The hand cut out of its image, with an arm that goes on beyond the image border."""

import dataclasses

import cv2
import numpy as np

__all__ = ["Arm", "CutOut"]


@dataclasses.dataclass(frozen=True)
class Arm:
    """Where the arm leaves the image, so that it can be continued there.

    Arm coordinates of a point are ``along`` (pixels beyond the crossing, negative inside the image) and
    ``across``.

    Attributes:
        crossing: ``(2,)`` center of the crossing with the border, x and y in pixels.
        direction: ``(2,)`` unit vector along the arm, out of the image.
        width: of the arm at the crossing, across its direction, in pixels.
        run: least and greatest ``across`` of the crossing, in pixels.
        narrowing: how far the width has to shrink outside to become that of a wrist; 1 where it is a wrist or
            forearm.
    """

    crossing: np.ndarray
    direction: np.ndarray
    width: float
    run: tuple[float, float]
    narrowing: float

    @classmethod
    def of(cls, mask: np.ndarray) -> "Arm | None":
        """The arm of a mask ``(H, W)``, at its longest run along the border; None where it touches none."""
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
        reach = 1.2 * float(np.hypot(np.ptp(xs), np.ptp(ys)) + 1)
        ys_hand, xs_hand = np.nonzero(mask)
        near = np.hypot(xs_hand - crossing[0], ys_hand - crossing[1]) < reach
        inward = np.array([xs_hand[near].mean(), ys_hand[near].mean()]) - crossing
        sides = np.array(
            [
                [float((xs == 0).sum()), float((ys == 0).sum())],
                [float((xs == width - 1).sum()), float((ys == height - 1).sum())],
            ]
        )
        normal = sides[1] - sides[0]
        direction = _unit(_unit(-inward) + 0.25 * _unit(normal))
        # an arm leaves through every side that it crosses; along a side it would be stretched without end
        crossed = np.abs(normal) > 0.12 * np.abs(normal).sum()
        least = 0.35 if crossed.all() else 0.5
        outward = np.maximum(direction * np.sign(normal), least) * np.sign(normal)
        direction = _unit(np.where(crossed, outward, direction))
        across = np.array([-direction[1], direction[0]])
        spread = (xs - crossing[0]) * across[0] + (ys - crossing[1]) * across[1]
        run = (float(spread.min()), float(spread.max()))
        extent = run[1] - run[0] + 1.0
        hand_extent = np.ptp(np.quantile(xs_hand * across[0] + ys_hand * across[1], (0.02, 0.98))) + 1
        # in a corner the crossing is bent, and narrowing it would leave the border
        narrowing = 1.0 if crossed.all() else float(np.clip(0.6 * hand_extent / extent, 0.62, 1.0))
        return cls(crossing.astype(np.float32), direction.astype(np.float32), extent, run, narrowing)

    def coordinates(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """``along`` and ``across`` of points ``(..., 2)`` in pixels of the source."""
        x, y = points[..., 0] - self.crossing[0], points[..., 1] - self.crossing[1]
        along = x * self.direction[0] + y * self.direction[1]
        return along, y * self.direction[0] - x * self.direction[1]

    def profile(self, beyond: np.ndarray) -> np.ndarray:
        """Width relative to the crossing, ``beyond`` pixels outside: down to a wrist, then slowly wider."""
        steps = np.clip(beyond / self.width, 0.0, 4.0)
        ease = np.clip(steps / 0.7, 0.0, 1.0)
        ease = ease * ease * (3.0 - 2.0 * ease)
        return (1.0 - (1.0 - self.narrowing) * ease) * (1.0 + 0.08 * np.clip(steps - 0.3, 0.0, 2.5))

    def continued(self, points: np.ndarray, width: int, height: int) -> np.ndarray:
        """Send points ``(..., 2)`` on the arm's continuation to the place at the border that they repeat.

        Points elsewhere outside are left outside, where nothing is.
        """
        x, y = points[..., 0], points[..., 1]
        outside = (x < 0) | (y < 0) | (x > width - 1) | (y > height - 1)
        result = points.copy()
        result[outside] = self._seen_at_border(points[outside], np.array([width, height], np.float32))
        return result

    def _seen_at_border(self, points: np.ndarray, size: np.ndarray) -> np.ndarray:
        steps = np.where(np.abs(self.direction) > 0.05, self.direction, np.float32(np.inf))
        overshoot = np.where(steps > 0, points - (size - 1), points)
        beyond = np.maximum((overshoot / steps).max(-1), 0.0)
        profile = self.profile(beyond)
        base = points - beyond[:, None] * self.direction
        base = self.crossing + (base - self.crossing) / profile[:, None]
        _, across = self.coordinates(base)
        seen = (beyond > 0) & (across > self.run[0] - 2.0) & (across < self.run[1] + 2.0)
        seen &= ((base >= -0.5) & (base < size - 0.5)).all(-1)
        return np.where(seen[:, None], np.clip(base, 0, size - 1), np.float32(-10.0))


@dataclasses.dataclass(frozen=True)
class CutOut:
    """A hand without its surroundings.

    Attributes:
        rgb: ``(H, W, 3)`` float32 in [0, 1]; outside the hand the color of its nearest inner pixel, so that
            no rim of the old background is left when the edge is blended.
        alpha: ``(H, W)`` float32 in [0, 1], the hand's coverage of each pixel.
        smooth: ``rgb`` without its finer relief, for where the arm goes on: one line of pixels drawn out is
            all streaks.
        surroundings: ``(H, W, 3)`` float32, the image with the hand filled in from its surroundings.
        center: ``(2,)`` middle of the hand's bounding box, x and y in pixels.
        arm: where the arm leaves the image, or None.
    """

    rgb: np.ndarray
    alpha: np.ndarray
    smooth: np.ndarray
    surroundings: np.ndarray
    center: np.ndarray
    arm: Arm | None

    @classmethod
    def of(cls, rgb: np.ndarray, mask: np.ndarray, width: int, height: int) -> "CutOut":
        """Cut out the hand of ``rgb`` (H, W, 3) uint8 by its ``mask`` (H, W), for a canvas of given size.

        A source larger than the canvas is first reduced by area to the smallest size that covers it.
        """
        scale = max(width / rgb.shape[1], height / rgb.shape[0])
        if scale < 1.0:
            size = (round(rgb.shape[1] * scale), round(rgb.shape[0] * scale))
            rgb = cv2.resize(rgb, size, interpolation=cv2.INTER_AREA)
            coverage = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA)
            mask = (coverage >= 0.5).astype(np.uint8)
        mask = _without_severed_parts(np.ascontiguousarray(mask, np.uint8))
        color = rgb.astype(np.float32) / 255.0
        padded = cv2.copyMakeBorder(mask, 3, 3, 3, 3, cv2.BORDER_REPLICATE)
        ellipse = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (5, 5))
        inner = cv2.erode(padded, ellipse)[3:-3, 3:-3]
        outer = 1 - cv2.dilate(padded, ellipse)[3:-3, 3:-3]
        alpha = cv2.GaussianBlur(mask.astype(np.float32), (0, 0), 0.6, borderType=cv2.BORDER_REPLICATE)
        ys, xs = np.nonzero(mask)
        center = np.array([(xs.min() + xs.max()) / 2, (ys.min() + ys.max()) / 2]) if xs.size else np.zeros(2)
        hand = _filled(color, inner if inner.any() else mask)
        around = cv2.GaussianBlur(_filled(color, outer), (0, 0), 6.0) if outer.any() else color
        surroundings = np.where(outer[..., None] > 0, color, around)
        arm = Arm.of(mask)
        smooth = hand if arm is None else cv2.GaussianBlur(hand, (0, 0), max(0.07 * arm.width, 0.5))
        return cls(hand, alpha, smooth, surroundings, center, arm)


def _without_severed_parts(mask: np.ndarray) -> np.ndarray:
    """The mask without smaller parts cut off by the border: a lone thumb would float when moved."""
    n_labels, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    if n_labels <= 2:
        return mask
    main = 1 + int(np.argmax(stats[1:, cv2.CC_STAT_AREA]))
    at_border = np.unique(np.concatenate([labels[0], labels[-1], labels[:, 0], labels[:, -1]]))
    severed = [label for label in at_border if label not in (0, main)]
    return np.where(np.isin(labels, severed), 0, mask).astype(np.uint8)


def _filled(color: np.ndarray, known: np.ndarray) -> np.ndarray:
    """``color`` with each pixel outside ``known`` replaced by its nearest known one, softened."""
    if not known.any():
        return color
    _, labels = cv2.distanceTransformWithLabels(1 - known, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    by_label = np.zeros((int(labels.max()) + 1, 3), np.float32)
    by_label[labels[known > 0]] = color[known > 0]
    spread = by_label[labels]
    return np.where(known[..., None] > 0, color, cv2.blur(spread, (3, 3)))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / max(float(np.linalg.norm(vector)), 1e-9)
