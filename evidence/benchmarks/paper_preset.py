"""The `paper` preset's network and recipe trained for real on few images, and what the whole preset would cost.

One epoch on one augmented image of each packaged hand, by the loop that the preset itself would use. The costs of
the whole preset are projections: on this CPU from the measured time a step, on a GPU from the number of operations
and an assumed speed.
"""

import argparse
import dataclasses
import itertools
import pathlib
import resource
import statistics
import tempfile
import time
from typing import Any

import torch

from deltasafe.perception.augmented_set import write_augmented_set
from deltasafe.perception.ensemble_training import MemberJob, train_members
from deltasafe.perception.hands import HandSet
from deltasafe.perception.network import build_network, pretrained_weights_at_hand
from deltasafe.perception.precision import resolved_precision
from deltasafe.presets import PRESETS, Preset
from evidence.benchmarks.flops import training_flops
from evidence.benchmarks.measuring import conclude, foreign_cores, parser, say
from pipelines.home import DATASETS

__all__ = ["main", "projection"]

PAPER = PRESETS["paper"]
GPU_TFLOP_PER_S = 20.0
"""Assumed of a data-centre GPU in bfloat16 at batches of two: about a sixteenth of an A100's stated 312."""


def projection(
    n_images: int, preset: Preset, step_s: float, flops_an_image: float, gpu_tflop_per_s: float
) -> dict[str, float]:
    """Hours of the whole preset on ``n_images`` augmented images, all members and epochs."""
    n_steps = preset.n_members * preset.training.epochs * (n_images // preset.training.batch_size)
    total = flops_an_image * n_steps * preset.training.batch_size
    return {
        "paper_preset_projected_steps": n_steps,
        "paper_preset_projected_cpu_hours": n_steps * step_s / 3600,
        "paper_preset_projected_gpu_hours": total / (1e12 * gpu_tflop_per_s) / 3600,
    }


def measure(options: argparse.Namespace, scratch: pathlib.Path) -> tuple[dict[str, float], dict[str, Any]]:
    """Figures of one training, and what explains them."""
    hands = HandSet.load(DATASETS / "hands" / "train")
    augmentation = dataclasses.replace(PAPER.augmentation, n_variants=1)
    training = dataclasses.replace(PAPER.training, epochs=1)
    if options.tiny:
        augmentation = dataclasses.replace(augmentation, width=64, height=48)
        training = dataclasses.replace(training, network=dataclasses.replace(training.network, pyramid_channels=8))
    some = dataclasses.replace(
        hands, items=hands.items[: options.images], pixel_digests=hands.pixel_digests[: options.images]
    )
    say(f"augmenting {len(some)} images ...")
    data = write_augmented_set(some, DATASETS / "backgrounds", augmentation, scratch / "augmented", workers=1)
    times: list[float] = []

    def hear(_: str, step: Any) -> None:
        times.append(time.perf_counter())
        say(f"step {step.step} of {step.n_steps}, loss {step.loss:.3f}, {step.images_per_s:.2f} images/s")

    # one process with all cores: its memory is that of the largest child
    job = MemberJob("paper", 0, scratch / "member")
    with foreign_cores() as others:
        members = train_members([job], data.folder, training, device="cpu", workers=1, on_step=hear)
    member = members[job.name]
    steps_s = [b - a for a, b in itertools.pairwise(times)]
    flops = training_flops(build_network(training.network, 0), augmentation.height, augmentation.width)
    median_s, losses = statistics.median(steps_s), member.losses
    figures = {
        "paper_preset_s_per_step": median_s,
        "paper_preset_images_per_s": training.batch_size * len(steps_s) / (times[-1] - times[0]),
        "paper_preset_peak_memory_gb": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss * 1024 / 1e9,
        "paper_preset_loss_first": losses[0],
        "paper_preset_loss_last": losses[-1],
        "paper_preset_loss_first_fifth": statistics.mean(losses[: max(1, len(losses) // 5)]),
        "paper_preset_loss_last_fifth": statistics.mean(losses[-max(1, len(losses) // 5) :]),
        "paper_preset_gflop_an_image": flops / 1e9,
        "paper_preset_sustained_gflop_per_s": flops * training.batch_size / median_s / 1e9,
        **projection(len(hands) * PAPER.augmentation.n_variants, PAPER, median_s, flops, options.gpu_tflops),
    }
    details = {
        "images": len(some),
        "image_size": [augmentation.width, augmentation.height],
        "steps": len(times),
        "threads": "one process with all cores",
        "precision": resolved_precision(training.precision, torch.device("cpu")),
        "pretrained_weights": pretrained_weights_at_hand(training.network),
        "losses": losses,
        "recipe": dataclasses.asdict(training),
        "projection": {
            "of": f"{len(hands) * PAPER.augmentation.n_variants} images x {PAPER.training.epochs} epochs x "
            f"{PAPER.n_members} members; training alone",
            "cpu": "the measured median time a step times the number of steps, members one after another",
            "gpu": f"not measured: the operations at an assumed {options.gpu_tflops:g} TFLOP/s sustained",
        },
        "foreign_cores": others.cores,
        "seeds": {"augmentation": augmentation.seed, "member": job.seed},
    }
    return figures, details


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options_of = parser(__doc__)
    options_of.add_argument(
        "--images", type=int, default=50, help="originals, one augmented image of each (default 50)"
    )
    options_of.add_argument(
        "--gpu-tflops", type=float, default=GPU_TFLOP_PER_S, help="assumed of a GPU (default %(default)s), sustained"
    )
    options = options_of.parse_args(arguments)
    with tempfile.TemporaryDirectory() as scratch:
        figures, details = measure(options, pathlib.Path(scratch))
    for name, value in figures.items():
        say(f"  {name:40}{value:12.4g}")
    say(f"  projected: {details['projection']['of']}")
    say(f"  GPU {details['projection']['gpu']}")
    conclude({"figures": figures, **details}, options.record, "python -m evidence.benchmarks.paper_preset")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
