"""Low-precision training: dense convolutions multiply in bfloat16, everything else stays in float32 (decision 30)."""

import contextlib

import torch
from torch import Tensor, nn
from torch.nn import functional


def resolve_precision(name: str, device: torch.device) -> str:
    """Return ``float32`` or ``bfloat16``; ``auto`` is bfloat16 if ``device`` has instructions for it."""
    if name != "auto":
        return name
    if device.type == "cuda":
        return "bfloat16" if torch.cuda.is_bf16_supported() else "float32"
    # private functions of torch: if a version has none of them, the answer is float32
    tests = (getattr(torch.cpu, test, None) for test in ("_is_avx512_bf16_supported", "_is_amx_tile_supported"))
    return "bfloat16" if any(test is not None and test() for test in tests) else "float32"


def convert_to_low_precision(network: nn.Module, precision: str, device: torch.device) -> None:
    """On a CPU with ``precision`` bfloat16, make the dense convolutions of ``network`` multiply in bfloat16.

    Autocast would convert depthwise convolutions and normalization too. They are bound by memory and slower in bfloat16
    on a CPU: of 97 ms per image (EfficientNet-Lite0, one thread), autocast saves 9 ms and this function 23 ms.
    """
    if precision == "bfloat16" and device.type == "cpu":
        for module in network.modules():
            if type(module) is nn.Conv2d and module.groups == 1 and module.out_channels > 1:
                module.__class__ = _Bfloat16Convolution


def autocast_on_gpu(precision: str, device: torch.device) -> contextlib.AbstractContextManager[object]:
    """Return the context of a forward pass: autocast on a GPU, none on a CPU (see `convert_to_low_precision`)."""
    return torch.autocast(device.type, torch.bfloat16, enabled=precision == "bfloat16" and device.type != "cpu")


class _Bfloat16Convolution(nn.Conv2d):
    def _conv_forward(self, input: Tensor, weight: Tensor, bias: Tensor | None) -> Tensor:
        low_bias = None if bias is None else bias.bfloat16()
        output = functional.conv2d(
            input.bfloat16(), weight.bfloat16(), low_bias, self.stride, self.padding, self.dilation, self.groups
        )
        return output.float()
