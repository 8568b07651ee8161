"""Uniformly weighted mixture of M members: p_occupied of every pixel (section III-B)."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.temperature import pooled_probability
from deltasafe.perception.inference.backends import InferenceBackend, TorchBackend
from deltasafe.perception.inference.lazy_backend import LazyEngine
from deltasafe.perception.settings import InferenceSettings
from deltasafe.perception.training.network import SegmentationNetwork

__all__ = ["Ensemble", "probability"]


class Ensemble:
    """M networks that are asked together.

    Any number of threads may use one ensemble. It can be pickled and copied before and after its first use, and used
    in forked processes, where it computes with one thread.

    Args:
        members: networks in evaluation mode, at least one.
        settings: the resolution at which they look.
        device: ``auto``, ``cpu``, ``cuda``, ...
        temperature: divides the logit of the mean (pool, then calibrate); 1 leaves it as it is.
    """

    def __init__(
        self,
        members: list[SegmentationNetwork],
        settings: InferenceSettings,
        device: str = "cpu",
        temperature: float = 1.0,
    ) -> None:
        if not members:
            raise SettingsError("an ensemble needs at least one member")
        self.settings = settings
        self.temperature = temperature
        self.device = torch.device(device)
        self._engine = LazyEngine()
        self.members = nn.ModuleList(members).to(self.device).to(memory_format=torch.channels_last).eval()

    def __len__(self) -> int:
        return len(self.members)

    def p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Probability that a pixel shows the obstacle.

        Args:
            rgb: (H, W, 3) uint8.

        Returns:
            (H, W) float32 in [0, 1]: the mean over members, recalibrated by the temperature.

        Raises:
            SettingsError: ``rgb`` has another shape or type.
        """
        return pooled_probability(self.member_p_occupied(rgb), self.temperature).astype(np.float32)

    def member_p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(M, H, W) float32: what each member thinks of ``rgb``, (H, W, 3) uint8; the temperature is not applied."""
        stacked: NDArray[np.float32] = self._member_p_occupied(rgb).cpu().numpy()
        return stacked

    @property
    def backend(self) -> InferenceBackend:
        """What computes the logits; created on first use."""
        return self._engine.get(self._create_engine)

    def _create_engine(self) -> InferenceBackend:
        return TorchBackend(self.members, self.device)

    @torch.inference_mode()
    def _member_p_occupied(self, rgb: NDArray[np.uint8]) -> Tensor:
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or 0 in rgb.shape:
            raise SettingsError(f"an image must be uint8 (H, W, 3), got {rgb.dtype} {rgb.shape}")
        return probability(self.backend.member_logits(self.resized(rgb)[None])[0], rgb.shape[:2])

    def resized(self, rgb: NDArray[np.uint8]) -> NDArray[np.uint8]:
        """(h, w, 3) uint8: the image at the resolution of the networks."""
        height, width = self.settings.network_size(*rgb.shape[:2])
        shrinks = height * width < rgb.shape[0] * rgb.shape[1]
        scaled = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        return np.ascontiguousarray(scaled)


def probability(logits: Tensor, size: tuple[int, ...]) -> Tensor:
    """The one conversion point: logits (B, h, w) -> p_occupied (B, H, W) at ``size`` = (H, W)."""
    scaled = interpolate(logits[:, None], size, mode="bilinear", align_corners=False)
    return scaled.sigmoid_()[:, 0]
