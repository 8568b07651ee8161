"""Export of a whole ensemble as one ONNX program, for images of any size and any batch size."""

import copy
import logging
import pathlib
import warnings
from collections.abc import Iterable
from typing import TYPE_CHECKING

import torch
from torch import Tensor, nn

from deltasafe.io.storage import atomic_file
from deltasafe.perception.artifact.onnx_upsampling import DOMAIN, convolve_before_upsampling, upsampling_functions
from deltasafe.perception.calibration.metrics import NLL_CLIP
from deltasafe.perception.inference.ensemble import Ensemble

if TYPE_CHECKING:
    import onnx

_OPSET = 18
_EXAMPLE_SIZE = (160, 224)
"""Size of the traced image: no feature map is square, and no two strides give the same size."""
_ANY_SIZE = 1
"""``model_version`` of a program that is correct at any image size; 0 (unset): at multiples of 16 only."""


def export_onnx(ensemble: Ensemble, destination: pathlib.Path) -> None:
    """Write ``ensemble`` as one ONNX program; the same weights give the same file, without machine paths.

    Input ``rgb``: uint8 (B, h, w, 3), any h and w. Outputs: ``p_occupied`` (B, h, w) with the temperature;
    ``member_p_occupied`` and ``member_logits`` (B, M, h, w) without it.

    Raises:
        RuntimeError: the exporter fixed a size, or computed a weight, that must stay variable.
    """
    import onnx
    from onnx import compose, helper, inliner, parser

    # tracing takes seconds, so one trace serves all members: they differ in their weights only
    trace = _trace(ensemble.members[0])
    nodes, weights = [], []
    for index, network in enumerate(ensemble.members):
        member = _with_weights_of(network, trace)
        _follow_image_size(member)
        convolve_before_upsampling(member)
        compose.add_prefix_graph(member, f"member_{index}_", rename_inputs=False, inplace=True)
        nodes += member.node
        weights += member.initializer
    ends = parser.parse_graph(_from_logits_to_outputs(len(ensemble), ensemble.temperature))
    nodes, read = _needed([*nodes, *ends.node], ends.output)
    weights = [item for item in weights if item.name in read]
    model = helper.make_model(
        helper.make_graph(nodes, "ensemble", ends.input, ends.output, weights),
        opset_imports=[helper.make_opsetid("", _OPSET), helper.make_opsetid(DOMAIN, 1)],
        functions=upsampling_functions(),
        ir_version=10,
        model_version=_ANY_SIZE,
    )
    model = inliner.inline_local_functions(model)
    del model.opset_import[1]  # no function is left
    onnx.checker.check_model(model)
    with atomic_file(destination) as temporary:
        onnx.save(model, temporary)


class _Member(nn.Module):
    """A network on images (B, h, w, 3). Pooling is a plain mean, which the exporter keeps free of fixed sizes."""

    def __init__(self, network: nn.Module) -> None:
        super().__init__()
        self.network = copy.deepcopy(network).cpu().float().to(memory_format=torch.contiguous_format)
        for module in list(self.network.modules()):
            for name, child in module.named_children():
                if isinstance(child, nn.AdaptiveAvgPool2d) and child.output_size in (1, (1, 1)):
                    setattr(module, name, _Mean())

    def forward(self, rgb: Tensor) -> Tensor:
        logits: Tensor = self.network(rgb.permute(0, 3, 1, 2).float())
        return logits


class _Mean(nn.Module):
    def forward(self, features: Tensor) -> Tensor:
        return features.mean((2, 3), keepdim=True)


def _trace(network: nn.Module) -> "onnx.ModelProto":
    """Trace a member without optimizing the graph, so that every initializer is a weight of the network."""
    level = logging.getLogger("torch.onnx").level
    logging.getLogger("torch.onnx").setLevel(logging.ERROR)
    try:
        with warnings.catch_warnings(), torch.inference_mode(False), torch.no_grad():
            warnings.simplefilter("ignore")
            program = torch.onnx.export(
                _Member(network).eval(),
                (torch.zeros((1, *_EXAMPLE_SIZE, 3), dtype=torch.uint8),),
                input_names=["rgb"],
                output_names=["logits"],
                opset_version=_OPSET,
                dynamo=True,
                optimize=False,
                verbose=False,
            )
    finally:
        logging.getLogger("torch.onnx").setLevel(level)
    assert program is not None
    model: onnx.ModelProto = program.model_proto
    return model


