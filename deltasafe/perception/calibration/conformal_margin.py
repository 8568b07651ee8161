"""Margin in the image that contains the whole hand: split conformal prediction on the distance to the unsafe set.

For a labeled image with the hand H and the unsafe set U = {p_occupied > delta}, the score is the directed Hausdorff
distance

    s = max over x in H of dist(x, U)

between pixel centers, divided by the image's width. It is 0 if H lies inside U or is empty, and infinite if U is empty
and H is not. The margin r(delta, alpha) is the k-th smallest of n scores, k = ceil((n + 1) (1 - alpha)). For a new
image that is exchangeable with the n images

    P(H is a subset of U dilated by r)  >=  1 - alpha

(Vovk et al. 2005; conformal dilation of masks: Mossina and Friedrich 2025, arXiv 2503.05618). n images certify no alpha
below 1 / (n + 1). The probability is also over the n images: given them, the coverage of the set is distributed as
Beta(k, n + 1 - k) if the scores have no ties, and is larger with ties (Vovk 2012).

The score does not decrease with delta. A delta between two values of the grid has the margin of the next larger value.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.special import betaincinv

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.metrics import require_labeled_prediction
from deltasafe.perception.calibration.reliability import DELTA_GRID

REFERENCE_WIDTH_PX = 384
"""Margins are printed as pixels of an image of this width, that of the packaged images."""

_ALPHAS = (0.01, 0.02, 0.05, 0.1, 0.2)
_STATED_ALPHA = 0.05
_STATED_DELTA = 0.05


@dataclasses.dataclass(frozen=True)
class ConformalMargin:
    """The margin for one delta and one alpha.

    Attributes:
        delta: of the unsafe set.
        alpha: bound on the probability that the hand in a new image exceeds the dilated set.
        n_images: images that the margin was fitted on.
        rank: the margin is the ``rank``-th smallest of their scores.
        fraction_of_width: the margin, as fraction of the image's width; infinite if the ``rank``-th score is.
    """

    delta: float
    alpha: float
    n_images: int
    rank: int
    fraction_of_width: float

    @property
    def px(self) -> float:
        """The margin in pixels of an image of ``REFERENCE_WIDTH_PX``."""
        return REFERENCE_WIDTH_PX * self.fraction_of_width

    @property
    def expected_coverage(self) -> float:
        """Mean coverage over sets of ``n_images`` images: rank / (n + 1), at least 1 - alpha."""
        return self.rank / (self.n_images + 1)

    def coverage_interval(self, level: float = 0.95) -> tuple[float, float]:
        """Compute the two-sided interval of the coverage over sets of ``n_images`` images."""
        low, high = betaincinv(self.rank, self.n_images + 1 - self.rank, [(1 - level) / 2, (1 + level) / 2])
        return float(low), float(high)


@dataclasses.dataclass(frozen=True)
class ConformalMargins:
    """The scores of n images for each delta of a grid, from which the margin for any alpha follows.

    Attributes:
        deltas: (D,) ascending.
        scores: (D, n) ascending in each row, as fraction of the image's width; None for an infinite score.
    """

    deltas: tuple[float, ...]
    scores: tuple[tuple[float | None, ...], ...]

    def __post_init__(self) -> None:
        if not self.deltas or not all(a < b for a, b in zip((0.0, *self.deltas), (*self.deltas, 1.0), strict=True)):
            raise SettingsError(f"deltas of margins must ascend within (0, 1), got {self.deltas}")
        lengths = [len(row) for row in self.scores]
        if len(lengths) != len(self.deltas) or min(lengths) < 1 or len(set(lengths)) > 1:
            raise SettingsError(f"margins need n >= 1 scores for each of {len(self.deltas)} deltas, got {lengths}")
        scores = with_infinity(self.scores)
        if not (scores[:, 0] >= 0.0).all() or (scores[:, 1:] < scores[:, :-1]).any():
            raise SettingsError("scores of margins must be at least 0, and ascend for each delta")

    @classmethod
    def of_images(cls, scores: NDArray[np.float64]) -> "ConformalMargins":
        """Build it from (n, len(DELTA_GRID)) `hausdorff_at_delta` of n images."""
        return cls(DELTA_GRID, tuple(finite_or_none(row) for row in np.sort(scores, axis=0).T))

    @property
    def n_images(self) -> int:
        """n."""
        return len(self.scores[0])

    @property
    def smallest_alpha(self) -> float:
        """The smallest alpha that n images certify: 1 / (n + 1)."""
        return 1.0 / (self.n_images + 1)

    @property
    def shown_alphas(self) -> tuple[float, ...]:
        """Those of 1, 2, 5, 10, 20 % that n images certify; the smallest alpha if there are none."""
        return tuple(alpha for alpha in _ALPHAS if self._rank(alpha) <= self.n_images) or (self.smallest_alpha,)

    @property
    def stated_alpha(self) -> float:
        """5 %, or the smallest alpha that n images certify."""
        return max(_STATED_ALPHA, self.smallest_alpha)

    def margin(self, delta: float, alpha: float) -> ConformalMargin:
        """Return the margin for ``alpha`` at the smallest delta of the grid that is at least ``delta``.

        Raises:
            SettingsError: alpha outside (0, 1) or below 1 / (n + 1); delta not above 0, or above the grid.
        """
        if not 0.0 < alpha < 1.0:
            raise SettingsError(f"alpha must lie in (0, 1), got {alpha}")
        if not 0.0 < delta <= self.deltas[-1]:
            raise SettingsError(f"margins are known for delta in (0, {self.deltas[-1]:g}], got {delta:g}")
        rank = self._rank(alpha)
        if rank > self.n_images:
            raise SettingsError(
                f"alpha = {alpha:g} is refused: {self.n_images} calibration images certify no alpha below "
                f"1 / ({self.n_images} + 1) = {self.smallest_alpha:.4g}; use a larger alpha, or calibrate on at least "
                f"{math.ceil(1 / alpha - 1e-9) - 1} images"
            )
        index = int(np.searchsorted(self.deltas, delta))
        score = self.scores[index][rank - 1]
        return ConformalMargin(
            delta=self.deltas[index],
            alpha=alpha,
            n_images=self.n_images,
            rank=rank,
            fraction_of_width=math.inf if score is None else score,
        )

    def _rank(self, alpha: float) -> int:
        """Compute ceil((n + 1) (1 - alpha)); n + 1 if alpha is too small."""
        allowed = math.floor((self.n_images + 1) * alpha + 1e-9)  # so that alpha = 1 / (n + 1) is allowed
        return self.n_images + 1 - min(allowed, self.n_images)


def hausdorff_at_delta(p_occupied: NDArray[np.floating], label: NDArray[np.generic]) -> NDArray[np.float64]:
    """Compute the score of one image for each delta of ``DELTA_GRID``.

    Args:
        p_occupied: (H, W) probabilities.
        label: (H, W) bool or 0/255.

    Returns:
        (len(DELTA_GRID),) directed Hausdorff distances, as fraction of the width W; non-decreasing.
    """
    p, occupied = require_labeled_prediction(p_occupied, label)
    scores = np.zeros(len(DELTA_GRID))
    farthest_px = float(sum(p.shape))
    for index in reversed(range(len(DELTA_GRID))):
        unsafe = p > DELTA_GRID[index]
        missed = occupied & ~unsafe
        if not missed.any():
            break  # nor for a smaller delta
        # The score of the next larger delta bounds this one. The transform of this window is much faster than that of
        # the whole image.
        window = _bounding_window(missed, math.floor(farthest_px))
        distance_px = float(distance_to_unsafe_px(unsafe[window])[missed[window]].max())
        scores[index] = distance_px / p.shape[1]
        farthest_px = min(farthest_px, distance_px)
    return scores


def distance_to_unsafe_px(unsafe: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Compute for each pixel (H, W) the distance to the nearest unsafe pixel; infinite without one."""
    if not unsafe.any():
        return np.full(unsafe.shape, np.inf)
    return np.asarray(distance_transform_edt(~unsafe), dtype=np.float64)


