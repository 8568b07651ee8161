"""Frozen ensembles whose answers depend on the image and on the member, for tests of what computes them."""

import dataclasses

import numpy as np
import pytest
import torch
from torch import nn

from deltasafe.perception.artifact.frozen_ensemble import write_frozen_ensemble
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network

INFERENCE = InferenceSettings(64, 48)
NETWORK = NetworkSettings(pretrained=False, pyramid_channels=16)
CALIBRATION = Calibration(
    n_images=50,
    n_members=3,
    pixel_accuracy=0.97,
    miou=0.93,
    brier=0.02,
    nll=0.07,
    expected_calibration_error=0.01,
    smallest_supported_delta=0.03,
    temperature=0.7,
)


def image(height, width, seed=0):
    return np.random.default_rng(seed).integers(0, 256, (height, width, 3), dtype=np.uint8)


def network(settings, seed):
    """Statistics and scales as a training would leave them: folding an untrained normalization proves nothing."""
    made = build_network(settings, seed).eval()
    random = torch.Generator().manual_seed(seed)
    for module in made.modules():
        if isinstance(module, nn.BatchNorm2d):
            for values, low, high in (
                (module.weight, 0.7, 1.3),
                (module.bias, -0.3, 0.3),
                (module.running_mean, -0.2, 0.2),
                (module.running_var, 0.6, 1.5),
            ):
                values.data.copy_(low + (high - low) * torch.rand(values.shape, generator=random))
    made.decoder[-1].weight.data.mul_(20)  # probabilities from 0 to 1
    return made


def freeze(parent):
    """Three members in a folder below ``parent``."""
    record = {"settings": {"network": dataclasses.asdict(NETWORK)}, "data_digest": "d" * 64}
    members = [
        Member.write(parent / f"member-{seed}", network(NETWORK, seed), {**record, "seed": seed}) for seed in range(3)
    ]
    return write_frozen_ensemble(members, INFERENCE, CALIBRATION, image(48, 64), parent / "frozen")


def installed(executor):
    """``executor``; the test is skipped where its package is not installed."""
    if executor != "torch":
        pytest.importorskip(executor)
    return executor
