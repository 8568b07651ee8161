"""The training that one writes first: PNG files, a DataLoader, float32, torch's defaults, one member after another."""

import os
import pathlib
from collections.abc import Callable

import cv2
import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from deltasafe.perception.augmented_set import AugmentedSet
from deltasafe.perception.network import build_network
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training import learning_rate

__all__ = ["PngHands", "plain_training", "write_pngs"]


def write_pngs(data: AugmentedSet, folder: pathlib.Path) -> None:
    """The images and masks of a stored set as files of one picture each."""
    folder.mkdir(parents=True)
    for i in range(data.n):
        cv2.imwrite(str(folder / f"{i:05d}-image.png"), data.images[i][..., ::-1])
        cv2.imwrite(str(folder / f"{i:05d}-mask.png"), 255 * data.masks[i])


class PngHands(Dataset[tuple[Tensor, Tensor]]):
    """Pairs of image (3, H, W), 0..255, and label (H, W), both float32, decoded when asked for."""

    def __init__(self, folder: pathlib.Path) -> None:
        self.images = sorted(folder.glob("*-image.png"))
        self.masks = sorted(folder.glob("*-mask.png"))

    def __len__(self) -> int:
        return len(self.images)

    def __getitem__(self, i: int) -> tuple[Tensor, Tensor]:
        with Image.open(self.images[i]) as image, Image.open(self.masks[i]) as mask:
            rgb = torch.from_numpy(np.array(image)).permute(2, 0, 1).contiguous()
            return rgb.float(), torch.from_numpy(np.array(mask)).float() / 255


def plain_training(
    pngs: PngHands, settings: TrainingSettings, seeds: tuple[int, ...], on_step: Callable[[int, int, float], None]
) -> None:
    """One epoch of each member; ``on_step`` hears (seed, step from 1, loss). Recipe and network as in ours."""
    for seed in seeds:
        torch.manual_seed(seed)
        loader = DataLoader(
            pngs, settings.batch_size, shuffle=True, num_workers=min(2, os.cpu_count() or 1), drop_last=True
        )
        network = build_network(settings.network, seed).train()
        optimiser = torch.optim.Adam(
            network.parameters(), lr=settings.peak_learning_rate, weight_decay=settings.weight_decay
        )
        criterion = torch.nn.BCEWithLogitsLoss()
        for step, (images, labels) in enumerate(loader):
            for group in optimiser.param_groups:
                group["lr"] = learning_rate(settings, step, len(loader))
            loss = criterion(network(images), labels)
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
            on_step(seed, step + 1, loss.item())
