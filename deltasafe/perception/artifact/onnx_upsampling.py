"""The convolution that follows a bilinear enlargement, computed before it: the same function with a tenth of the work.

Both are linear, and the enlargement treats all channels alike, so that the sum over channels can be done first. At
the small size every tap (k_y, k_x) of the kernel gives maps of its own,

    y[k_y, k_x, o] = sum over c of W[o, c, k_y, k_x] x[c]

and to enlarge them and shift them by their taps is then one product with a matrix along each axis:

    out[o, Y, X] = sum over k_y, k_x, i, j of  U_h[i, Y + k_y - p] U_w[j, X + k_x - p] y[k_y, k_x, o, i, j]

where U enlarges, and is zero beyond the border as the convolution's padding of p is.
"""

from typing import TYPE_CHECKING

import numpy as np

from deltasafe.perception.artifact.onnx_graph import (
    Part,
    Sizes,
    Weights,
    attributes,
    is_plain_convolution,
    only_user,
    users_of,
)

if TYPE_CHECKING:
    import onnx

__all__ = ["convolve_before_upsampling"]

_TAPS = 3
_END = np.iinfo(np.int64).max
_FLOAT = 1


def convolve_before_upsampling(
    graph: "onnx.GraphProto", weights: list[Weights], sizes: Sizes, image_size: tuple[int, int]
) -> int:
    """Rewrite, in ``graph`` and all ``weights``, 3 x 3 convolutions of enlarged maps joined with others.

    Args:
        graph: one member; its ``image_size`` is a tensor (height, width), and ``NAME.target`` the size that the
            Resize with output NAME makes.
        weights: of each member; gain the rearranged ones.
        sizes: for the traced image.
        image_size: of the traced image.

    Returns:
        How many places were rewritten.
    """
    users = users_of(graph)
    found = []
    for node in graph.node:
        if node.op_type != "Resize" or attributes(node).get("mode") != b"linear" or not sizes.get(node.input[0]):
            continue
        join = only_user(users, node, "Concat")
        if join is None or len(join.input) != 2 or join.input[0] != node.output[0]:
            continue
        convolution = only_user(users, join, "Conv")
        if convolution is not None and is_plain_convolution(convolution, _TAPS):
            found.append((node, join, convolution))
    for resize, join, convolution in found:
        _, channels, height, width = sizes[resize.input[0]]
        strides = image_size[0] // height, image_size[1] // width
        _rewrite(graph, weights, resize, join, convolution, channels, strides)
    return len(found)


def _rewrite(
    graph: "onnx.GraphProto",
    weights: list[Weights],
    resize: "onnx.NodeProto",
    join: "onnx.NodeProto",
    convolution: "onnx.NodeProto",
    channels: int,
    strides: tuple[int, int],
) -> None:
    kernel = convolution.input[1]
    n_outputs = weights[0][kernel].shape[0]
    for named in weights:
        whole = named[kernel]
        taps = whole[:, :channels].transpose(3, 0, 2, 1)  # k_x, output, k_y, channel
        named[f"{kernel}.taps"] = np.ascontiguousarray(taps.reshape(-1, channels, 1, 1))
        named[f"{kernel}.others"] = np.ascontiguousarray(whole[:, channels:])
    enlarged = resize.output[0]
    part = Part(f"{enlarged}.after")
    rows = part.add("Transpose", [_matrix(part, resize, 0, strides[0])], "rows", perm=[1, 0])
    columns = _matrix(part, resize, 1, strides[1])
    maps = part.add("Conv", [resize.input[0], f"{kernel}.taps"], "maps", kernel_shape=[1, 1])
    # (B, k_x o k_y, h, w) -> (B, o k_y h, k_x w) -> (B, o k_y h, W) -> (B, o, k_y h, W) -> (B, o, H, W)
    apart = part.add("Reshape", [maps, part.integers("apart.shape", 0, _TAPS, -1, 0)], "apart")
    turned = part.add("Transpose", [apart], "turned", perm=[0, 2, 1, 3])
    flat = part.add("Reshape", [turned, part.integers("flat.shape", 0, 0, -1)], "flat")
    wide = part.add("MatMul", [flat, columns], "wide")
    width = part.add("Gather", [f"{enlarged}.target", part.integers("second", 1)], "width")
    shape = part.add("Concat", [part.integers("of_output", 0, n_outputs, -1), width], "stacked.shape", axis=0)
    large = part.add("MatMul", [rows, part.add("Reshape", [wide, shape], "stacked")], "large")
    inputs = [join.input[1], f"{kernel}.others", *convolution.input[2:]]
    others = part.add("Conv", inputs, "others", **attributes(convolution))
    part.named("Add", [others, large], convolution.output[0])
    gone = {enlarged, join.output[0], f"{enlarged}.size", f"{enlarged}.batch"}
    part.replace(graph, convolution.output[0], gone, weights)


def _matrix(part: Part, resize: "onnx.NodeProto", axis: int, stride: int) -> str:
    """(3 n, N): how much the taps k of N large places see of n small ones, row k n + i; for any n.

    The runtime makes it by enlarging the identity in the same way.
    """
    own = Part(f"{part.name}.{'rows' if axis == 0 else 'columns'}")
    index = own.integers("axis", axis)
    pixels = own.add("Gather", ["image_size", index], "pixels")
    small = own.ceil_divide(pixels, stride, output="small")
    large = own.add("Gather", [f"{resize.output[0]}.target", index], "large")
    zero, one = (own.add("Constant", [], name, value_int=value) for name, value in (("zero", 0), ("one", 1)))
    steps = own.add("Range", [zero, own.add("Squeeze", [small], "count"), one], "steps")
    row = own.add("Unsqueeze", [steps, own.integers("but_last", 0, 1, 2)], "row")
    column = own.add("Unsqueeze", [steps, own.integers("but_third", 0, 1, 3)], "column")
    identity = own.add("Cast", [own.add("Equal", [column, row], "same")], "identity", to=_FLOAT)
    size = own.add("Concat", [own.integers("outer", 1, 1), small, large], "size", axis=0)
    enlarging = own.add("Resize", [identity, "", "", size], "enlarging", **attributes(resize))
    padding = own.integers("padding", 0, 0, 0, 1, 0, 0, 0, 1)
    padded = own.add("Pad", [enlarging, padding], "padded")
    along = own.integers("along", 3)
    shifted = [
        own.add(
            "Slice",
            [padded, own.integers(f"from.{k}", k), own.integers(f"to.{k}", (k + 1 - _TAPS) or _END), along],
            f"shifted.{k}",
        )
        for k in range(_TAPS)
    ]
    together = own.add("Concat", shifted, "together", axis=2)
    matrix = own.add("Squeeze", [together, own.integers("both_outer", 0, 1)], "matrix")
    part.nodes += own.nodes
    return matrix
