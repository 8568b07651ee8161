"""A frozen ensemble in each engine against its members called one after another in eager torch.

Both sides do the whole way from an RGB image to p_occupied at its resolution, with the same number of threads.
Members are made from settings and perturbed, not trained: time does not depend on what the weights are.
"""

import argparse
import dataclasses
import functools
import importlib.util
import os
import pathlib
import statistics
import tempfile
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from deltasafe.perception.artifact import FrozenEnsemble, freeze_ensemble, load_ensemble
from deltasafe.perception.calibration import Calibration
from deltasafe.perception.ensemble import Ensemble, probability
from deltasafe.perception.member import Member
from deltasafe.perception.network import SegmentationNetwork, build_network
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from evidence.benchmarks.measuring import conclude, foreign_cores, interleaved, median_ms, parser, say

__all__ = ["main"]

SIZES = ((480, 640), (288, 384))
PLAIN = "members one after another"
_HEAD = 20.0
"""A random head gives probabilities near 0.5, on which anything agrees; enlarged, it spans nearly all of (0, 1)."""


def frozen(n_members: int, network: NetworkSettings, inference: InferenceSettings, root: pathlib.Path) -> pathlib.Path:
    """A frozen ensemble below ``root`` that no one has trained."""
    record = {"settings": {"network": dataclasses.asdict(network)}, "data_digest": "none"}
    members = []
    for seed in range(n_members):
        made = build_network(network, seed).eval()
        random = torch.Generator().manual_seed(seed)
        for parameter in made.parameters():  # members of one pretrained backbone differ after training as well
            parameter.data.mul_(1 + 0.05 * torch.randn(parameter.shape, generator=random))
        head = made.decoder[-1]
        head.weight.data.mul_(_HEAD)  # type: ignore[operator]
        members.append(Member.write(root / f"member-{seed}", made, {**record, "seed": seed}))
    golden = np.random.default_rng(0).integers(0, 256, (inference.height, inference.width, 3), dtype=np.uint8)
    unjudged = Calibration(1, n_members, 0, 0, 0, 0, 0, None)
    return freeze_ensemble(members, inference, unjudged, golden, root / "frozen")


class OneAfterAnother:
    """What one writes first: the image is resized once, then each network is called, sigmoid, mean."""

    def __init__(self, networks: Sequence[SegmentationNetwork], resized: Callable[[Any], Any]) -> None:
        self.networks = networks
        self.resized = resized

    @torch.inference_mode()
    def p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(H, W, 3) uint8 -> (H, W) float32."""
        seen = torch.from_numpy(self.resized(rgb)).permute(2, 0, 1)[None]
        each = [probability(network(seen), rgb.shape[:2])[0] for network in self.networks]
        mean: NDArray[np.float32] = torch.stack(each).mean(dim=0).numpy()
        return mean


def measure(folder: pathlib.Path, sizes: Sequence[tuple[int, int]], repeats: int) -> dict[str, Any]:
    """For each image size and way of asking ``folder``: medians in ms, ratio to eager torch, difference from it."""
    usual = load_ensemble(folder)
    default = usual.engine.name
    engines: dict[str, FrozenEnsemble] = {default: usual}
    for name in ("onnxruntime", "openvino", "torch"):
        if name not in engines and importlib.util.find_spec(name) is not None:
            engines[name] = load_ensemble(folder, engine=name)
    reference: Ensemble = load_ensemble(folder, engine="torch")
    plain = OneAfterAnother([_unchanged(member) for member in reference.members], reference.resized)
    found: dict[str, Any] = {}
    for height, width in sizes:
        rgb = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
        askers: dict[str, Any] = {PLAIN: plain, **engines}
        expected = plain.p_occupied(rgb)
        say(f"{width}x{height}: {repeats} turns of {', '.join(askers)}")
        with foreign_cores() as others:
            programs = {name: functools.partial(asker.p_occupied, rgb) for name, asker in askers.items()}
            seconds = interleaved(programs, repeats)
        found[f"{width}x{height}"] = {
            "foreign_cores": others.cores,
            "default_engine": default,
            "range_of_p_occupied": [float(expected.min()), float(expected.max())],
            "ways": {
                name: {
                    "median_ms": median_ms(taken),
                    "min_ms": 1e3 * min(taken),
                    "ratio": statistics.median(r / v for r, v in zip(seconds[PLAIN], taken, strict=True)),
                    "largest_difference": float(np.abs(askers[name].p_occupied(rgb) - expected).max()),
                }
                for name, taken in seconds.items()
            },
        }
    return found


def _unchanged(member: torch.nn.Module) -> Any:
    """In torch's own memory layout, as networks are before anyone thinks of it."""
    return member.to(memory_format=torch.contiguous_format)


def figures(found: dict[str, Any]) -> dict[str, float]:
    """`inference_ratio` is that of the first size, with the default engine."""
    made: dict[str, float] = {}
    for index, (size, result) in enumerate(found.items()):
        behind = "" if index == 0 else f"_{size}"
        ours, plain = result["ways"][result["default_engine"]], result["ways"][PLAIN]
        made[f"inference_ratio{behind}"] = ours["ratio"]
        made[f"inference_ms{behind}"] = ours["median_ms"]
        made[f"inference_plain_ms{behind}"] = plain["median_ms"]
        made[f"inference_agreement{behind}"] = ours["largest_difference"]
    return made


def main(arguments: list[str] | None = None) -> int:
    """Entry point."""
    options_of = parser(__doc__)
    options_of.add_argument("--members", type=int, default=5, help="M (default 5)")
    options_of.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="of both sides (default: cores)")
    options = options_of.parse_args(arguments)
    before = torch.get_num_threads()
    torch.set_num_threads(options.threads)
    try:
        found = _measured(options)
    finally:
        torch.set_num_threads(before)
    say(f"M = {options.members}, {options.threads} threads, medians of {options.repeats} turns")
    for size, result in found.items():
        for name, way in result["ways"].items():
            default = " (default)" if name == result["default_engine"] else ""
            say(
                f"{size:>9}  {name + default:26}{way['median_ms']:9.1f} ms   x{way['ratio']:5.2f}   "
                f"differs by {way['largest_difference']:.0e}"
            )
        say(f"{'':>9}  other processes kept {result['foreign_cores']:.2f} cores busy meanwhile")
    record = {
        "figures": figures(found),
        "members": f"{options.members}, weights perturbed at random, not trained",
        "seeds": {"members_from": 0, "image": 1},
        "threads": options.threads,
        "repeats": options.repeats,
        "sizes": found,
    }
    conclude(record, options.record, "python -m evidence.benchmarks.inference")
    return 0


def _measured(options: argparse.Namespace) -> dict[str, Any]:
    network = NetworkSettings(pretrained=not options.tiny, pyramid_channels=8 if options.tiny else 128)
    inference = InferenceSettings(64, 48) if options.tiny else InferenceSettings()
    with tempfile.TemporaryDirectory() as scratch:
        say(f"freezing {options.members} members (exported to ONNX once) ...")
        folder = frozen(options.members, network, inference, pathlib.Path(scratch))
        return measure(folder, ((48, 64), (36, 48)) if options.tiny else SIZES, options.repeats)


if __name__ == "__main__":
    raise SystemExit(main())
