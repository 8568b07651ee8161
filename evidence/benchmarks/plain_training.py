"""Baseline training loop: PNG files, a DataLoader, float32, torch's defaults, members in sequence."""

import os
import pathlib
from collections.abc import Callable

import cv2
import numpy as np
import torch
from PIL import Image
from torch import Tensor
from torch.utils.data import DataLoader, Dataset

from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training.network import build_network
from deltasafe.perception.training.train_member import learning_rate


def write_pngs(data: AugmentedSet, folder: pathlib.Path) -> None:
    """Write every image and mask of an augmented set as a PNG file."""
    folder.mkdir(parents=True)
    for i in range(data.n):
        cv2.imwrite(str(folder / f"{i:05d}-image.png"), data.images[i][..., ::-1])
        cv2.imwrite(str(folder / f"{i:05d}-mask.png"), 255 * data.masks[i])


class PngHands(Dataset[tuple[Tensor, Tensor]]):
    """Pairs of image (3, H, W), 0..255, and label (H, W), both float32, decoded on access."""

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
    """Train one epoch of each member with our recipe and network; calls ``on_step(seed, step from 1, loss)``."""
    workers = min(2, os.cpu_count() or 1)
    for seed in seeds:
        torch.manual_seed(seed)
        loader = DataLoader(pngs, settings.batch_size, shuffle=True, num_workers=workers, drop_last=True)
        network = build_network(settings.network, seed).train()
        optimizer = torch.optim.Adam(
            network.parameters(), lr=settings.peak_learning_rate, weight_decay=settings.weight_decay
        )
        criterion = torch.nn.BCEWithLogitsLoss()
        for step, (images, labels) in enumerate(loader):
            for group in optimizer.param_groups:
                group["lr"] = learning_rate(settings, step, len(loader))
            loss = criterion(network(images), labels)
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            on_step(seed, step + 1, loss.item())
