"""Small inputs shared by evidence commands: folders, hand sets, untrained ensembles and a synthetic execution."""

import contextlib
import dataclasses
import pathlib
import shutil
import tempfile
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from deltasafe.execution import Execution
from deltasafe.perception.artifact.frozen_ensemble import write_frozen_ensemble
from deltasafe.perception.calibration.delta_support import Calibration
from deltasafe.perception.data.augmentation.settings import AugmentationSettings
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network
from deltasafe.planning import ToolBody
from pipelines.home import DATASETS

TINY = NetworkSettings(pretrained=False, pyramid_channels=16)
TINY_INFERENCE = InferenceSettings(64, 48)


@contextlib.contextmanager
def temporary_home() -> Iterator[pathlib.Path]:
    """Create a temporary folder that unprivileged users can read, and remove it afterwards."""
    with tempfile.TemporaryDirectory(prefix="deltasafe-evidence-", ignore_cleanup_errors=True) as name:
        home = pathlib.Path(name)
        home.chmod(0o755)
        yield home


def first_hands(count: int) -> LabeledImageSet:
    """Load the first ``count`` packaged training images."""
    hands = LabeledImageSet.load(DATASETS / "hands" / "train")
    return dataclasses.replace(hands, items=hands.items[:count], pixel_digests=hands.pixel_digests[:count])


def tiny_hands(folder: pathlib.Path, subset: str = "train") -> pathlib.Path:
    """Copy the first four packaged images of ``train`` or ``test`` with their masks."""
    for kind in ("images", "masks"):
        (folder / kind).mkdir(parents=True)
        for path in sorted((DATASETS / "hands" / subset / kind).iterdir())[:4]:
            shutil.copyfile(path, folder / kind / path.name)
    return folder


def tiny_set(hands: pathlib.Path, folder: pathlib.Path, seed: int = 0, n_variants: int = 4) -> AugmentedSet:
    """Write an augmented set of 64 x 48 pixels with ``n_variants`` variants of each image."""
    settings = AugmentationSettings(n_variants=n_variants, width=64, height=48, seed=seed)
    return augment_images(LabeledImageSet.load(hands), folder, settings, DATASETS / "backgrounds", workers=1)


def untrained_ensemble(
    folder: pathlib.Path,
    network: NetworkSettings,
    inference: InferenceSettings,
    seeds: Sequence[int],
    adjust: Callable[[Any, int], None] = lambda network, seed: None,
) -> pathlib.Path:
    """Write one untrained member per seed (``FOLDER/member-SEED``), freeze them and return the frozen folder.

    Args:
        adjust: changes the weights of a network, given its seed.
    """
    members = []
    for seed in seeds:
        made = build_network(network, seed).eval()
        adjust(made, seed)
        about = {"data_digest": "d" * 64, "ensemble_identity": "f" * 64, "seed": seed}
        record = {"settings": {"network": dataclasses.asdict(network)}, **about}
        members.append(Member.write(folder / f"member-{seed}", made, record))
    shape = (inference.height, inference.width, 3)
    golden = np.random.default_rng(seeds[0]).integers(0, 256, shape, dtype=np.uint8)
    return write_frozen_ensemble(members, inference, calibration(len(members)), golden, folder / "frozen")


def tiny_ensemble(folder: pathlib.Path, seed: int = 0) -> pathlib.Path:
    """Freeze one small untrained member."""
    return untrained_ensemble(folder, TINY, TINY_INFERENCE, [seed])


def background_ensemble(folder: pathlib.Path) -> pathlib.Path:
    """Freeze two members that classify every pixel as background, so that motions can be planned."""

    def adjust(network: Any, seed: int) -> None:
        import torch

        *_, last = (module for module in network.modules() if isinstance(module, torch.nn.Conv2d))
        torch.nn.init.zeros_(last.weight)
        torch.nn.init.constant_(last.get_parameter("bias"), -3.0)

    return untrained_ensemble(folder, TINY, TINY_INFERENCE, [0, 1], adjust)


def calibration(n_members: int) -> Calibration:
    """Create a calibration with invented values."""
    return Calibration(4, n_members, 0.9, 0.8, 0.1, 0.3, 0.01, smallest_supported_delta=0.05)


def synthetic_execution(count: int, seed: int) -> Execution:
    """Create an execution of ``count`` samples with random positions, drawn from ``seed``."""
    rng = np.random.default_rng(seed)
    return Execution(
        reference_poses=np.zeros((count, 4)),
        reference_velocities=np.zeros((count, 4)),
        time_s=np.arange(count) / 100,
        phase=np.sort(np.arange(count) % 3 * 2),
        tool_positions_m=rng.normal(size=(count, 3)),
        tool_quaternions=np.tile([0.0, 0.0, 0.0, 1.0], (count, 1)),
        joint_positions_rad=rng.normal(size=(count, 7)),
        torques_nm=rng.normal(size=(count, 7)),
        tool_to_hand_m=np.ones(count),
        arm_to_hand_m=np.ones(count),
        contacts=np.zeros(count, np.int32),
        body=ToolBody(),
        seed=seed,
    )
