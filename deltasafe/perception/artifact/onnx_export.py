"""The whole ensemble as one ONNX program, for images of any size and any batch."""

import copy
import logging
import pathlib
import warnings
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from torch import Tensor, nn

from deltasafe.io.storage import atomic_file
from deltasafe.perception.artifact.fuse_conv_bn import fuse_conv_bn
from deltasafe.perception.artifact.onnx_graph import Part, Weights, attributes, sizes_of
from deltasafe.perception.artifact.onnx_upsampling import convolve_before_upsampling
from deltasafe.perception.artifact.onnx_winograd import rewrite_as_winograd
from deltasafe.perception.calibration.metrics import NLL_CLIP
from deltasafe.perception.inference.ensemble import Ensemble

if TYPE_CHECKING:
    import onnx

__all__ = ["export_onnx"]

_OPSET = 18
_EXAMPLE_SIZE = (160, 224)
"""Of the traced image: no map of any stride is square, and no two strides give the same size."""
_ANY_SIZE = 1
"""``model_version`` of a program that is right at any image size; 0 (not set): at multiples of 16 only."""
_INT64 = 7
_LARGEST_CONSTANT = 16
"""Of what the trace may add to the weights: bounds of activations, axes, sizes."""


def export_onnx(ensemble: Ensemble, destination: pathlib.Path) -> None:
    """Write ``ensemble``; the file is the same for the same weights, and free of machine paths.

    Input ``rgb``, uint8 (B, h, w, 3), any h and w; ``model_version`` 1 says so. Outputs ``p_occupied``
    (B, h, w), recalibrated, and ``member_p_occupied`` and ``member_logits`` (B, M, h, w), as the members give them.

    One member is traced; the others share its structure and differ in weights alone. Normalization is fuse_conv_bn into
    convolutions, what does not depend on a member (preprocessing) is computed once for all, and the decoder, where half
    of the time went, is rewritten to the same function with fewer multiplications (`onnx_enlarging`, `onnx_winograd`).
    """
    import onnx

    networks = [_traceable(network) for network in ensemble.members]
    weights = [_weights(network) for network in networks]
    traced = _graph_of(networks[0], weights[0])
    sizes = sizes_of(traced)
    _follow_the_image(traced)
    convolve_before_upsampling(traced, weights, sizes, _EXAMPLE_SIZE)
    rewrite_as_winograd(traced, weights, sizes, _EXAMPLE_SIZE[0])
    graph = onnx.GraphProto(name="ensemble")
    each = _stack(graph, traced, weights)
    _conclude(graph, each, ensemble.temperature)
    opsets = [onnx.helper.make_opsetid("", _OPSET)]
    model = onnx.helper.make_model(graph, opset_imports=opsets, ir_version=10, model_version=_ANY_SIZE)
    onnx.checker.check_model(model)
    with atomic_file(destination) as temporary:
        onnx.save(model, temporary)


class _Member(nn.Module):
    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = network

    def forward(self, rgb: Tensor) -> Tensor:
        logits: Tensor = self.network(rgb.permute(0, 3, 1, 2).float())
        return logits


class _Mean(nn.Module):
    """What `nn.AdaptiveAvgPool2d(1)` computes, in one node and for any batch."""

    def forward(self, features: Tensor) -> Tensor:
        return features.mean((2, 3), keepdim=True)


def _traceable(network: nn.Module) -> _Member:
    example = torch.zeros((1, 3, *_EXAMPLE_SIZE), dtype=torch.uint8)
    network = fuse_conv_bn(copy.deepcopy(network).cpu().float().to(memory_format=torch.contiguous_format), example)
    for module in list(network.modules()):
        for name, child in module.named_children():
            if isinstance(child, nn.AdaptiveAvgPool2d) and child.output_size in (1, (1, 1)):
                setattr(module, name, _Mean())
    return _Member(network)


def _weights(network: nn.Module) -> Weights:
    return {
        name: np.ascontiguousarray(value.detach().numpy())
        for name, value in [*network.named_parameters(), *network.named_buffers()]
    }


def _graph_of(network: nn.Module, own: Weights) -> "onnx.GraphProto":
    """The trace with all weights in it: a bias that is zero would be left out, though another member's may not be.

    Raises:
        RuntimeError: the trace has changed a weight, so that another member's cannot take its place.
    """
    from onnx import numpy_helper

    seen = copy.deepcopy(network)
    for parameter in seen.parameters():
        if not parameter.any():
            parameter.data.fill_(1.0)
    graph, there = _traced(seen).graph, _weights(seen)
    for item in graph.initializer:
        value, known = numpy_helper.to_array(item), there.get(item.name)
        if value.size > _LARGEST_CONSTANT if known is None else not np.array_equal(known, value):
            raise RuntimeError(f"the exporter has changed {item.name}; the other members' weights do not fit it")
        if known is not None:
            item.CopyFrom(numpy_helper.from_array(own[item.name], item.name))
    return graph


def _traced(network: nn.Module) -> "onnx.ModelProto":
    level = logging.getLogger("torch.onnx").level
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), torch.inference_mode(False), torch.no_grad():
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                network.eval(),
                (torch.zeros((1, *_EXAMPLE_SIZE, 3), dtype=torch.uint8),),
                input_names=["rgb"],
                output_names=["logits"],
                opset_version=_OPSET,
                dynamo=True,
                verbose=False,
            )
    finally:
        logging.getLogger("torch.onnx").setLevel(level)
    assert program is not None
    model: onnx.ModelProto = program.model_proto
    return model


