"""Figure of training losses."""

import pathlib
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from deltasafe.io.storage import atomic_file


def plot_loss_curves(
    losses: Mapping[str, Sequence[float]], steps_per_epoch: int, destination: str | pathlib.Path
) -> None:
    """Plot training loss over epochs as a PNG, smoothed by a running mean over a tenth of an epoch.

    Args:
        losses: name of a member -> mean cross-entropy of each step, in nats per pixel.
    """
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    for name, values in losses.items():
        window = min(max(1, steps_per_epoch // 10), len(values))
        smooth = np.convolve(values, np.ones(window) / window, mode="valid")
        axes.plot((np.arange(len(smooth)) + window) / steps_per_epoch, smooth, label=name, linewidth=1.4)
    axes.set_yscale("log")
    axes.set_xlabel("epoch")
    axes.set_ylabel("cross-entropy (nats / pixel)")
    axes.grid(alpha=0.3, which="both", linewidth=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    with atomic_file(destination) as temporary:
        figure.savefig(temporary, dpi=130, format="png")
