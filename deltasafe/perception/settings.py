"""Settings of network, training, inference and promotion. Does not import torch, so that a UI loads it fast."""

import dataclasses
import math
from collections.abc import Mapping
from typing import Any

from deltasafe.errors import SettingsError
from deltasafe.io.records import from_json
from deltasafe.setting_ranges import check_choice, check_range

ARCHITECTURES = ("deeplabv3", "deeplabv3plus")
BACKBONES = ("efficientnet_lite0", "mobilenet_v3_large", "resnet50")
PRECISIONS = ("auto", "float32", "bfloat16")
SCHEDULES = ("one_cycle", "exponential")

EVALUATION_PIXELS = 2**19
"""Larger images are scaled down to this number for evaluation: ten times the networks' input, and bounded memory."""
PREDICTION_PIXELS = 2**22
"""Larger images are scaled down to this number by `deltasafe predict`: 80 megapixels would take gigabytes."""

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
        check_choice(self, ARCHITECTURES, "architecture")
        check_choice(self, BACKBONES, "backbone")
        check_range(self, f"[1, {_MAX_SIZE}]", "pyramid_channels", "atrous_rates")

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
        check_range(self, "[1, inf)", "epochs", "checkpoint_every_steps")
        check_range(self, "[2, inf)", "batch_size")  # batch normalization needs two
        check_range(self, "[0, 1]", "small_share")
        check_range(self, "(0, 1]", "small_scale", "epoch_decay")
        check_range(self, "(0, inf)", "peak_learning_rate")
        check_range(self, "[0, inf)", "weight_decay")
        check_choice(self, SCHEDULES, "schedule")
        check_choice(self, PRECISIONS, "precision")


@dataclasses.dataclass(frozen=True)
class InferenceSettings:
    """Input resolution of the networks.

    An image is scaled to about the area of ``width`` x ``height`` pixels. Its aspect ratio is kept, except for rounding
    to multiples of 16. The logits are scaled back to the size of the image. Networks recognize a hand best if it has as
    many pixels as in training; the mean over two scales recognizes larger hands too (decisions 76 and 90).

    Attributes:
        width: pixels, for an image of this aspect ratio.
        height: pixels.
        scales: factors of width and height; p_occupied of a member is its mean over the scales.
    """

    width: int = 256
    height: int = 192
    scales: tuple[float, ...] = (1.0, 0.75)

    def __post_init__(self) -> None:
        check_range(self, f"[{2 * _STRIDE}, {_MAX_SIZE}]", "width", "height")
        if not self.scales or len(set(self.scales)) < len(self.scales) or not all(0 < s <= 4 for s in self.scales):
            raise SettingsError(f"scales must be different factors in (0, 4], at least one, got {self.scales}")

    def network_size(self, height: int, width: int, scale: float = 1.0) -> tuple[int, int]:
        """Return the (height, width) that an image of ``height`` x ``width`` pixels is scaled to, at one scale."""
        scale *= math.sqrt(self.width * self.height / (width * height))
        return (
            max(2, round(height * scale / _STRIDE)) * _STRIDE,
            max(2, round(width * scale / _STRIDE)) * _STRIDE,
        )


@dataclasses.dataclass(frozen=True)
class GateThresholds:
    """Requirements for freezing an ensemble.

    Attributes:
        pixel_accuracy, miou: smallest allowed values of the whole ensemble.
        missed_hand_rate: largest allowed fraction of a hand with p_occupied < 0.5 in any image; 1 allows any fraction.
    """

    pixel_accuracy: float = 0.9
    miou: float = 0.8
    missed_hand_rate: float = 1.0

    def __post_init__(self) -> None:
        check_range(self, "[0, 1]", "pixel_accuracy", "miou", "missed_hand_rate")


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
        check_range(self, "[0, inf)", "seed")
        check_range(self, "[0, inf)", "nll_margin", "brier_margin", "miou_margin")
        check_range(self, "(0.5, 1)", "level")
        check_range(self, "[100, inf)", "n_bootstrap")  # fewer give no 95 % bound
