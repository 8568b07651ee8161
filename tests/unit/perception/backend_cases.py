"""Frozen ensembles for tests of backends: their predictions depend on the image and differ between members."""

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
    """Build a network with random batch normalization, since fusing an untrained one would change nothing."""
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
    made.decoder[-1].weight.data.mul_(20)  # spreads the probabilities over (0, 1)
    return made


def freeze(parent):
    """Freeze three members into a subfolder of ``parent``."""
    record = {"settings": {"network": dataclasses.asdict(NETWORK)}, "data_digest": "d" * 64}
    members = [
        Member.write(parent / f"member-{seed}", network(NETWORK, seed), {**record, "seed": seed}) for seed in range(3)
    ]
    return write_frozen_ensemble(members, INFERENCE, CALIBRATION, image(48, 64), parent / "frozen")


def installed(backend):
    """Return ``backend``; skip the test if its package is not installed."""
    if backend != "torch":
        pytest.importorskip(backend)
    return backend
