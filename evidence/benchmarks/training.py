"""Images/s of our training loop against the loop that one writes first, in turns, and its share of the machine's peak.

Ours trains members side by side, one process a core, from memory-mapped arrays; the plain loop trains one after another
with all cores (`evidence.benchmarks.plain_training`). Network, images, batches and recipe are the same. Time is counted
between steps: neither start of processes nor the first step of a member is in it.
"""

import argparse
import dataclasses
import os
import pathlib
import statistics
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Mapping
from typing import Any

import torch

from deltasafe.perception.augmentation import AugmentationSettings
from deltasafe.perception.augmented_set import AugmentedSet, write_augmented_set
from deltasafe.perception.ensemble_training import MemberJob, train_members
from deltasafe.perception.hands import HandSet
from deltasafe.perception.network import build_network
from deltasafe.perception.precision import resolved_precision
from deltasafe.perception.settings import NetworkSettings, TrainingSettings
from deltasafe.presets import PRESETS
from evidence.benchmarks.flops import training_flops
from evidence.benchmarks.measuring import conclude, foreign_cores, matmul_peak, parser, say
from evidence.benchmarks.plain_training import PngHands, plain_training, write_pngs
from pipelines.home import DATASETS

__all__ = ["images_per_s_in_turn", "images_per_s_side_by_side", "main"]

Times = Mapping[str, list[float]]


def images_per_s_side_by_side(times: Times, batch_size: int) -> float:
    """Images/s of all members together, from the times of their steps, while all of them train.

    Whoever trains before the others have begun, or after they have ended, has more of the machine; that is left out,
    and so is the first step of each.

    Raises:
        ValueError: there was no time with two steps of each member: more steps are needed.
    """
    begin, end = max(each[0] for each in times.values()), min(each[-1] for each in times.values())
    rate = 0.0
    for name, each in times.items():
        within = [t for t in each if begin <= t <= end]
        if len(within) < 2:
            raise ValueError(f"{name} made {len(within)} steps while all members trained; take more --steps")
        rate += batch_size * (len(within) - 1) / (within[-1] - within[0])
    return rate


def images_per_s_in_turn(times: Times, batch_size: int) -> float:
    """Images/s of members one after another, from the times of their steps; the first step of each is left out."""
    elapsed_s = sum(each[-1] - each[0] for each in times.values())
    return batch_size * sum(len(each) - 1 for each in times.values()) / elapsed_s


