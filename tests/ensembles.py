"""Frozen ensembles of chosen quality, without training, and labeled images to evaluate them on."""

import dataclasses
import pathlib

import cv2
import numpy as np

from deltasafe.perception.artifact.frozen_ensemble import write_frozen_ensemble
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network

CALIBRATION = Calibration(
    n_images=4,
    n_members=1,
    pixel_accuracy=0.9,
    miou=0.8,
    brier=0.1,
    nll=0.3,
    expected_calibration_error=0.01,
    smallest_supported_delta=0.05,
)


def freeze_constant(parent: pathlib.Path, logit: float, info: DatasetInfo = HANDS) -> pathlib.Path:
    """Freeze an ensemble with a constant logit; the lower, the better on images with a small hand."""
    import torch

    settings = NetworkSettings(pretrained=False, pyramid_channels=16)
    network = build_network(settings, 0)
    last = [module for module in network.modules() if isinstance(module, torch.nn.Conv2d)][-1]
    torch.nn.init.zeros_(last.weight)
    torch.nn.init.constant_(last.bias, logit)
    record = {"settings": {"network": dataclasses.asdict(settings)}, "data_digest": "d" * 64, "seed": 0}
    member = Member.write(parent / f"member{logit}", network, record)
    golden = np.zeros((48, 64, 3), np.uint8)
    return write_frozen_ensemble([member], InferenceSettings(64, 48), CALIBRATION, golden, parent / "frozen", info=info)


def write_hands(folder: pathlib.Path, n: int = 4, seed: int = 0) -> pathlib.Path:
    """Write images of noise, and masks with a small hand in the corner."""
    rng = np.random.default_rng(seed)
    for name in ("images", "masks"):
        (folder / name).mkdir(parents=True)
    for k in range(n):
        mask = np.zeros((48, 64), np.uint8)
        mask[: 4 + k, :10] = 255
        cv2.imwrite(str(folder / "images" / f"{k}.png"), rng.integers(0, 256, (48, 64, 3), dtype=np.uint8))
        cv2.imwrite(str(folder / "masks" / f"{k}.png"), mask)
    return folder
