"""How the loss of members fell."""

import pathlib
from collections.abc import Mapping, Sequence

import numpy as np
from matplotlib.figure import Figure

from deltasafe.io.storage import atomic_file

__all__ = ["plot_loss_curves"]


def plot_loss_curves(
    losses: Mapping[str, Sequence[float]], steps_per_epoch: int, destination: str | pathlib.Path
) -> None:
    """Training loss of each member over epochs, a running mean over a tenth of an epoch; a PNG.

    Args:
        losses: name of the member -> mean cross-entropy (nats a pixel) of each step.
        steps_per_epoch: steps that make an epoch.
    """
    figure = Figure(figsize=(7, 3.6), layout="constrained")
    axes = figure.subplots()
    window = max(1, steps_per_epoch // 10)
    for name, values in losses.items():
        kept = min(window, len(values))
        smooth = np.convolve(values, np.ones(kept) / kept, mode="valid")
        axes.plot((np.arange(len(smooth)) + kept) / steps_per_epoch, smooth, label=name, linewidth=1.4)
    axes.set_yscale("log")
    axes.set_xlabel("epoch")
    axes.set_ylabel("cross-entropy (nats / pixel)")
    axes.grid(alpha=0.3, which="both", linewidth=0.5)
    axes.spines[["top", "right"]].set_visible(False)
    axes.legend(frameon=False, fontsize=8)
    with atomic_file(destination) as temporary:
        figure.savefig(temporary, dpi=130, format="png")
