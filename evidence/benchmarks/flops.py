"""How many multiplications and additions a training needs, whatever it runs on."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn
from torch.nn import functional
from torch.utils.flop_counter import FlopCounterMode

__all__ = ["training_flops"]


def training_flops(network: nn.Module, height: int, width: int) -> int:
    """FLOPs of forward and backward pass for one image of ``height`` x ``width``; a multiply-add is two.

    Nothing is computed: ``network`` is a throw-away one, whose weights are dropped.
    """
    network = network.train().to("meta")
    images, labels = torch.rand(2, 3, height, width, device="meta"), torch.zeros(2, height, width, device="meta")
    counter = FlopCounterMode(display=False, custom_mapping={torch.ops.aten.convolution_backward: _backward})
    with counter:
        functional.binary_cross_entropy_with_logits(network(images), labels).backward()
    return counter.get_total_flops() // 2


def _backward(grad_out: Sequence[int], images: Sequence[int], weight: Sequence[int], *rest: Any, **kept: Any) -> int:
    """Each wanted gradient, of input and of weight, costs what the forward pass costs.

    torch's own rule counts the weight's gradient of a grouped convolution as if it were dense: hundreds of times too
    much in a network of depthwise ones.
    """
    wanted = rest[-1]
    return int(2 * math.prod(grad_out) * math.prod(weight[1:]) * (wanted[0] + wanted[1]))