def _follow_the_image(graph: "onnx.GraphProto") -> None:
    """Make target sizes and paddings, which the trace has fixed, follow the image; it may have any size.

    Raises:
        RuntimeError: a size is no share of the image's, or another node depends on it.
    """
    from onnx import helper, numpy_helper

    constants = {item.name: numpy_helper.to_array(item) for item in graph.initializer if item.data_type == _INT64}
    nodes = [
        helper.make_node("Shape", ["rgb"], ["image_size"], start=1, end=3),
    ]
    for node in graph.node:
        if node.op_type == "Resize":
            target = constants[node.input[3]][2:]
            strides = {size // int(part) for size, part in zip(_EXAMPLE_SIZE, target, strict=True)}
            if len(strides) != 1 or any(size % int(part) for size, part in zip(_EXAMPLE_SIZE, target, strict=True)):
                raise RuntimeError(f"a map is scaled to {target}, which is no share of the image's {_EXAMPLE_SIZE}")
            name = node.output[0]
            part = Part(name)
            part.ceil_divide("image_size", *2 * list(strides), output="target")
            nodes += [
                *part.nodes,
                helper.make_node("Shape", [node.input[0]], [f"{name}.batch"], start=0, end=2),
                helper.make_node("Concat", [f"{name}.batch", f"{name}.target"], [f"{name}.size"], axis=0),
            ]
            node.input[3] = f"{name}.size"
        elif node.op_type == "Conv":
            _pad_for_any_size(node)
        elif node.op_type in ("Reshape", "Expand", "Slice", "Tile"):
            raise RuntimeError(f"the traced network fixes a shape in {node.op_type} {node.name}")
        nodes.append(node)
    used = {name for node in nodes for name in node.input}
    kept = [copy.deepcopy(item) for item in graph.initializer if item.name in used]
    nodes = [copy.deepcopy(node) for node in nodes]
    del graph.node[:], graph.initializer[:], graph.value_info[:]
    graph.node.extend(nodes)
    graph.initializer.extend(kept)


def _pad_for_any_size(convolution: "onnx.NodeProto") -> None:
    """Let the runtime compute the padding where the network does: TensorFlow's "same" depends on the input size.

    Such layers are those with unequal padding at begin and end, which holds for even sizes only. Odd sizes are padded
    equally.
    """
    from onnx import helper

    pads = attributes(convolution).get("pads", [])
    half = len(pads) // 2
    if pads[:half] != pads[half:]:
        kept = [item for item in convolution.attribute if item.name not in ("pads", "auto_pad")]
        del convolution.attribute[:]
        convolution.attribute.extend([*kept, helper.make_attribute("auto_pad", "SAME_UPPER")])


def _stack(graph: "onnx.GraphProto", traced: "onnx.GraphProto", weights: list[Weights]) -> list[str]:
    """Add ``traced`` once for each member; what is the same for all of them, once. Returns the members' outputs."""
    from onnx import numpy_helper

    shared: set[str] = {"rgb"}
    for item in traced.initializer:
        first = weights[0].get(item.name)
        if first is None or all(np.array_equal(first, others[item.name]) for others in weights[1:]):
            shared.add(item.name)
            graph.initializer.append(item)
        else:
            for index, named in enumerate(weights):
                graph.initializer.append(numpy_helper.from_array(named[item.name], f"{index}.{item.name}"))
    for index in range(len(weights)):
        for node in traced.node:
            if all(not name or name in shared for name in node.input) and node.output[0] != "logits":
                if index == 0:
                    graph.node.append(_without_origin(node))
                shared.update(node.output)
            elif not set(node.output) <= shared:
                own = _without_origin(node)
                own.input[:] = [name if not name or name in shared else f"{index}.{name}" for name in node.input]
                own.output[:] = [f"{index}.{name}" for name in node.output]
                graph.node.append(own)
    return [f"{index}.logits" for index in range(len(weights))]


def _without_origin(node: "onnx.NodeProto") -> "onnx.NodeProto":
    node = copy.deepcopy(node)
    del node.metadata_props[:]  # stack traces of the exporting machine
    node.name = ""
    return node


def _conclude(graph: "onnx.GraphProto", each: list[str], temperature: float) -> None:
    """From the members' logits to the three outputs."""
    from onnx import TensorProto, helper

    def add(kind: str, inputs: list[str], output: str, **attributes: Any) -> str:
        graph.node.append(helper.make_node(kind, inputs, [output], **attributes))
        return output

    def constant(name: str, value: float) -> str:
        return add("Constant", [], name, value_float=value)

    add("Constant", [], "members_axis", value_ints=[1])
    layers = [add("Unsqueeze", [name, "members_axis"], f"{name}.layer") for name in each]
    add("Concat", layers, "member_logits", axis=1)
    add("Sigmoid", ["member_logits"], "member_p_occupied")
    mean = "p_occupied" if temperature == 1.0 else "mean_p_occupied"
    add("ReduceMean", ["member_p_occupied", "members_axis"], mean, keepdims=0)
    if temperature != 1.0:
        clipped = add("Clip", [mean, constant("lowest", NLL_CLIP), constant("highest", 1 - NLL_CLIP)], "clipped")
        free = add("Sub", [constant("one", 1.0), clipped], "p_free")
        logit = add("Log", [add("Div", [clipped, free], "odds")], "logit")
        add("Sigmoid", [add("Div", [logit, constant("temperature", temperature)], "cooled")], "p_occupied")
    size: list[str | int] = ["batch", "height", "width"]
    graph.input.append(helper.make_tensor_value_info("rgb", TensorProto.UINT8, [*size, 3]))
    for name, shape in (
        ("p_occupied", size),
        ("member_p_occupied", [size[0], len(each), *size[1:]]),
        ("member_logits", [size[0], len(each), *size[1:]]),
    ):
        graph.output.append(helper.make_tensor_value_info(name, TensorProto.FLOAT, shape))
