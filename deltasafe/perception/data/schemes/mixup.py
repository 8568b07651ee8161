"""Mixup (Zhang et al. 2018): two images are blended, and so are their labels."""

import dataclasses

import numpy as np

from deltasafe.perception.data.schemes.originals import Originals
from deltasafe.perception.data.schemes.settings import MixupSettings
from deltasafe.perception.data.schemes.soft_masks import CERTAIN

__all__ = ["Mixup"]


@dataclasses.dataclass(frozen=True)
class Mixup:
    """lambda x_i + (1 - lambda) x_j with lambda from Beta(alpha, alpha) and another original j, uniformly.

    Cross-entropy is linear in the label, so training on the blended mask is the authors' loss,
    lambda CE(y_i) + (1 - lambda) CE(y_j).
    """

    originals: Originals
    settings: MixupSettings

    def make(self, i: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, list[dict[str, object]]]:
        """Image, soft mask, and what was done, for one variant of the ``i``-th original."""
        n = len(self.originals.ids)
        j = (i + 1 + int(rng.integers(n - 1))) % n if n > 1 else i
        share = float(rng.beta(self.settings.alpha, self.settings.alpha))
        image = np.rint(_blend(self.originals.images, i, j, share)).astype(np.uint8)
        mask = np.rint(_blend(self.originals.masks, i, j, share) * CERTAIN).astype(np.uint16)
        return image, mask, [{"method": "mixup", "partner": self.originals.ids[j], "share": share}]


def _blend(pixels: np.ndarray, i: int, j: int, share: float) -> np.ndarray:
    return np.asarray(share * pixels[i].astype(np.float64) + (1 - share) * pixels[j])
