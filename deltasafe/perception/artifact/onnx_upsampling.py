"""Bilinear upsampling in the ONNX program, as ONNX functions: for any image size, and fused with a convolution.

Upsampling and convolution are linear, and upsampling treats all channels alike. So the sum over the channels c can be
computed first, at the small size, once for each tap (k_y, k_x) of the kernel W:

    y[k_y, k_x, o] = sum over c of W[o, c, k_y, k_x] x[c]

Upsampling these maps and shifting them by their taps is one matrix product along each axis:

    out[o, Y, X] = sum over k_y, k_x, i, j of  U_h[i, Y + k_y - 1] U_w[j, X + k_x - 1] y[k_y, k_x, o, i, j]

U is the upsampling matrix, zero beyond the border like the padding of the convolution. The result is the same with a
tenth of the multiplications (decision 35).
"""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import onnx

DOMAIN = "deltasafe"
_FUNCTIONS = (
    """
    UpsampleToStride <stride> (x, rgb) => (upsampled) {
        # height and width of a map of this stride: the image's, divided and rounded up
        stride = Constant <value_int: int = @stride> ()
        one = Constant <value_int = 1> ()
        image = Shape <start = 1, end = 3> (rgb)
        below = Sub (image, one)
        floor = Div (below, stride)
        size = Add (floor, one)
        batch_channels = Shape <start = 0, end = 2> (x)
        shape = Concat <axis = 0> (batch_channels, size)
        upsampled = Resize <mode = "linear", coordinate_transformation_mode = "pytorch_half_pixel"> (x, , , shape)
    }
    """,
    """
    UpsamplingMatrix (small, large) => (matrix) {
        # for sizes n and N: U of shape (1, 1, n, N) is the upsampled identity
        square = Concat <axis = 0> (small, small)
        zeros = ConstantOfShape (square)
        identity = EyeLike (zeros)
        outer_axes = Constant <value_ints = [0, 1]> ()
        basis = Unsqueeze (identity, outer_axes)
        ones = Constant <value_ints = [1, 1]> ()
        shape = Concat <axis = 0> (ones, small, large)
        u = Resize <mode = "linear", coordinate_transformation_mode = "pytorch_half_pixel"> (basis, , , shape)
        # (1, 3, n, N): U shifted by each tap -> (3 n, N)
        taps = Constant <value = float[3, 1, 1, 3] {1, 0, 0, 0, 1, 0, 0, 0, 1}> ()
        shifted = Conv <kernel_shape = [1, 3], pads = [0, 1, 0, 1]> (u, taps)
        matrix = Flatten <axis = 3> (shifted)
    }
    """,
    """
    ConvolveUpsampled (x, skip, x_taps, skip_kernel, bias) => (convolved) {
        small_height = Shape <start = 2, end = 3> (x)
        small_width = Shape <start = 3, end = 4> (x)
        height = Shape <start = 2, end = 3> (skip)
        width = Shape <start = 3, end = 4> (skip)
        columns = deltasafe.UpsamplingMatrix (small_width, width)
        rows = deltasafe.UpsamplingMatrix (small_height, height)
        rows_transposed = Transpose <perm = [1, 0]> (rows)
        # (B, k_x o k_y, h, w) -> (B, o k_y h, k_x w) -> (B, o k_y h, W)
        maps = Conv <kernel_shape = [1, 1]> (x, x_taps)
        maps_shape = Constant <value_ints = [0, 3, -1, 0]> ()
        by_tap = Reshape (maps, maps_shape)
        taps_inside = Transpose <perm = [0, 2, 1, 3]> (by_tap)
        flat_shape = Constant <value_ints = [0, 0, -1]> ()
        flat = Reshape (taps_inside, flat_shape)
        wide = MatMul (flat, columns)
        # -> (B, o, k_y h, W) -> (B, o, H, W)
        batch = Constant <value_ints = [0]> ()
        n_outputs = Shape <start = 0, end = 1> (skip_kernel)
        rest = Constant <value_ints = [-1]> ()
        wide_shape = Concat <axis = 0> (batch, n_outputs, rest, width)
        by_output = Reshape (wide, wide_shape)
        of_x = MatMul (rows_transposed, by_output)
        of_skip = Conv <kernel_shape = [3, 3], pads = [1, 1, 1, 1]> (skip, skip_kernel, bias)
        convolved = Add (of_skip, of_x)
    }
    """,
)


def upsampling_functions() -> "list[onnx.FunctionProto]":
    """Return the ONNX functions that the rewritten graphs call, of the domain `DOMAIN`."""
    from onnx import parser

    header = f'<opset_import: ["" : 18, "{DOMAIN}" : 1], domain: "{DOMAIN}">'
    return [parser.parse_function(header + text) for text in _FUNCTIONS]


def convolve_before_upsampling(graph: "onnx.GraphProto") -> None:
    """Replace 3 x 3 convolutions of (upsampled map, other map) in a member's graph by `ConvolveUpsampled`."""
    from onnx import helper, numpy_helper

    shapes = {item.name: [each.dim_value for each in item.type.tensor_type.shape.dim] for item in graph.value_info}
    weights = {item.name: item for item in graph.initializer}
    producers = {node.output[0]: node for node in graph.node}
    for convolution in graph.node:
        concatenation = producers.get(convolution.input[0]) if _is_plain_3x3(convolution) else None
        if concatenation is None or concatenation.op_type != "Concat" or len(concatenation.input) != 2:
            continue
        upsampling = producers.get(concatenation.input[0])
        if upsampling is None or upsampling.op_type != "UpsampleToStride":
            continue
        x, name = upsampling.input[0], convolution.input[1]
        kernel, channels = numpy_helper.to_array(weights[name]), shapes[x][1]
        x_taps = kernel[:, :channels].transpose(3, 0, 2, 1).reshape(-1, channels, 1, 1)  # k_x o k_y, c
        skip_kernel = kernel[:, channels:]
        graph.initializer.append(numpy_helper.from_array(x_taps, f"{name}.x_taps"))
        graph.initializer.append(numpy_helper.from_array(skip_kernel, f"{name}.skip"))
        inputs = [x, concatenation.input[1], f"{name}.x_taps", f"{name}.skip", *convolution.input[2:]]
        convolution.CopyFrom(helper.make_node("ConvolveUpsampled", inputs, convolution.output, domain=DOMAIN))


def _is_plain_3x3(node: "onnx.NodeProto") -> bool:
    """Whether a node is a dense 3 x 3 convolution without stride or dilation, padded by one."""
    from onnx import helper

    if node.op_type != "Conv":
        return False
    values = {item.name: helper.get_attribute_value(item) for item in node.attribute}
    return (
        values["kernel_shape"] == [3, 3]
        and values.get("pads") == [1, 1, 1, 1]
        and values.get("group", 1) == 1
        and {*values.get("strides", [1]), *values.get("dilations", [1])} == {1}
    )