def finite_or_none(values: NDArray[np.float64]) -> tuple[float | None, ...]:
    """Replace infinities by None: JSON has no infinity."""
    return tuple(value if math.isfinite(value) else None for value in values.tolist())


def with_infinity(rows: tuple[tuple[float | None, ...], ...]) -> NDArray[np.float64]:
    """Convert rows of equal length to an array, None to infinity."""
    return np.array([[np.inf if value is None else value for value in row] for row in rows])


def margin_sentence(margins: ConformalMargins | None, thing: str = "hand") -> str:
    """Write a paragraph on the margin at delta = 0.05 around a ``thing`` for the model card; empty without margins."""
    if margins is None:
        return ""
    margin = margins.margin(_STATED_DELTA, margins.stated_alpha)
    basis = f"split conformal prediction on {margins.n_images} image{'' if margins.n_images == 1 else 's'}"
    if math.isinf(margin.fraction_of_width):
        unsafe = f"`p_occupied > {margin.delta:g}`"
        return f"\n\nNo finite margin around the pixels with {unsafe} contains the {thing} ({basis})."
    return (
        f"\n\nThe pixels with `p_occupied > {margin.delta:g}`, dilated by **{margin.fraction_of_width:.2%}** of the "
        f"image's width, contain the whole {thing} in a new image like these with a probability of at least "
        f"**{1 - margin.alpha:.3g}** ({basis}). The planner keeps this margin if `motion_alpha` is set."
    )


def _bounding_window(mask: NDArray[np.bool_], pad_px: int) -> tuple[slice, slice]:
    bounds = [np.flatnonzero(mask.any(axis=axis)) for axis in (1, 0)]
    rows, columns = (slice(max(0, int(b[0]) - pad_px), int(b[-1]) + pad_px + 1) for b in bounds)
    return rows, columns
