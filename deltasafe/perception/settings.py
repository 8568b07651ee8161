"""What can be chosen about network, training and inference; free of torch, so that a UI can show it at once."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import SettingsError

__all__ = [
    "ARCHITECTURES",
    "BACKBONES",
    "InferenceSettings",
    "NetworkSettings",
    "PromotionSettings",
    "TrainingSettings",
]

ARCHITECTURES = ("deeplabv3", "deeplabv3plus")
BACKBONES = ("efficientnet_lite0", "mobilenet_v3_large", "resnet50")
PRECISIONS = ("auto", "float32", "bfloat16")
SCHEDULES = ("one_cycle", "exponential")

_STRIDE = 16
_WIDEST = 8192


@dataclasses.dataclass(frozen=True)
class NetworkSettings:
    """Which network every member is an instance of.

    Attributes:
        architecture: ``deeplabv3`` (atrous pyramid alone, as in the paper) or ``deeplabv3plus`` (with a skip
            from stride 4, which halves the error between fingers).
        backbone: one of `BACKBONES`.
        pretrained: begin from ImageNet weights where an installed package or a local cache holds them
            (never downloaded); the head is random for each member either way.
        pyramid_channels: width of the atrous pyramid; torchvision's default is 256.
        atrous_rates: of the pyramid, in cells of stride 16; those of torchvision were made for maps of 65 x 65 cells,
            on the 12 x 9 cells of a small image they reach outside nearly everywhere.
    """

    architecture: str = "deeplabv3plus"
    backbone: str = "efficientnet_lite0"
    pretrained: bool = True
    pyramid_channels: int = 128
    atrous_rates: tuple[int, ...] = (12, 24, 36)

    def __post_init__(self) -> None:
        object.__setattr__(self, "atrous_rates", tuple(self.atrous_rates))
        if self.architecture not in ARCHITECTURES:
            raise SettingsError(f"architecture must be one of {ARCHITECTURES}, got {self.architecture!r}")
        if self.backbone not in BACKBONES:
            raise SettingsError(f"backbone must be one of {BACKBONES}, got {self.backbone!r}")
        if not 1 <= self.pyramid_channels <= _WIDEST:
            raise SettingsError(f"pyramid_channels must be positive and at most {_WIDEST}, got {self.pyramid_channels}")
        if not self.atrous_rates or not all(1 <= rate <= _WIDEST for rate in self.atrous_rates):
            raise SettingsError(
                f"atrous_rates must be at least one positive number, of at most {_WIDEST}, got {self.atrous_rates}"
            )

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "NetworkSettings":
        """As stored with a member or an ensemble; the first ones named no rates and had torchvision's."""
        return cls(**{"atrous_rates": (12, 24, 36), **record})


@dataclasses.dataclass(frozen=True)
class TrainingSettings:
    """How a member is trained; what was measured with the defaults stands in docs/results.

    Attributes:
        network: the network of every member.
        epochs: passes over the augmented set, reshuffled before each.
        batch_size: images a step.
        small_share: share of the steps, from the first, that sees images reduced to ``small_scale``. Most of what is
            learned does not need full resolution, and small images are cheap; what lies between fingers needs it.
        small_scale: side of a reduced image relative to the stored one.
        peak_learning_rate: of AdamW; ``one_cycle`` rises to it over the first quarter and falls to zero,
            ``exponential`` starts there and is multiplied by ``epoch_decay`` after each epoch.
        weight_decay: of AdamW (decoupled); 0 is Adam.
        precision: ``bfloat16`` multiplies dense convolutions in that type (sums stay in float32, and so does all
            else on a CPU), ``float32`` nothing; ``auto`` is bfloat16 where the hardware multiplies it faster.
        compile: `torch.compile` the network before training; needs a C++ compiler, pays in long trainings.
        checkpoint_every_steps: a killed training loses at most so many steps.
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
    """At which resolution the networks look at an image.

    An image of any size is scaled to about ``width`` x ``height`` pixels in area, its aspect ratio kept up to
    rounding to multiples of 16; logits are scaled back to the size of the image.
    """

    width: int = 256
    height: int = 192

    def __post_init__(self) -> None:
        if self.width < 2 * _STRIDE or self.height < 2 * _STRIDE:
            raise SettingsError(f"inference size must be at least 32 x 32, got {self.width} x {self.height}")
        if max(self.width, self.height) > _WIDEST:
            raise SettingsError(f"inference size must be at most {_WIDEST} a side, got {self.width} x {self.height}")

    def network_size(self, height: int, width: int) -> tuple[int, int]:
        """(height, width) that the networks see for an image of ``height`` x ``width`` pixels."""
        scale = math.sqrt(self.width * self.height / (width * height))
        return (
            max(2, round(height * scale / _STRIDE)) * _STRIDE,
            max(2, round(width * scale / _STRIDE)) * _STRIDE,
        )


@dataclasses.dataclass(frozen=True)
class PromotionSettings:
    """When a new ensemble takes the place of the one in use (`perception.promotion`).

    Attributes:
        nll_margin, brier_margin: largest tolerable loss as a share of the old ensemble's NLL and Brier score.
        miou_margin: largest tolerable loss of mIoU, as a difference.
        level: confidence of the one-sided bounds that must stay below the margins.
        n_bootstrap: bootstrap samples of the test images.
        seed: of the bootstrap.
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
