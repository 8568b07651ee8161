"""Time our training loop against a plain loop in turn, and relate both to the machine's matrix-multiplication peak.

Ours trains members in parallel, one process per core, from memory-mapped arrays. The baseline
(`evidence.benchmarks.plain_training`) trains them in sequence with all cores. Network, images, batches and recipe are
the same. Time is counted between steps, without the start of processes and the first step of each member.
"""

import argparse
import dataclasses
import os
import pathlib
import statistics
import sys
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

import torch

from deltasafe.perception.data.augmentation import AugmentationSettings
from deltasafe.perception.data.augmented_set import AugmentedSet, augment_images
from deltasafe.perception.settings import NetworkSettings, TrainingSettings
from deltasafe.perception.training.network import build_network
from deltasafe.perception.training.precision import resolve_precision
from deltasafe.perception.training.train_ensemble import MemberJob, train_members
from deltasafe.presets import PRESETS
from evidence.benchmarks.flops import training_flops
from evidence.benchmarks.measuring import benchmark_parser, foreign_cores, matmul_peak
from evidence.benchmarks.plain_training import PngHands, plain_training, write_pngs
from evidence.fixtures import first_hands
from evidence.reporting import finish
from pipelines.home import DATASETS

Times = Mapping[str, list[float]]


def parallel_images_per_s(times: Times, batch_size: int) -> float:
    """Return images/s of all members together from the times of their steps, while all of them train.

    The first step of each member is left out, and so is the time in which only some members train, because they then
    have more cores.

    Raises:
        ValueError: a member made fewer than two steps in that time.
    """
    begin, end = max(each[0] for each in times.values()), min(each[-1] for each in times.values())
    rate = 0.0
    for name, each in times.items():
        within = [t for t in each if begin <= t <= end]
        if len(within) < 2:
            raise ValueError(f"{name} made {len(within)} steps while all members trained; use more --steps")
        rate += batch_size * (len(within) - 1) / (within[-1] - within[0])
    return rate


def sequential_images_per_s(times: Times, batch_size: int) -> float:
    """Return images/s of members in sequence from the times of their steps, without the first step of each."""
    elapsed_s = sum(each[-1] - each[0] for each in times.values())
    return batch_size * sum(len(each) - 1 for each in times.values()) / elapsed_s


