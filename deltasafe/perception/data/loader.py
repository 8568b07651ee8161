"""Which images a step of training sees, and at which size: a function of seed and step alone."""

import dataclasses

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.settings import TrainingSettings

__all__ = ["Batches"]


@dataclasses.dataclass(frozen=True)
class Batches:
    """The batches of a training, reshuffled before each epoch.

    Attributes:
        data: images and labels, memory-mapped.
        settings: epochs, batch size, and the share of steps that sees small images.
        seed: of the member.
    """

    data: AugmentedSet
    settings: TrainingSettings
    seed: int

    @property
    def per_epoch(self) -> int:
        """Steps of an epoch; a remainder smaller than a batch is left out, another one each time."""
        return len(self.data.images) // self.settings.batch_size

    @property
    def n_steps(self) -> int:
        """Steps of the whole training."""
        return self.settings.epochs * self.per_epoch

    def read(self, step: int, device: torch.device) -> tuple[Tensor, Tensor]:
        """Images (B, 3, H, W), 0..255 in channels-last order, and labels (B, H, W) float32 in [0, 1] of a step."""
        epoch, position = divmod(step, self.per_epoch)
        order = np.random.default_rng((self.seed, 1, epoch)).permutation(len(self.data.images))
        batch = order[position * self.settings.batch_size :][: self.settings.batch_size]
        images = torch.from_numpy(np.ascontiguousarray(self.data.images[batch])).permute(0, 3, 1, 2)
        labels = torch.from_numpy(np.ascontiguousarray(self.data.labels(batch)))
        images, labels = images.to(device), labels.to(device)
        if step < self.settings.small_share * self.n_steps:
            return _reduced(images, self.settings.small_scale), _reduced(labels[:, None], self.settings.small_scale)[
                :, 0
            ]
        return images, labels


def _reduced(pictures: Tensor, scale: float) -> Tensor:
    """Means over areas: a label becomes the share of a pixel that is hand."""
    size = [max(1, round(side * scale)) for side in pictures.shape[-2:]]
    return functional.interpolate(pictures.float(), size, mode="area")