@dataclasses.dataclass(frozen=True)
class Bench:
    """Data, recipe and members, the same for every loop."""

    data: AugmentedSet
    pngs: PngHands
    recipe: TrainingSettings
    n_members: int
    scratch: pathlib.Path

    @classmethod
    def prepare(cls, options: argparse.Namespace, scratch: pathlib.Path) -> "Bench":
        """As many augmented images of the packaged hands as the steps need."""
        preset = PRESETS["default"]
        augmentation, recipe = preset.augmentation, dataclasses.replace(preset.training, epochs=1)
        if options.tiny:
            augmentation = AugmentationSettings(width=64, height=48, supersampling=1)
            recipe = dataclasses.replace(recipe, network=NetworkSettings(pretrained=False, pyramid_channels=8))
            recipe = dataclasses.replace(recipe, batch_size=2, precision="float32")
        hands = HandSet.load(DATASETS / "hands" / "train")
        needed = recipe.batch_size * (options.steps + 1)
        n_hands = min(len(hands), needed)
        hands = dataclasses.replace(hands, items=hands.items[:n_hands], pixel_digests=hands.pixel_digests[:n_hands])
        augmentation = dataclasses.replace(augmentation, n_variants=-(-needed // n_hands))
        say(f"augmenting {n_hands} images to {n_hands * augmentation.n_variants} ...")
        data = write_augmented_set(hands, DATASETS / "backgrounds", augmentation, scratch / "augmented", workers=1)
        write_pngs(data, scratch / "png")
        return cls(data, PngHands(scratch / "png"), recipe, options.members, scratch)

    def ours(self, small_share: float, precision: str = "auto") -> float:
        """Images/s of `train_members`; ``small_share`` is 0 (all images whole) or 1 (all reduced)."""
        settings = dataclasses.replace(self.recipe, small_share=small_share, precision=precision)
        times: dict[str, list[float]] = defaultdict(list)
        with tempfile.TemporaryDirectory(dir=self.scratch) as folder:
            jobs = [MemberJob(f"m{i}", i, pathlib.Path(folder) / f"m{i}") for i in range(self.n_members)]
            train_members(
                jobs,
                self.data.folder,
                settings,
                device="cpu",
                workers=self.n_members,
                on_step=lambda name, _: times[name].append(time.perf_counter()),
            )
        return images_per_s_side_by_side(times, settings.batch_size)

    def plain(self) -> float:
        """Images/s of `plain_training`."""
        times: dict[str, list[float]] = defaultdict(list)
        plain_training(
            self.pngs,
            self.recipe,
            tuple(range(self.n_members)),
            lambda seed, _, __: times[str(seed)].append(time.perf_counter()),
        )
        return images_per_s_in_turn(times, self.recipe.batch_size)


def measure(bench: Bench, repeats: int) -> dict[str, list[float]]:
    """Images/s of each loop, called in turns."""
    loops: dict[str, Callable[[], float]] = {
        "ours": lambda: bench.ours(0.0),
        "plain": bench.plain,
        "ours, small images": lambda: bench.ours(1.0),
    }
    if resolved_precision(bench.recipe.precision, torch.device("cpu")) != "float32":
        loops["ours in float32"] = lambda: bench.ours(0.0, "float32")
    rates: dict[str, list[float]] = {name: [] for name in loops}
    for turn in range(repeats):
        for name, loop in loops.items():
            rates[name].append(loop())
            say(f"turn {turn + 1} of {repeats}: {name:20}{rates[name][-1]:8.2f} images/s")
    return rates


def figures(rates: Mapping[str, list[float]], recipe: TrainingSettings) -> dict[str, float]:
    """Medians over turns; a ratio is the median of the turns' ratios."""

    def ratio(of: list[float]) -> float:
        return statistics.median(ours / plain for ours, plain in zip(of, rates["plain"], strict=True))

    # time an image, weighted by how many steps see it small
    mixed = [
        1 / (recipe.small_share / small + (1 - recipe.small_share) / whole)
        for small, whole in zip(rates["ours, small images"], rates["ours"], strict=True)
    ]
    made = {
        "training_ratio": ratio(rates["ours"]),
        "training_ratio_recipe": ratio(mixed),
        "training_images_per_s": statistics.median(rates["ours"]),
        "training_images_per_s_recipe": statistics.median(mixed),
        "training_plain_images_per_s": statistics.median(rates["plain"]),
    }
    if "ours in float32" in rates:
        made["training_ratio_float32"] = ratio(rates["ours in float32"])
    return made


def peak_shares(
    rates: Mapping[str, list[float]], recipe: TrainingSettings, size: tuple[int, int], order: int
) -> tuple[dict[str, float], dict[str, Any]]:
    """Figures: FLOP/s of the loops as shares of those of large matrices. Details: what they are made of."""
    precision = resolved_precision(recipe.precision, torch.device("cpu"))
    flops = training_flops(build_network(recipe.network, 0), *size)
    peaks = {str(kind).split(".")[1]: matmul_peak(kind, order) for kind in (torch.float32, torch.bfloat16)}
    ours, plain = statistics.median(rates["ours"]), statistics.median(rates["plain"])
    shares = {
        "training_peak_share": ours * flops / peaks[precision],
        "training_peak_share_of_float32": ours * flops / peaks["float32"],
        "training_plain_peak_share": plain * flops / peaks["float32"],
    }
    details = {"precision": precision, "gflop_an_image": flops / 1e9, "peak_gflop_per_s": {}}
    details["peak_gflop_per_s"] = {name: peak / 1e9 for name, peak in peaks.items()}
    return shares, details


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options_of = parser(__doc__)
    options_of.set_defaults(repeats=5)
    options_of.add_argument("--steps", type=int, default=24, help="counted steps a member and turn (default 24)")
    options_of.add_argument("--members", type=int, default=os.cpu_count() or 1, help="members (default: one a core)")
    options = options_of.parse_args(arguments)
    with tempfile.TemporaryDirectory() as folder:
        bench = Bench.prepare(options, pathlib.Path(folder))
        height, width = bench.data.images.shape[1:3]
        with foreign_cores() as others:
            rates = measure(bench, options.repeats)
        shares, details = peak_shares(rates, bench.recipe, (height, width), 128 if options.tiny else 4096)
    found = figures(rates, bench.recipe) | shares
    say(f"{options.members} members, {width} x {height}, batches of {bench.recipe.batch_size}, medians")
    for name, value in found.items():
        say(f"  {name:34}{value:9.3f}")
    say(f"  ours multiplies in {details['precision']}; {details['gflop_an_image']:.1f} GFLOP an image")
    say(f"  other processes kept {others.cores:.2f} cores busy meanwhile")
    record = {
        "figures": found,
        **details,
        "images_per_s": rates,
        "image_size": [width, height],
        "members": options.members,
        "steps": options.steps,
        "repeats": options.repeats,
        "threads_of_plain": torch.get_num_threads(),
        "recipe": dataclasses.asdict(bench.recipe),
        "seeds": {"augmentation": bench.data.settings.seed, "members_from": 0},
        "foreign_cores": others.cores,
    }
    conclude(record, options.record, "python -m evidence.benchmarks.training")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
