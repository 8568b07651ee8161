"""Uniformly weighted mixture of M members: p_occupied of every pixel (section III-B)."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn import functional

from deltasafe.errors import SettingsError
from deltasafe.perception.network import SegmentationNetwork
from deltasafe.perception.recalibration import apply_temperature
from deltasafe.perception.settings import InferenceSettings

__all__ = ["Ensemble", "probability"]


class Ensemble:
    """M networks that are asked together.

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
        mean = self.member_p_occupied(rgb).mean(axis=0, dtype=np.float32)
        return apply_temperature(mean, self.temperature).astype(np.float32)

    @torch.inference_mode()
    def member_p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(M, H, W) float32: what each member thinks of ``rgb``, (H, W, 3) uint8; the temperature is not applied."""
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or 0 in rgb.shape:
            raise SettingsError(f"an image must be uint8 (H, W, 3), got {rgb.dtype} {rgb.shape}")
        seen = self.resized(rgb).to(self.device)
        probabilities = [probability(network(seen), rgb.shape[:2])[0] for network in self.members]
        stacked: NDArray[np.float32] = torch.stack(probabilities).cpu().numpy()
        return stacked

    def resized(self, rgb: NDArray[np.uint8]) -> Tensor:
        """(1, 3, h, w) uint8: the image at the resolution of the networks."""
        height, width = self.settings.network_size(*rgb.shape[:2])
        shrinks = height * width < rgb.shape[0] * rgb.shape[1]
        scaled = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        return torch.from_numpy(np.ascontiguousarray(scaled)).permute(2, 0, 1)[None]


def probability(logits: Tensor, size: tuple[int, ...]) -> Tensor:
    """The one conversion point: logits (B, h, w) -> p_occupied (B, H, W) at ``size`` = (H, W)."""
    scaled = functional.interpolate(logits[:, None], size, mode="bilinear", align_corners=False)
    return torch.sigmoid(scaled)[:, 0]
