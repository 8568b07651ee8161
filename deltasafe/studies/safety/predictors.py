"""Predictors of p_occupied: a frozen ensemble, behind an interface that tests can implement."""

import dataclasses
import functools
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from deltasafe.perception.calibration.delta_support import Calibration


@dataclasses.dataclass(frozen=True)
class Prediction:
    """Predicted p_occupied of an image: ``ensemble`` (H, W) and ``members`` (M, H, W)."""

    ensemble: NDArray[np.float32]
    members: NDArray[np.float32]


class Predictor(Protocol):
    """Predicts p_occupied; a dataclass with a JSON form, because the digest of a batch includes it."""

    def predict(self, rgb: NDArray[np.uint8]) -> Prediction:
        """Predict p_occupied of an image (H, W, 3) uint8."""
        ...

    def calibration(self) -> Calibration:
        """Return the calibration, which states the margins."""
        ...


@dataclasses.dataclass(frozen=True)
class FrozenEnsemblePredictor:
    """A frozen ensemble. The temperature applies to the mean only; single members stay uncalibrated."""

    folder: str

    def predict(self, rgb: NDArray[np.uint8]) -> Prediction:
        """Predict the calibrated mean of the members, and each member.

        Raises:
            ArtifactError: the folder holds no frozen ensemble.
        """
        from deltasafe.perception.calibration.temperature import pooled_probability

        ensemble = _load(self.folder)
        members = ensemble.member_p_occupied(rgb)
        return Prediction(pooled_probability(members, ensemble.temperature).astype(np.float32), members)

    def calibration(self) -> Calibration:
        """Return the calibration of the frozen ensemble.

        Raises:
            ArtifactError: the folder holds no frozen ensemble.
        """
        calibration: Calibration = _load(self.folder).calibration
        return calibration


@functools.lru_cache(1)
def _load(folder: str) -> Any:
    """Load the ensemble and create its backend with one thread per process, which also fixes the order of sums."""
    import torch

    from deltasafe.perception.artifact.frozen_ensemble import load_ensemble

    ensemble = load_ensemble(folder)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        _ = ensemble.backend
    finally:
        torch.set_num_threads(threads)
    return ensemble
