"""Time a frozen ensemble with each inference backend against its members called in sequence in eager torch.

All methods map an RGB image to p_occupied at the resolution of the image, with the same number of threads. The members
are untrained with perturbed weights, because the time does not depend on the weights.
"""

import argparse
import functools
import importlib.util
import os
import pathlib
import statistics
import sys
import tempfile
from collections.abc import Sequence
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from deltasafe.perception.artifact.frozen_ensemble import FrozenEnsemble, load_ensemble
from deltasafe.perception.inference.ensemble import Ensemble, probability
from deltasafe.perception.settings import InferenceSettings, NetworkSettings
from deltasafe.perception.training.network import SegmentationNetwork
from evidence.benchmarks.measuring import benchmark_parser, foreign_cores, interleaved, median_ms
from evidence.fixtures import untrained_ensemble
from evidence.reporting import finish

SIZES = ((480, 640), (288, 384))
BASELINE = "members in sequence"
HEAD_SCALE = 20.0
"""An untrained head gives probabilities near 0.5, on which all methods agree; scaled, they span nearly (0, 1)."""


def _perturb(network: Any, seed: int) -> None:
    """Perturb all weights, because members with one pretrained backbone differ after training as well."""
    random = torch.Generator().manual_seed(seed)
    for parameter in network.parameters():
        parameter.data.mul_(1 + 0.05 * torch.randn(parameter.shape, generator=random))
    network.decoder[-1].weight.data.mul_(HEAD_SCALE)


class SequentialMembers:
    """Baseline: at each scale, each network is called in turn on the resized image; all probabilities are averaged."""

    def __init__(self, networks: Sequence[SegmentationNetwork], ensemble: Ensemble) -> None:
        self.networks = networks
        self.ensemble = ensemble

    @torch.inference_mode()
    def p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Map an image (H, W, 3) of uint8 to probabilities (H, W) of float32."""
        each = []
        for scale in self.ensemble.settings.scales:
            image = torch.from_numpy(self.ensemble.resized(rgb, scale)).permute(2, 0, 1)[None]
            each += [probability(network(image), rgb.shape[:2])[0] for network in self.networks]
        mean: NDArray[np.float32] = torch.stack(each).mean(dim=0).numpy()
        return mean


def measure(folder: pathlib.Path, sizes: Sequence[tuple[int, int]], repeats: int) -> dict[str, Any]:
    """Return times and differences from the baseline for each image size and backend."""
    backends: dict[str, FrozenEnsemble] = {}
    default = load_ensemble(folder)
    for name in ("onnxruntime", "openvino", "torch"):
        if importlib.util.find_spec(name) is not None:
            backends[name] = default if name == default.backend.name else load_ensemble(folder, backend=name)
    reference: Ensemble = load_ensemble(folder, backend="torch")
    # torch's default memory layout, which networks have unless it is changed
    networks: list[Any] = [member.to(memory_format=torch.contiguous_format) for member in reference.members]
    methods: dict[str, Any] = {BASELINE: SequentialMembers(networks, reference), **backends}
    found: dict[str, Any] = {}
    for height, width in sizes:
        rgb = np.random.default_rng(1).integers(0, 256, (height, width, 3), dtype=np.uint8)
        expected = methods[BASELINE].p_occupied(rgb)
        print(f"{width}x{height}: {repeats} repeats of {', '.join(methods)}", flush=True)
        with foreign_cores() as others:
            programs = {name: functools.partial(method.p_occupied, rgb) for name, method in methods.items()}
            seconds = interleaved(programs, repeats)
        found[f"{width}x{height}"] = {
            "foreign_cores": others.cores,
            "default_backend": default.backend.name,
            "range_of_p_occupied": [float(expected.min()), float(expected.max())],
            "ways": {
                name: {
                    "median_ms": median_ms(taken),
                    "min_ms": 1e3 * min(taken),
                    "ratio": statistics.median(b / t for b, t in zip(seconds[BASELINE], taken, strict=True)),
                    "largest_difference": float(np.abs(methods[name].p_occupied(rgb) - expected).max()),
                }
                for name, taken in seconds.items()
            },
        }
    return found


def figures_of(found: dict[str, Any]) -> dict[str, float]:
    """Return the figures of the default backend; those of the first size have no suffix."""
    figures: dict[str, float] = {}
    for index, (size, result) in enumerate(found.items()):
        suffix = "" if index == 0 else f"_{size}"
        ours, baseline = result["ways"][result["default_backend"]], result["ways"][BASELINE]
        figures[f"inference_ratio{suffix}"] = ours["ratio"]
        figures[f"inference_ms{suffix}"] = ours["median_ms"]
        figures[f"inference_plain_ms{suffix}"] = baseline["median_ms"]
        figures[f"inference_agreement{suffix}"] = ours["largest_difference"]
    return figures


def _print_table(found: dict[str, Any]) -> None:
    for size, result in found.items():
        for name, method in result["ways"].items():
            label = f"{name} (default)" if name == result["default_backend"] else name
            times = f"{method['median_ms']:9.1f} ms   x{method['ratio']:5.2f}"
            print(f"{size:>9}  {label:26}{times}   differs by {method['largest_difference']:.0e}")
        print(f"{'':>9}  {result['foreign_cores']:.2f} cores were busy with other processes")


def _measured(options: argparse.Namespace) -> dict[str, Any]:
    network = NetworkSettings(pretrained=not options.tiny, pyramid_channels=8 if options.tiny else 128)
    inference = InferenceSettings(64, 48) if options.tiny else InferenceSettings()
    sizes = ((48, 64), (36, 48)) if options.tiny else SIZES
    before = torch.get_num_threads()
    torch.set_num_threads(options.threads)
    try:
        with tempfile.TemporaryDirectory() as folder:
            print(f"freezing {options.members} members (one export to ONNX) ...", flush=True)
            frozen = untrained_ensemble(
                pathlib.Path(folder), network, inference, range(options.members), adjust=_perturb
            )
            return measure(frozen, sizes, options.repeats)
    finally:
        torch.set_num_threads(before)


def main(arguments: list[str] | None = None) -> int:
    """Run ``python -m evidence.benchmarks.inference``."""
    parser = benchmark_parser("inference", __doc__)
    parser.add_argument("--members", type=int, default=5, help="members of the ensemble (default 5)")
    parser.add_argument("--threads", type=int, default=os.cpu_count() or 1, help="of all methods (default: cores)")
    options = parser.parse_args(arguments)
    found = _measured(options)
    _print_table(found)
    return finish(
        options,
        figures_of(found),
        seeds={"members_from": 0, "image": 1},
        members=f"{options.members}, weights perturbed at random, not trained",
        threads=options.threads,
        repeats=options.repeats,
        sizes=found,
    )


if __name__ == "__main__":
    sys.exit(main())
