"""Ensemble of M networks: p_occupied of each pixel is the mean over the members (section III-B)."""

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn
from torch.nn.functional import interpolate

from deltasafe.errors import SettingsError
from deltasafe.perception.calibration.temperature import pooled_probability
from deltasafe.perception.data.dataset_info import HANDS, DatasetInfo
from deltasafe.perception.inference.backends import InferenceBackend, TorchBackend
from deltasafe.perception.inference.lazy_backend import LazyBackend
from deltasafe.perception.settings import InferenceSettings
from deltasafe.perception.training.device import pick_device
from deltasafe.perception.training.network import SegmentationNetwork


class Ensemble:
    """M networks with uniform weights. ``info`` says what they detect.

    Thread-safe. Can be pickled and copied before and after its first use, and used in a forked process, where it
    computes with one thread.

    Args:
        members: networks, at least one.
        settings: input resolution of the networks.
        device: see `pick_device`.
        temperature: divides the logit of the mean; 1 changes nothing.
    """

    info: DatasetInfo = HANDS

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
        self.device = pick_device(device)
        self._lazy_backend = LazyBackend()
        self.members = nn.ModuleList(members).to(self.device).to(memory_format=torch.channels_last).eval()

    def __len__(self) -> int:
        return len(self.members)

    def p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Predict the probability that a pixel shows the obstacle: the mean over members, with the temperature.

        Args:
            rgb: (H, W, 3) uint8.

        Returns:
            (H, W) float32 in [0, 1].

        Raises:
            SettingsError: ``rgb`` is no array of this shape and type.
        """
        return pooled_probability(self.member_p_occupied(rgb), self.temperature).astype(np.float32)

    def member_p_occupied(self, rgb: NDArray[np.uint8]) -> NDArray[np.float32]:
        """Predict p_occupied with each member, without the temperature: (H, W, 3) uint8 -> (M, H, W) float32.

        A member's p_occupied is its mean over the scales of the settings.

        Raises:
            SettingsError: ``rgb`` is no array of this shape and type.
        """
        predictions: NDArray[np.float32] = self._member_p_occupied(rgb).cpu().numpy()
        return predictions

    @property
    def backend(self) -> InferenceBackend:
        """The backend that computes the logits, created on first use."""
        return self._lazy_backend.get(self._create_backend)

    def _create_backend(self) -> InferenceBackend:
        return TorchBackend(self.members, self.device)

    @torch.inference_mode()
    def _member_p_occupied(self, rgb: NDArray[np.uint8]) -> Tensor:
        if not isinstance(rgb, np.ndarray):
            found = f"{type(rgb).__module__}.{type(rgb).__qualname__}"
            remedy = "read it with deltasafe.perception.read_rgb"
            raise SettingsError(f"an image must be a numpy array, uint8 (H, W, 3), got {found}; {remedy}")
        if rgb.ndim != 3 or rgb.shape[2] != 3 or rgb.dtype != np.uint8 or 0 in rgb.shape:
            raise SettingsError(f"an image must be uint8 (H, W, 3), got {rgb.dtype} {rgb.shape}")
        each = [
            probability(self.backend.member_logits(self.resized(rgb, scale)[None])[0], rgb.shape[:2])
            for scale in self.settings.scales
        ]
        return each[0] if len(each) == 1 else torch.stack(each).mean(dim=0)

    def resized(self, rgb: NDArray[np.uint8], scale: float = 1.0) -> NDArray[np.uint8]:
        """Scale an image (H, W, 3) uint8 to the input resolution of the networks at one of the scales."""
        height, width = self.settings.network_size(rgb.shape[0], rgb.shape[1], scale)
        shrinks = height * width < rgb.shape[0] * rgb.shape[1]
        scaled = cv2.resize(rgb, (width, height), interpolation=cv2.INTER_AREA if shrinks else cv2.INTER_LINEAR)
        return np.ascontiguousarray(scaled)


def probability(logits: Tensor, size: tuple[int, ...]) -> Tensor:
    """Convert logits (B, h, w) to p_occupied (B, H, W) at ``size`` = (H, W); nothing else does (decision 28)."""
    scaled = interpolate(logits[:, None], size, mode="bilinear", align_corners=False)
    return scaled.sigmoid_()[:, 0]