def _with_weights_of(network: nn.Module, trace: "onnx.ModelProto") -> "onnx.GraphProto":
    """Return the trace with a member's weights; the optimizer fuses batch normalization into convolutions."""
    import onnx
    import onnxscript.optimizer
    from onnx import numpy_helper

    model = onnx.ModelProto()
    model.CopyFrom(trace)
    own = dict([*network.named_parameters(prefix="network"), *network.named_buffers(prefix="network")])
    for item in model.graph.initializer:
        if item.name not in own:
            raise RuntimeError(f"the exporter computed {item.name}, which may differ between members")
        item.CopyFrom(numpy_helper.from_array(own[item.name].detach().cpu().float().contiguous().numpy(), item.name))
    return onnxscript.optimizer.optimize(model).graph


def _follow_image_size(graph: "onnx.GraphProto") -> None:
    """Replace the sizes and paddings that the trace has fixed by ones computed from the size of the image.

    Raises:
        RuntimeError: a map is not an integer fraction of the image, or another node fixes a size.
    """
    from onnx import helper, numpy_helper

    constants = {item.name: item for item in graph.initializer}
    for node in graph.node:
        if node.op_type == "Resize":
            size = numpy_helper.to_array(constants[node.input[3]])[2:]
            stride = _EXAMPLE_SIZE[0] // int(size[0])
            if tuple(stride * size) != _EXAMPLE_SIZE:
                raise RuntimeError(f"a map is upsampled to {size}, which is no integer fraction of {_EXAMPLE_SIZE}")
            inputs = [node.input[0], "rgb"]
            node.CopyFrom(helper.make_node("UpsampleToStride", inputs, node.output, domain=DOMAIN, stride=stride))
        elif node.op_type == "Conv":
            _pad_as_tensorflow(node)
        elif node.op_type in ("Reshape", "Expand", "Slice", "Tile"):
            raise RuntimeError(f"the traced network fixes a size in {node.op_type} {node.name}")


def _pad_as_tensorflow(convolution: "onnx.NodeProto") -> None:
    """Replace unequal padding, which fits even sizes only, by TensorFlow's "same" padding for any size."""
    from onnx import helper

    attributes = {item.name: item for item in convolution.attribute}
    pads = list(attributes["pads"].ints) if "pads" in attributes else []
    if pads[: len(pads) // 2] != pads[len(pads) // 2 :]:
        kept = [item for name, item in attributes.items() if name not in ("pads", "auto_pad")]
        del convolution.attribute[:]
        convolution.attribute.extend([*kept, helper.make_attribute("auto_pad", "SAME_UPPER")])


def _from_logits_to_outputs(n_members: int, temperature: float) -> str:
    """Return the graph from ``member_INDEX_logits`` to the outputs, in ONNX text syntax."""
    layers = [f"layer_{index}" for index in range(n_members)]
    unsqueezed = "\n".join(f"{name} = Unsqueeze (member_{index}_logits, axis)" for index, name in enumerate(layers))
    calibrated = "p_occupied = Identity (mean)"
    if temperature != 1.0:
        calibrated = f"""
            lowest = Constant <value_float = {NLL_CLIP!r}> ()
            highest = Constant <value_float = {1 - NLL_CLIP!r}> ()
            one = Constant <value_float = 1.0> ()
            temperature = Constant <value_float = {float(temperature)!r}> ()
            clipped = Clip (mean, lowest, highest)
            p_free = Sub (one, clipped)
            odds = Div (clipped, p_free)
            logit = Log (odds)
            scaled = Div (logit, temperature)
            p_occupied = Sigmoid (scaled)"""
    return f"""
        ensemble (uint8[batch, height, width, 3] rgb) => (
            float[batch, height, width] p_occupied,
            float[batch, {n_members}, height, width] member_p_occupied,
            float[batch, {n_members}, height, width] member_logits
        ) {{
            axis = Constant <value_ints = [1]> ()
            {unsqueezed}
            member_logits = Concat <axis = 1> ({", ".join(layers)})
            member_p_occupied = Sigmoid (member_logits)
            mean = ReduceMean <keepdims = 0> (member_p_occupied, axis)
            {calibrated}
        }}"""


def _needed(
    nodes: "list[onnx.NodeProto]", outputs: "Iterable[onnx.ValueInfoProto]"
) -> "tuple[list[onnx.NodeProto], set[str]]":
    """Return the nodes that ``outputs`` depend on, and the names they read; remove stack traces with machine paths."""
    read = {item.name for item in outputs}
    needed = []
    for node in reversed(nodes):
        if read.intersection(node.output):
            read.update(node.input)
            node.ClearField("name")
            node.ClearField("metadata_props")
            needed.append(node)
    return needed[::-1], read
