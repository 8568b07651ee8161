"""Batches of a training: images and their size depend on the seed and the step alone, so a training can resume."""

import dataclasses

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.settings import TrainingSettings


@dataclasses.dataclass(frozen=True)
class Batches:
    """The batches of a training, reshuffled before each epoch.

    Attributes:
        data: images and labels, memory-mapped.
        settings: epochs, batch size, and the fraction of steps with downsampled images.
        seed: of the member.
    """

    data: AugmentedSet
    settings: TrainingSettings
    seed: int

    @property
    def per_epoch(self) -> int:
        """Steps of an epoch; images that do not fill a batch are skipped, different ones in each epoch."""
        return len(self.data.images) // self.settings.batch_size

    @property
    def n_steps(self) -> int:
        """Steps of the whole training."""
        return self.settings.epochs * self.per_epoch

    def read(self, step: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Return images (B, 3, H, W), 0 to 255, channels last, and labels (B, H, W) float32 in [0, 1] of a step."""
        epoch, position = divmod(step, self.per_epoch)
        order = np.random.default_rng((self.seed, 1, epoch)).permutation(len(self.data.images))
        batch = order[position * self.settings.batch_size :][: self.settings.batch_size]
        images = torch.from_numpy(np.ascontiguousarray(self.data.images[batch])).permute(0, 3, 1, 2).to(device)
        labels = torch.from_numpy(np.ascontiguousarray(self.data.labels(batch))).to(device)
        if step >= self.settings.small_share * self.n_steps:
            return images, labels
        scale = self.settings.small_scale
        return _downsample(images, scale), _downsample(labels[:, None], scale)[:, 0]


def _downsample(images: Tensor, scale: float) -> Tensor:
    """Average over areas, so that a label becomes the hand's coverage of the larger pixel."""
    size = [max(1, round(side * scale)) for side in images.shape[-2:]]
    return functional.interpolate(images.float(), size, mode="area")
