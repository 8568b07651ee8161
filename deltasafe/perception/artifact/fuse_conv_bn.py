"""Batch normalization fuse_conv_bn into the convolution before it: the same function with half the operations."""

import copy

import torch
from torch import Tensor, nn
from torch.nn.utils.fusion import fuse_conv_bn_eval

__all__ = ["fuse_conv_bn"]


def fuse_conv_bn(network: nn.Module, example: Tensor) -> nn.Module:
    """A copy of ``network``, in evaluation mode, in which no normalization that follows a convolution is left.

    Which one follows which is observed while ``example`` passes, so that any architecture can be fuse_conv_bn; it must
    not depend on the input.
    """
    network = copy.deepcopy(network).eval()
    pairs: list[tuple[str, str]] = []
    made: dict[int, tuple[str, Tensor]] = {}
    handles = []
    for name, module in network.named_modules():
        if isinstance(module, nn.Conv2d):
            handles.append(module.register_forward_hook(_remembers(name, made)))
        elif isinstance(module, nn.BatchNorm2d):
            handles.append(module.register_forward_hook(_pairs(name, made, pairs)))
    with torch.no_grad():
        network(example)
    for handle in handles:
        handle.remove()
    for first, second in pairs:
        convolution, normalization = network.get_submodule(first), network.get_submodule(second)
        assert isinstance(convolution, nn.Conv2d)
        assert isinstance(normalization, nn.BatchNorm2d)
        network.set_submodule(first, fuse_conv_bn_eval(convolution, normalization))
        network.set_submodule(second, _what_follows(normalization))
    return network


def _remembers(name: str, made: dict[int, tuple[str, Tensor]]):  # type: ignore[no-untyped-def]
    def hook(module: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        made[id(output)] = name, output  # kept alive, so that no other tensor takes its place

    return hook


def _pairs(name: str, made: dict[int, tuple[str, Tensor]], pairs: list[tuple[str, str]]):  # type: ignore[no-untyped-def]
    def hook(module: nn.Module, inputs: tuple[Tensor, ...], output: Tensor) -> None:
        if id(inputs[0]) in made:
            pairs.append((made[id(inputs[0])][0], name))

    return hook


def _what_follows(normalization: nn.BatchNorm2d) -> nn.Module:
    """timm's normalization carries its activation."""
    rest = [getattr(normalization, name) for name in ("drop", "act") if hasattr(normalization, name)]
    return nn.Sequential(*rest) if rest else nn.Identity()
