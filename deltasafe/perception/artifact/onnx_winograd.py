"""A 3 x 3 convolution with half the multiplications: Winograd's F(4, 3) along the columns of the image.

Four rows of the result come of six rows of the input, and with constant matrices A, B, G

    y = A^T [(G w) * (B^T x)]

takes six products in place of twelve (A. Lavin, S. Gray, Fast Algorithms for Convolutional Neural Networks, CVPR 2016).
Within a row the convolution stays as it is: that costs less in rounding and in moving of data than F(4 x 4, 3 x 3).
"""

from typing import TYPE_CHECKING

import numpy as np

from deltasafe.perception.artifact.onnx_graph import Part, Sizes, Weights, is_plain_convolution, only_user, users_of

if TYPE_CHECKING:
    import onnx

__all__ = ["rewrite_as_winograd"]

_ROWS = 4
_INPUT = (
    (4, 0, -5, 0, 1, 0),
    (0, -4, -4, 1, 1, 0),
    (0, 4, -4, -1, 1, 0),
    (0, -2, -1, 2, 1, 0),
    (0, 2, -1, -2, 1, 0),
    (0, 4, 0, -5, 0, 1),
)
"""B^T."""
_KERNEL = ((6, 0, 0), (-4, -4, -4), (-4, 4, -4), (1, 2, 4), (1, -2, 4), (0, 0, 24))
"""24 G."""
_OUTPUT = ((1, 1, 1, 1, 1, 0), (0, 1, -1, 2, -2, 0), (0, 1, 1, 4, 4, 0), (0, 1, -1, 8, -8, 1))
"""A^T."""
_BIASED = 1
"""The product that A^T adds to each row once: it takes the bias."""
_BELOW = _ROWS
"""Rows of padding: one for the 3 x 3 kernel, and up to three that complete the last four rows. A multiple of four does
not need those three; the strided convolution then ends before them."""
_COARSEST_STRIDE = 4
"""Of the rewritten maps. Coarser maps have so few rows that padding is a large part of them."""
_FEW = 8


def rewrite_as_winograd(graph: "onnx.GraphProto", weights: list[Weights], sizes: Sizes, image_height: int) -> int:
    """Rewrite, in ``graph`` and all ``weights``, each 3 x 3 convolution, Relu, 1 x 1 convolution to few maps.

    The rows of the result are put in order only after the last, where there are few maps. Rows are padded to a
    multiple of four, and the surplus is cut off at the end.

    Args:
        graph: one member.
        weights: of each member; gain the transformed ones.
        sizes: for the traced image.
        image_height: of the traced image.

    Returns:
        How many places were rewritten.
    """
    users = users_of(graph)
    found = []
    for node in graph.node:
        if not is_plain_convolution(node, 3) or not sizes.get(node.output[0]):
            continue
        stride = image_height // sizes[node.output[0]][2]
        activation = only_user(users, node, "Relu")
        last = only_user(users, activation, "Conv") if activation is not None else None
        if last is not None and is_plain_convolution(last, 1) and stride <= _COARSEST_STRIDE:
            n_outputs, n_inputs = weights[0][last.input[1]].shape[:2]
            if _FEW * n_outputs <= n_inputs:
                found.append((node, activation, last))
    for convolution, activation, last in found:
        assert activation is not None
        _rewrite(graph, weights, convolution, activation, last)
    return len(found)


def _rewrite(
    graph: "onnx.GraphProto",
    weights: list[Weights],
    convolution: "onnx.NodeProto",
    activation: "onnx.NodeProto",
    last: "onnx.NodeProto",
) -> None:
    source, kernel, *bias = convolution.input
    channels = weights[0][kernel].shape[1]
    for named in weights:
        _transform(named, kernel)
    part = Part(f"{convolution.output[0]}.winograd")
    products = []
    for index in range(len(_INPUT)):
        rows = part.add(
            "Conv",
            [source, f"{kernel}.input.{index}"],
            f"rows.{index}",
            kernel_shape=[len(_INPUT), 1],
            strides=[_ROWS, 1],
            pads=[1, 0, _BELOW, 0],
            group=channels,
        )
        inputs = [rows, f"{kernel}.{index}", *(bias if index == _BIASED else [])]
        products.append(part.add("Conv", inputs, f"product.{index}", kernel_shape=[1, 3], pads=[0, 1, 0, 1]))
    # (B, 6 c, h, w) -> (B, 6, c h w) -> (B, 4, c h w) -> (4 B, c, h, w): the four rows as a batch
    together = part.add("Concat", products, "together", axis=1)
    flat = part.add("Reshape", [together, part.integers("flat.shape", 0, len(_INPUT), -1)], "flat")
    four = part.add("MatMul", [f"{kernel}.output", flat], "four")
    maps = part.add("Concat", [part.integers("any", -1), _shape(part, products[0], 1)], "maps.shape", axis=0)
    maps = part.add("Relu", [part.add("Reshape", [four, maps], "maps")], "activated")
    few = part.add("Conv", [maps, *last.input[1:]], "few", kernel_shape=[1, 1])
    # (4 B, o, h, w) -> (B, 4, o, h, w) -> (B, o, h, 4, w) -> (B, o, 4 h, w)
    shape = part.add("Concat", [part.integers("four_of_any", -1, _ROWS), _shape(part, few, 1)], "apart.shape", axis=0)
    apart = part.add("Reshape", [few, shape], "apart")
    turned = part.add("Transpose", [apart], "turned", perm=[0, 2, 3, 1, 4])
    shape = part.add("Concat", [part.integers("of_any", 0, 0, -1), _shape(part, few, 3)], "ordered.shape", axis=0)
    padded = part.add("Reshape", [turned, shape], "padded")
    height = part.add("Shape", [source], "height", start=2, end=3)
    bounds = [part.integers("first", 0), height, part.integers("along", 2)]
    part.named("Slice", [padded, *bounds], last.output[0])
    part.replace(graph, last.output[0], {convolution.output[0], activation.output[0]}, weights)


def _shape(part: Part, of: str, start: int) -> str:
    return part.add("Shape", [of], f"{of}.from.{start}", start=start)


def _transform(named: Weights, kernel: str) -> None:
    whole = named[kernel].astype(np.float64)
    channels = whole.shape[1]
    for index, (of_input, (above, middle, below)) in enumerate(zip(_INPUT, _KERNEL, strict=True)):
        row = (above * whole[:, :, 0] + middle * whole[:, :, 1] + below * whole[:, :, 2]) / 24
        named[f"{kernel}.{index}"] = np.ascontiguousarray(row[:, :, None], dtype=np.float32)
        taps = np.array(of_input, dtype=np.float32).reshape(1, 1, -1, 1)
        named[f"{kernel}.input.{index}"] = np.tile(taps, (channels, 1, 1, 1))
    named[f"{kernel}.output"] = np.array(_OUTPUT, dtype=np.float32)
