"""Which number format a training multiplies in; sums, statistics, losses and weights stay in float32."""

import contextlib

import torch
from torch import Tensor, nn
from torch.nn import functional

__all__ = ["multiplying", "prepare", "resolve_precision"]


def resolve_precision(name: str, device: torch.device) -> str:
    """``float32`` or ``bfloat16``; ``auto`` is bfloat16 where ``device`` has instructions for it."""
    if name != "auto":
        return name
    if device.type == "cuda":
        return "bfloat16" if torch.cuda.is_bf16_supported() else "float32"
    # torch.cpu tells by functions that it calls private; without them the safe answer is float32
    tests = (getattr(torch.cpu, test, None) for test in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"))
    return "bfloat16" if any(test is not None and test() for test in tests) else "float32"


def prepare(network: nn.Module, precision: str, device: torch.device) -> None:
    """On a CPU, make the dense convolutions of ``network`` multiply in ``precision``.

    Autocast would do so for all convolutions, but depthwise ones and normalization are bound by memory and slower in
    bfloat16 there: of 97 ms an image (EfficientNet-Lite0, one thread), autocast saves 9 and this 23.
    """
    if precision == "bfloat16" and device.type == "cpu":
        for module in network.modules():
            if type(module) is nn.Conv2d and module.groups == 1 and module.out_channels > 1:
                module.__class__ = _Bfloat16Convolution


def multiplying(precision: str, device: torch.device) -> contextlib.AbstractContextManager[object]:
    """The context of a forward pass on ``device``: autocast on a GPU, nothing on a CPU (see `prepare`)."""
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16" and device.type != "cpu")


class _Bfloat16Convolution(nn.Conv2d):
    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        low = None if bias is None else bias.bfloat16()
        made = functional.conv2d(
            input.bfloat16(), weight.bfloat16(), low, self.stride, self.padding, self.dilation, self.groups
        )
        return made.float()
