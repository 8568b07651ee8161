"""Number of floating-point operations of one training step, on any hardware."""

import math
from collections.abc import Sequence
from typing import Any

import torch
from torch import nn
from torch.nn import functional
from torch.utils.flop_counter import FlopCounterMode


def training_flops(network: nn.Module, height: int, width: int) -> int:
    """Count the FLOPs of forward and backward pass for one image; a multiply-add counts as two.

    Nothing is computed: the network is moved to the meta device, where it loses its weights.
    """
    network = network.train().to("meta")
    images, labels = torch.rand(2, 3, height, width, device="meta"), torch.zeros(2, height, width, device="meta")
    counter = FlopCounterMode(display=False, custom_mapping={torch.ops.aten.convolution_backward: _backward})
    with counter:
        functional.binary_cross_entropy_with_logits(network(images), labels).backward()
    return counter.get_total_flops() // 2


def _backward(grad_out: Sequence[int], images: Sequence[int], weight: Sequence[int], *rest: Any, **kwargs: Any) -> int:
    """Count one forward pass for each requested gradient (of input and weight).

    torch's own rule counts the weight gradient of a grouped convolution as if it were dense, which is hundreds of
    times too much for depthwise convolutions.
    """
    requested = rest[-1]
    return int(2 * math.prod(grad_out) * math.prod(weight[1:]) * (requested[0] + requested[1]))
