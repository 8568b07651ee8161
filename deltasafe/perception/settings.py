"""Settings of network, training, inference and promotion. Does not import torch, so that a UI loads it fast."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import SettingsError
from deltasafe.io.records import from_json

ARCHITECTURES = ("deeplabv3", "deeplabv3plus")
BACKBONES = ("efficientnet_lite0", "mobilenet_v3_large", "resnet50")
PRECISIONS = ("auto", "float32", "bfloat16")
SCHEDULES = ("one_cycle", "exponential")

_STRIDE = 16
_MAX_SIZE = 8192
_TORCHVISION_RATES = (12, 24, 36)


@dataclasses.dataclass(frozen=True)
class NetworkSettings:
    """Architecture of the network; the same for every member.

    Attributes:
        architecture: ``deeplabv3`` (atrous pyramid only, as in the paper) or ``deeplabv3plus`` (adds a skip connection
            from stride 4, which halves the error between fingers).
        backbone: ``efficientnet_lite0``, ``mobilenet_v3_large`` or ``resnet50``.
        pretrained: start from ImageNet weights if an installed package or the local cache has them. They are never
            downloaded. The head is initialized at random for each member.
        pyramid_channels: channels of the atrous pyramid (ASPP); torchvision's default is 256.
        atrous_rates: dilations of the pyramid, in cells of stride 16. The default is torchvision's, made for maps of
            65 x 65 cells; on the 12 x 9 cells of a small image most taps fall outside.
    """

    architecture: str = "deeplabv3plus"
    backbone: str = "efficientnet_lite0"
    pretrained: bool = True
    pyramid_channels: int = 128
    atrous_rates: tuple[int, ...] = _TORCHVISION_RATES

    def __post_init__(self) -> None:
        object.__setattr__(self, "atrous_rates", tuple(self.atrous_rates))
        if self.architecture not in ARCHITECTURES:
            raise SettingsError(f"architecture must be one of {ARCHITECTURES}, got {self.architecture!r}")
        if self.backbone not in BACKBONES:
            raise SettingsError(f"backbone must be one of {BACKBONES}, got {self.backbone!r}")
        if not 1 <= self.pyramid_channels <= _MAX_SIZE:
            raise SettingsError(
                f"pyramid_channels must be positive and at most {_MAX_SIZE}, got {self.pyramid_channels}"
            )
        if not self.atrous_rates or not all(1 <= rate <= _MAX_SIZE for rate in self.atrous_rates):
            raise SettingsError(
                f"atrous_rates must be at least one positive number, of at most {_MAX_SIZE}, got {self.atrous_rates}"
            )

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "NetworkSettings":
        """Read the JSON form stored with a member or ensemble; the first versions stored no rates (torchvision's).

        Raises:
            TypeError, ValueError: ``record`` has another form.
        """
        network: NetworkSettings = from_json(cls, {"atrous_rates": list(_TORCHVISION_RATES), **record})
        return network


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """Training of one member. Results with the defaults are in docs/results.

    Attributes:
        network: architecture, the same for every member.
        epochs: passes over the augmented set, which is reshuffled before each.
        batch_size: images per step.
        small_share: fraction of the steps, counted from the first, that train on downscaled images. These steps are
            cheap; only the gaps between fingers need full resolution.
        small_scale: side length of a downscaled image, relative to the stored one.
        peak_learning_rate: maximum learning rate of AdamW.
        schedule: ``one_cycle`` (rises over the first quarter, then falls to zero) or ``exponential`` (starts at the
            maximum, multiplied by ``epoch_decay`` after each epoch).
        epoch_decay: factor of the ``exponential`` schedule, in (0, 1].
        weight_decay: decoupled weight decay of AdamW; with 0 it is Adam.
        precision: ``float32``, ``bfloat16`` (dense convolutions multiply in bfloat16 and accumulate in float32; on a
            CPU everything else is float32), or ``auto`` (bfloat16 if the hardware has instructions for it).
        compile: run `torch.compile` before training. Needs a C++ compiler; worthwhile for long trainings only.
        checkpoint_every_steps: steps between checkpoints, at most lost when a training is killed.
    """

    network: NetworkSettings = dataclasses.field(default_factory=NetworkSettings)
    epochs: int = 5
    batch_size: int = 8
    small_share: float = 0.0
    small_scale: float = 0.625
    peak_learning_rate: float = 2e-3
    schedule: str = "one_cycle"
    epoch_decay: float = 0.8
    weight_decay: float = 1e-4
    precision: str = "auto"
    compile: bool = False
    checkpoint_every_steps: int = 60

    def __post_init__(self) -> None:
        for name in ("epochs", "checkpoint_every_steps"):
            if getattr(self, name) < 1:
                raise SettingsError(f"{name} must be at least 1, got {getattr(self, name)}")
        if self.batch_size < 2:
            raise SettingsError(f"batch_size must be at least 2 (batch normalization), got {self.batch_size}")
        if not 0 <= self.small_share <= 1:
            raise SettingsError(f"small_share must lie in [0, 1], got {self.small_share}")
        if not 0 < self.small_scale <= 1:
            raise SettingsError(f"small_scale must lie in (0, 1], got {self.small_scale}")
        if not (math.isfinite(self.peak_learning_rate) and self.peak_learning_rate > 0):
            raise SettingsError(f"peak_learning_rate must be positive, got {self.peak_learning_rate}")
        if self.schedule not in SCHEDULES:
            raise SettingsError(f"schedule must be one of {SCHEDULES}, got {self.schedule!r}")
        if not 0 < self.epoch_decay <= 1:
            raise SettingsError(f"epoch_decay must lie in (0, 1], got {self.epoch_decay}")
        if not self.weight_decay >= 0:
            raise SettingsError(f"weight_decay must not be negative, got {self.weight_decay}")
        if self.precision not in PRECISIONS:
            raise SettingsError(f"precision must be one of {PRECISIONS}, got {self.precision!r}")


@dataclasses.dataclass(frozen=True)
class InferenceSettings:
    """Input resolution of the networks.

    An image is scaled to about the area of ``width`` x ``height`` pixels. Its aspect ratio is kept, except for rounding
    to multiples of 16. The logits are scaled back to the size of the image.

    Attributes:
        width: pixels, for an image of this aspect ratio.
        height: pixels.
    """

    width: int = 256
    height: int = 192

    def __post_init__(self) -> None:
        if self.width < 2 * _STRIDE or self.height < 2 * _STRIDE:
            raise SettingsError(f"inference size must be at least 32 x 32, got {self.width} x {self.height}")
        if max(self.width, self.height) > _MAX_SIZE:
            raise SettingsError(
                f"inference size must be at most {_MAX_SIZE} per side, got {self.width} x {self.height}"
            )

    def network_size(self, height: int, width: int) -> tuple[int, int]:
        """Return the (height, width) that an image of ``height`` x ``width`` pixels is scaled to."""
        scale = math.sqrt(self.width * self.height / (width * height))
        return (
            max(2, round(height * scale / _STRIDE)) * _STRIDE,
            max(2, round(width * scale / _STRIDE)) * _STRIDE,
        )


@dataclasses.dataclass(frozen=True)
class PromotionSettings:
    """Non-inferiority test that a new ensemble must pass to replace the champion (decision 36).

    Attributes:
        nll_margin, brier_margin: non-inferiority margin, as a fraction of the champion's NLL or Brier score.
        miou_margin: non-inferiority margin of the mIoU, as a difference.
        level: one-sided confidence level of the upper bounds that are compared with the margins.
        n_bootstrap: number of bootstrap samples of the test images.
        seed: seed of the bootstrap.
    """

    nll_margin: float = 0.1
    brier_margin: float = 0.1
    miou_margin: float = 0.01
    level: float = 0.95
    n_bootstrap: int = 2000
    seed: int = 0

    def __post_init__(self) -> None:
        for name in ("nll_margin", "brier_margin", "miou_margin"):
            if not (math.isfinite(getattr(self, name)) and getattr(self, name) >= 0.0):
                raise SettingsError(f"{name} must be finite and not negative, got {getattr(self, name)}")
        if not 0.5 < self.level < 1.0:
            raise SettingsError(f"level must lie in (0.5, 1), got {self.level}")
        if self.n_bootstrap < 100:
            raise SettingsError(f"n_bootstrap must be at least 100 for a 95 % bound, got {self.n_bootstrap}")
