"""Train the network and recipe of the `paper` preset on few images, and project the cost of the whole preset.

Trains one epoch on one augmented image of each packaged image, with the training loop of the preset. The projections
use the measured time of a step for this CPU, and the number of operations and an assumed speed for a GPU.
"""

import argparse
import dataclasses
import itertools
import pathlib
import resource
import statistics
import sys
import tempfile
import time
from typing import Any

import torch

from deltasafe.perception.data.augmented_set import augment_images
from deltasafe.perception.data.labeled_images import LabeledImageSet
from deltasafe.perception.training.network import build_network, has_pretrained_weights
from deltasafe.perception.training.precision import resolve_precision
from deltasafe.perception.training.train_ensemble import MemberJob, train_members
from deltasafe.presets import PRESETS, Preset
from evidence.benchmarks.flops import training_flops
from evidence.benchmarks.measuring import benchmark_parser, foreign_cores
from evidence.fixtures import first_hands
from evidence.reporting import finish
from pipelines.home import DATASETS

PAPER = PRESETS["paper"]
GPU_TFLOP_PER_S = 20.0
"""Assumed for a data-center GPU in bfloat16 with batches of two: about a sixteenth of the A100's nominal 312."""


def projection(
    n_images: int, preset: Preset, step_s: float, flops_per_image: float, gpu_tflop_per_s: float
) -> dict[str, float]:
    """Project the hours of all members and epochs of a preset on ``n_images`` augmented images."""
    n_steps = preset.n_members * preset.training.epochs * (n_images // preset.training.batch_size)
    flops = flops_per_image * n_steps * preset.training.batch_size
    return {
        "paper_preset_projected_steps": n_steps,
        "paper_preset_projected_cpu_hours": n_steps * step_s / 3600,
        "paper_preset_projected_gpu_hours": flops / (1e12 * gpu_tflop_per_s) / 3600,
    }


def measure(options: argparse.Namespace, folder: pathlib.Path) -> tuple[dict[str, float], dict[str, Any]]:
    """Train one member; return figures and the details that explain them."""
    augmentation = dataclasses.replace(PAPER.augmentation, n_variants=1)
    training = dataclasses.replace(PAPER.training, epochs=1)
    if options.tiny:
        augmentation = dataclasses.replace(augmentation, width=64, height=48)
        training = dataclasses.replace(training, network=dataclasses.replace(training.network, pyramid_channels=8))
    hands = first_hands(options.images)
    print(f"augmenting {len(hands)} images ...", flush=True)
    data = augment_images(hands, folder / "augmented", augmentation, DATASETS / "backgrounds", workers=1)
    times: list[float] = []

    def on_step(_: str, step: Any) -> None:
        times.append(time.perf_counter())
        rate = f"{step.images_per_s:.2f} images/s"
        print(f"step {step.step} of {step.n_steps}, loss {step.loss:.3f}, {rate}", flush=True)

    # one process with all cores, so that its memory is that of the largest child process
    job = MemberJob("paper", 0, folder / "member")
    with foreign_cores() as others:
        members = train_members([job], data.folder, training, device="cpu", workers=1, on_step=on_step)
    n_images = len(LabeledImageSet.load(DATASETS / "hands" / "train")) * PAPER.augmentation.n_variants
    flops = training_flops(build_network(training.network, 0), augmentation.height, augmentation.width)
    step_s = statistics.median(b - a for a, b in itertools.pairwise(times))
    losses = members[job.name].losses
    fifth = max(1, len(losses) // 5)
    figures = {
        "paper_preset_s_per_step": step_s,
        "paper_preset_images_per_s": training.batch_size * (len(times) - 1) / (times[-1] - times[0]),
        "paper_preset_peak_memory_gb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9,
        "paper_preset_loss_first": losses[0],
        "paper_preset_loss_last": losses[-1],
        "paper_preset_loss_first_fifth": statistics.mean(losses[:fifth]),
        "paper_preset_loss_last_fifth": statistics.mean(losses[-fifth:]),
        "paper_preset_gflop_an_image": flops / 1e9,
        "paper_preset_sustained_gflop_per_s": flops * training.batch_size / step_s / 1e9,
        **projection(n_images, PAPER, step_s, flops, options.gpu_tflops),
    }
    details = {
        "images": len(hands),
        "image_size": [augmentation.width, augmentation.height],
        "steps": len(times),
        "threads": "one process with all cores",
        "precision": resolve_precision(training.precision, torch.device("cpu")),
        "pretrained_weights": has_pretrained_weights(training.network),
        "losses": losses,
        "recipe": dataclasses.asdict(training),
        "projection": {
            "of": f"{n_images} images x {PAPER.training.epochs} epochs x {PAPER.n_members} members; training alone",
            "cpu": "median time of a step times the number of steps, members in sequence",
            "gpu": f"not measured: number of operations at an assumed {options.gpu_tflops:g} TFLOP/s sustained",
        },
        "foreign_cores": others.cores,
        "seeds": {"augmentation": augmentation.seed, "member": job.seed},
    }
    return figures, details


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.benchmarks.paper_preset``."""
    parser = benchmark_parser("paper_preset", __doc__)
    parser.add_argument("--images", type=int, default=50, help="packaged images to augment once (default 50)")
    parser.add_argument(
        "--gpu-tflops",
        type=float,
        default=GPU_TFLOP_PER_S,
        help="assumed sustained speed of a GPU (default %(default)s)",
    )
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        figures, details = measure(options, pathlib.Path(folder))
    print(f"projection of {details['projection']['of']}; GPU {details['projection']['gpu']}")
    return finish(options, figures, **details)


if __name__ == "__main__":
    sys.exit(main())
