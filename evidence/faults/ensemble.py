"""A small frozen ensemble that was never trained: files of every kind, in seconds."""

import dataclasses
import pathlib

import numpy as np

from deltasafe.perception.artifact import freeze_ensemble
from deltasafe.perception.calibration import Calibration
from deltasafe.perception.member import Member
from deltasafe.perception.network import build_network
from deltasafe.perception.settings import InferenceSettings, NetworkSettings

__all__ = ["calibration_of_one", "free_ensemble", "tiny_ensemble"]


def tiny_ensemble(parent: pathlib.Path, seed: int = 0) -> pathlib.Path:
    """One member (``PARENT/member``), frozen (``PARENT/frozen/ensemble-...``)."""
    settings = NetworkSettings(pretrained=False, pyramid_channels=16)
    record = {"settings": {"network": dataclasses.asdict(settings)}, "data_digest": "d" * 64, "seed": seed}
    member = Member.write(parent / "member", build_network(settings, seed), record)
    golden = np.random.default_rng(seed).integers(0, 256, (48, 64, 3), dtype=np.uint8)
    return freeze_ensemble([member], InferenceSettings(64, 48), calibration_of_one(), golden, parent / "frozen")


def free_ensemble(parent: pathlib.Path) -> tuple[list[pathlib.Path], pathlib.Path]:
    """Two members that take every pixel for background, and the frozen ensemble of the first: motions are planned."""
    import torch

    settings = NetworkSettings(pretrained=False, pyramid_channels=16)
    members = []
    for seed in range(2):
        network = build_network(settings, seed)
        *_, last = (module for module in network.modules() if isinstance(module, torch.nn.Conv2d))
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.constant_(last.get_parameter("bias"), -3.0)
        about = {"data_digest": "d" * 64, "ensemble_identity": "f" * 64, "seed": seed}
        record = {"settings": {"network": dataclasses.asdict(settings)}, **about}
        members.append(Member.write(parent / f"member-{seed}", network, record))
    golden = np.zeros((48, 64, 3), np.uint8)
    frozen = freeze_ensemble(members[:1], InferenceSettings(64, 48), calibration_of_one(), golden, parent / "frozen")
    return [member.folder for member in members], frozen


def calibration_of_one() -> Calibration:
    """Of an ensemble of one member; nobody measured it."""
    return Calibration(4, 1, 0.9, 0.8, 0.1, 0.3, 0.01, smallest_supported_delta=0.05)