@dataclasses.dataclass(frozen=True)
class Bench:
    """Data, recipe and number of members, the same for all loops."""

    data: AugmentedSet
    pngs: PngHands
    recipe: TrainingSettings
    n_members: int
    folder: pathlib.Path

    @classmethod
    def prepare(cls, options: argparse.Namespace, folder: pathlib.Path) -> "Bench":
        """Write as many augmented images as the steps need."""
        preset = PRESETS["default"]
        augmentation, recipe = preset.augmentation, dataclasses.replace(preset.training, epochs=1)
        if options.tiny:
            network = NetworkSettings(pretrained=False, pyramid_channels=8)
            augmentation = AugmentationSettings(width=64, height=48, supersampling=1)
            recipe = dataclasses.replace(recipe, network=network, batch_size=2, precision="float32")
        needed = recipe.batch_size * (options.steps + 1)
        hands = first_hands(needed)
        augmentation = dataclasses.replace(augmentation, n_variants=-(-needed // len(hands)))
        print(f"augmenting {len(hands)} images to {len(hands) * augmentation.n_variants} ...", flush=True)
        data = augment_images(hands, folder / "augmented", augmentation, DATASETS / "backgrounds", workers=1)
        write_pngs(data, folder / "png")
        return cls(data, PngHands(folder / "png"), recipe, options.members, folder)

    def ours(self, small_share: float, precision: str = "auto") -> float:
        """Return images/s of `train_members`; ``small_share`` is 0 (full size) or 1 (reduced images)."""
        settings = dataclasses.replace(self.recipe, small_share=small_share, precision=precision)
        times: dict[str, list[float]] = defaultdict(list)

        def on_step(name: str, step: object) -> None:
            times[name].append(time.perf_counter())

        with tempfile.TemporaryDirectory(dir=self.folder) as folder:
            jobs = [MemberJob(f"m{i}", i, pathlib.Path(folder) / f"m{i}") for i in range(self.n_members)]
            train_members(jobs, self.data.folder, settings, device="cpu", workers=self.n_members, on_step=on_step)
        return parallel_images_per_s(times, settings.batch_size)

    def plain(self) -> float:
        """Return images/s of `plain_training`."""
        times: dict[str, list[float]] = defaultdict(list)

        def on_step(seed: int, step: int, loss: float) -> None:
            times[str(seed)].append(time.perf_counter())

        plain_training(self.pngs, self.recipe, tuple(range(self.n_members)), on_step)
        return sequential_images_per_s(times, self.recipe.batch_size)


def measure(bench: Bench, repeats: int) -> dict[str, list[float]]:
    """Return images/s of each loop, called in turn."""
    loops: dict[str, Callable[[], float]] = {
        "ours": lambda: bench.ours(0.0),
        "plain": bench.plain,
        "ours, small images": lambda: bench.ours(1.0),
    }
    if resolve_precision(bench.recipe.precision, torch.device("cpu")) != "float32":
        loops["ours in float32"] = lambda: bench.ours(0.0, "float32")
    rates: dict[str, list[float]] = {name: [] for name in loops}
    for repeat in range(1, repeats + 1):
        for name, loop in loops.items():
            rates[name].append(loop())
            print(f"repeat {repeat} of {repeats}: {name:20}{rates[name][-1]:8.2f} images/s", flush=True)
    return rates


def rate_figures(rates: Mapping[str, list[float]], recipe: TrainingSettings) -> dict[str, float]:
    """Return medians over repeats; a ratio is the median of the ratios of each repeat."""

    def ratio(of: list[float]) -> float:
        return statistics.median(ours / plain for ours, plain in zip(of, rates["plain"], strict=True))

    # time per image, weighted by the fraction of steps with small images
    mixed = [
        1 / (recipe.small_share / small + (1 - recipe.small_share) / whole)
        for small, whole in zip(rates["ours, small images"], rates["ours"], strict=True)
    ]
    figures = {
        "training_ratio": ratio(rates["ours"]),
        "training_ratio_recipe": ratio(mixed),
        "training_images_per_s": statistics.median(rates["ours"]),
        "training_images_per_s_recipe": statistics.median(mixed),
        "training_plain_images_per_s": statistics.median(rates["plain"]),
    }
    if "ours in float32" in rates:
        figures["training_ratio_float32"] = ratio(rates["ours in float32"])
    return figures


def peak_figures(
    rates: Mapping[str, list[float]], recipe: TrainingSettings, size: tuple[int, int], matrix_size: int
) -> tuple[dict[str, float], dict[str, Any]]:
    """Return FLOP/s of the loops as fractions of the matrix-multiplication peak, and the underlying numbers."""
    precision = resolve_precision(recipe.precision, torch.device("cpu"))
    flops = training_flops(build_network(recipe.network, 0), *size)
    peaks = {str(kind).split(".")[1]: matmul_peak(kind, matrix_size) for kind in (torch.float32, torch.bfloat16)}
    ours, plain = statistics.median(rates["ours"]), statistics.median(rates["plain"])
    figures = {
        "training_peak_share": ours * flops / peaks[precision],
        "training_peak_share_of_float32": ours * flops / peaks["float32"],
        "training_plain_peak_share": plain * flops / peaks["float32"],
    }
    peak_gflop_per_s = {name: peak / 1e9 for name, peak in peaks.items()}
    details = {"precision": precision, "gflop_an_image": flops / 1e9, "peak_gflop_per_s": peak_gflop_per_s}
    return figures, details


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.benchmarks.training``."""
    parser = benchmark_parser("training", __doc__, repeats=5)
    parser.add_argument("--steps", type=int, default=24, help="counted steps per member and repeat (default 24)")
    parser.add_argument("--members", type=int, default=os.cpu_count() or 1, help="members (default: one per core)")
    options = parser.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench.prepare(options, pathlib.Path(folder))
        height, width = bench.data.images.shape[1:3]
        with foreign_cores() as others:
            rates = measure(bench, options.repeats)
        peaks, details = peak_figures(rates, bench.recipe, (height, width), 128 if options.tiny else 4096)
    print(
        f"{options.members} members, {width} x {height}, batches of {bench.recipe.batch_size}, {details['precision']}"
    )
    print(f"{others.cores:.2f} cores were busy with other processes")
    return finish(
        options,
        rate_figures(rates, bench.recipe) | peaks,
        seeds={"augmentation": bench.data.settings.seed, "members_from": 0},
        **details,
        images_per_s=rates,
        image_size=[width, height],
        members=options.members,
        steps=options.steps,
        repeats=options.repeats,
        threads_of_plain=torch.get_num_threads(),
        recipe=dataclasses.asdict(bench.recipe),
        foreign_cores=others.cores,
    )


if __name__ == "__main__":
    sys.exit(main())
