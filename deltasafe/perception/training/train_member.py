"""Training one ensemble member: plain loop, data already in memory maps, never lost (section III-B).

Every random choice is a function of (seed, step), so a training that was killed and resumed ends bit by bit
where an uninterrupted one ends (on one machine with one number of threads).
"""

import dataclasses
import math
import pathlib
import time
from collections.abc import Callable

import numpy as np
import torch
from torch.nn import functional

from deltasafe.errors import SettingsError
from deltasafe.io.locks import FileLock
from deltasafe.io.storage import digest_of
from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.data.loader import Batches
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training.checkpoint import Checkpoint
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network, has_pretrained_weights
from deltasafe.perception.training.precision import multiplying, prepare, resolve_precision

__all__ = [
    "StepReport",
    "learning_rate",
    "pick_device",
    "train_member",
    "training_identity",
]


RECIPE_VERSION = 2
"""Raised by a change of network or loop that trains other members from the same settings."""
_PATIENCE_S = 30.0
"""Wait for the lock of a member's folder: a terminated training takes seconds to end."""


@dataclasses.dataclass(frozen=True)
class StepReport:
    """What the callback of `train_member` hears after each step."""

    step: int
    n_steps: int
    epoch: int
    loss: float
    learning_rate: float
    images_per_s: float


def learning_rate(settings: TrainingSettings, step: int, steps_per_epoch: int) -> float:
    """Learning rate at ``step`` (from 0)."""
    if settings.schedule == "exponential":
        return settings.peak_learning_rate * settings.epoch_decay ** (step // steps_per_epoch)
    n_steps = settings.epochs * steps_per_epoch
    turn = max(1, round(0.25 * n_steps))
    if step < turn:
        return settings.peak_learning_rate * (0.04 + 0.96 * (1 - math.cos(math.pi * (step + 1) / turn)) / 2)
    return settings.peak_learning_rate * (1 + math.cos(math.pi * (step + 1 - turn) / (n_steps - turn + 1))) / 2


def pick_device(name: str = "auto") -> torch.device:
    """``auto`` is the first CUDA device where there is one, the CPU otherwise."""
    if name == "auto":
        name = "cuda" if torch.cuda.is_available() else "cpu"
    return torch.device(name)


def training_identity(data: AugmentedSet, settings: TrainingSettings, seed: int | None = None) -> str:
    """Digest of all that determines a member; without ``seed``, of all that the members of an ensemble share."""
    return digest_of(
        {
            "recipe": RECIPE_VERSION,
            "settings": settings,
            "pretrained": has_pretrained_weights(settings.network),
            "data": data.digest,
            "seed": seed,
        }
    )


def train_member(
    data: AugmentedSet,
    settings: TrainingSettings,
    seed: int,
    folder: str | pathlib.Path,
    device: str = "auto",
    on_step: Callable[[StepReport], None] | None = None,
) -> Member:
    """Train the member of ``seed`` and write it to ``folder``; goes on from a checkpoint left there.

    A finished member of the same settings, data and seed is returned as it is. A checkpoint of other settings,
    data or seed is discarded. The loss is binary cross-entropy, averaged over pixels (decision 6). A lock file in
    ``folder`` keeps a second training out while this one runs.

    Raises:
        SettingsError: the set has fewer images than one batch, or the loss is no longer finite.
        LockedError: another process trains in ``folder``, and did not end within half a minute.
    """
    folder = pathlib.Path(folder)
    identity = training_identity(data, settings, seed)
    if (finished := Member.find(folder, identity)) is not None:
        return finished
    n_images = len(data.images)
    if n_images < settings.batch_size:
        raise SettingsError(f"batch_size {settings.batch_size} exceeds the {n_images} images of the set")
    with FileLock(folder / "training.lock", _PATIENCE_S):
        return Member.find(folder, identity) or _train(data, settings, seed, folder, device, on_step)


def _train(
    data: AugmentedSet,
    settings: TrainingSettings,
    seed: int,
    folder: pathlib.Path,
    device: str,
    on_step: Callable[[StepReport], None] | None,
) -> Member:
    identity = training_identity(data, settings, seed)
    target = pick_device(device)
    network = build_network(settings.network, seed).to(target).to(memory_format=torch.channels_last).train()
    precision = resolve_precision(settings.precision, target)
    prepare(network, precision, target)
    forward = torch.compile(network) if settings.compile else network
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=settings.peak_learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    checkpoint = Checkpoint(folder / "checkpoint.safetensors", identity)
    losses: list[float] = checkpoint.restore(network, optimizer)

    batches = Batches(data, settings, seed)
    n_steps = batches.n_steps
    began_s, began_step = time.perf_counter(), len(losses)
    for step in range(len(losses), n_steps):
        rate = learning_rate(settings, step, batches.per_epoch)
        for group in optimizer.param_groups:
            group["lr"] = rate
        images, labels = batches.read(step, target)
        torch.manual_seed(_mix(seed, step))
        with multiplying(precision, target):
            loss = functional.binary_cross_entropy_with_logits(forward(images), labels)
        optimizer.zero_grad(set_to_none=True)
        loss.backward()
        optimizer.step()
        losses.append(loss.item())
        if not math.isfinite(losses[-1]):
            raise SettingsError(
                f"the loss became {losses[-1]} at step {step}: lower peak_learning_rate "
                f"(now {settings.peak_learning_rate:g}) or use precision float32"
            )
        done = step + 1
        if on_step is not None:
            speed = settings.batch_size * (done - began_step) / (time.perf_counter() - began_s)
            on_step(StepReport(done, n_steps, step // batches.per_epoch + 1, losses[-1], rate, speed))
        if done % settings.checkpoint_every_steps == 0 and done < n_steps:
            checkpoint.save(network, optimizer, losses)

    member = Member.write(
        folder,
        network.eval(),
        {
            "identity": identity,
            "ensemble_identity": training_identity(data, settings),
            "seed": seed,
            "settings": dataclasses.asdict(settings),
            "precision": precision,
            "data_digest": data.digest,
            "image_size": [data.images.shape[2], data.images.shape[1]],
            "pretrained_weights": has_pretrained_weights(settings.network),
            "losses": losses,
            "steps_per_epoch": batches.per_epoch,
        },
    )
    checkpoint.discard()
    return member


def _mix(seed: int, number: int) -> int:
    return int(np.random.SeedSequence((seed, number)).generate_state(1, np.uint64)[0] >> 1)
