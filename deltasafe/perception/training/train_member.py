"""Training of one ensemble member, resumable from a checkpoint (section III-B).

Every random choice is a function of (seed, step). A training that was killed and resumed therefore gives bit-identical
weights, on one machine with one number of threads.
"""

import dataclasses
import math
import pathlib
import time
from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from deltasafe.errors import SettingsError
from deltasafe.io.locks import FileLock
from deltasafe.io.storage import digest_of
from deltasafe.perception.data.augmented_set import AugmentedSet
from deltasafe.perception.data.loader import Batches
from deltasafe.perception.settings import TrainingSettings
from deltasafe.perception.training.checkpoint import Checkpoint
from deltasafe.perception.training.device import pick_device
from deltasafe.perception.training.member import Member
from deltasafe.perception.training.network import build_network, has_pretrained_weights
from deltasafe.perception.training.precision import autocast_on_gpu, convert_to_low_precision, resolve_precision

RECIPE_VERSION = 2
"""Part of a member's identity. Increase it when a change of code trains different weights from the same settings."""
_LOCK_TIMEOUT_S = 30.0
"""A terminated training holds the lock of its folder for some seconds until its process ends."""


@dataclasses.dataclass(frozen=True)
class StepReport:
    """Progress after a step; ``step`` and ``epoch`` count from 1."""

    step: int
    n_steps: int
    epoch: int
    loss: float
    learning_rate: float
    images_per_s: float


def learning_rate(settings: TrainingSettings, step: int, steps_per_epoch: int) -> float:
    """Return the learning rate of ``step``, counted from 0."""
    if settings.schedule == "exponential":
        return settings.peak_learning_rate * settings.epoch_decay ** (step // steps_per_epoch)
    n_steps = settings.epochs * steps_per_epoch
    n_warmup = max(1, round(0.25 * n_steps))
    if step < n_warmup:
        return settings.peak_learning_rate * (0.04 + 0.96 * (1 - math.cos(math.pi * (step + 1) / n_warmup)) / 2)
    return settings.peak_learning_rate * (1 + math.cos(math.pi * (step + 1 - n_warmup) / (n_steps - n_warmup + 1))) / 2


def training_identity(data: AugmentedSet, settings: TrainingSettings, seed: int | None = None) -> str:
    """Return the digest of everything that determines a member; without ``seed``, of what an ensemble shares."""
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
    """Train a member and write it to ``folder``; resumes from a checkpoint there.

    A finished member of the same settings, data and seed is returned unchanged. A checkpoint of other settings, data or
    seed is ignored. The loss is the mean binary cross-entropy over pixels (decision 6). A lock file prevents two
    trainings in one folder.

    Raises:
        SettingsError: the set has fewer images than one batch, or the loss is no longer finite.
        LockedError: another process is training in ``folder`` and does not end within 30 s.
    """
    folder = pathlib.Path(folder)
    identity = training_identity(data, settings, seed)
    if (finished := Member.find(folder, identity)) is not None:
        return finished
    n_images = len(data.images)
    if n_images < settings.batch_size:
        raise SettingsError(f"batch_size {settings.batch_size} exceeds the {n_images} images of the set")
    with FileLock(folder / "training.lock", _LOCK_TIMEOUT_S):
        return Member.find(folder, identity) or _train(data, settings, seed, folder, device, on_step)


def _train(
    data: AugmentedSet,
    settings: TrainingSettings,
    seed: int,
    folder: pathlib.Path,
    device: str,
    on_step: Callable[[StepReport], None] | None,
) -> Member:
    target = pick_device(device)
    precision = resolve_precision(settings.precision, target)
    network = build_network(settings.network, seed).to(target).to(memory_format=torch.channels_last).train()
    convert_to_low_precision(network, precision, target)
    forward = torch.compile(network) if settings.compile else network
    optimizer = torch.optim.AdamW(
        network.parameters(), lr=settings.peak_learning_rate, weight_decay=settings.weight_decay, fused=True
    )
    identity = training_identity(data, settings, seed)
    checkpoint = Checkpoint(folder / "checkpoint.safetensors", identity)
    losses = checkpoint.restore(network, optimizer)

    batches = Batches(data, settings, seed)
    start_s, first_step = time.perf_counter(), len(losses)
    for step in range(first_step, batches.n_steps):
        rate = learning_rate(settings, step, batches.per_epoch)
        images, labels = batches.read(step, target)
        torch.manual_seed(_seed_of_step(seed, step))
        with autocast_on_gpu(precision, target):
            loss = functional.binary_cross_entropy_with_logits(forward(images), labels)
        losses.append(_update(optimizer, rate, loss))
        _require_finite(losses[-1], step, settings)
        done = step + 1
        if on_step is not None:
            images_per_s = settings.batch_size * (done - first_step) / (time.perf_counter() - start_s)
            epoch = step // batches.per_epoch + 1
            on_step(StepReport(done, batches.n_steps, epoch, losses[-1], rate, images_per_s))
        if done % settings.checkpoint_every_steps == 0 and done < batches.n_steps:
            checkpoint.save(network, optimizer, losses)

    record = {
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
    }
    member = Member.write(folder, network.eval(), record)
    checkpoint.discard()
    return member


def _update(optimizer: torch.optim.Optimizer, rate: float, loss: Tensor) -> float:
    """Make one gradient step and return the loss."""
    for group in optimizer.param_groups:
        group["lr"] = rate
    optimizer.zero_grad(set_to_none=True)
    loss.backward()
    optimizer.step()
    return loss.item()


def _require_finite(loss: float, step: int, settings: TrainingSettings) -> None:
    if not math.isfinite(loss):
        raise SettingsError(
            f"the loss became {loss} at step {step}: lower peak_learning_rate "
            f"(now {settings.peak_learning_rate:g}) or use precision float32"
        )


def _seed_of_step(seed: int, step: int) -> int:
    return int(np.random.SeedSequence((seed, step)).generate_state(1, np.uint64)[0] >> 1)
