"""What a rewriting of one member's ONNX graph needs: who uses what, new nodes, their exchange for old ones."""

from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    import onnx

__all__ = ["Part", "Sizes", "Weights", "attributes", "is_plain_convolution", "only_user", "sizes_of", "users_of"]

Weights = dict[str, NDArray[np.float32]]
"""Of one member: name -> value."""
Sizes = dict[str, tuple[int, ...]]
"""Name of a tensor -> its shape for the traced image."""


def sizes_of(graph: "onnx.GraphProto") -> Sizes:
    """Of those tensors whose shape the trace states."""
    return {item.name: tuple(each.dim_value for each in item.type.tensor_type.shape.dim) for item in graph.value_info}


def users_of(graph: "onnx.GraphProto") -> "dict[str, list[onnx.NodeProto]]":
    """Name of a tensor -> the nodes that read it."""
    users: dict[str, list[onnx.NodeProto]] = {}
    for node in graph.node:
        for name in node.input:
            users.setdefault(name, []).append(node)
    return users


def only_user(users: "dict[str, list[onnx.NodeProto]]", node: "onnx.NodeProto", kind: str) -> "onnx.NodeProto | None":
    """The node that reads ``node``'s result, if it is the only one and of this kind."""
    after = users.get(node.output[0], [])
    return after[0] if len(after) == 1 and after[0].op_type == kind else None


def attributes(node: "onnx.NodeProto") -> dict[str, Any]:
    """Name -> value."""
    from onnx import helper

    return {item.name: helper.get_attribute_value(item) for item in node.attribute}


def is_plain_convolution(node: "onnx.NodeProto", size: int) -> bool:
    """Of ``size`` x ``size``, over all channels, and of the size of its input."""
    if node.op_type != "Conv":
        return False
    has = attributes(node)
    return (
        has["kernel_shape"] == 2 * [size]
        and has.get("group", 1) == 1
        and set(has.get("strides", [1])) == set(has.get("dilations", [1])) == {1}
        and has.get("pads", [0, 0, 0, 0]) == 4 * [size // 2]
    )


class Part:
    """New nodes and weights that take the place of old ones.

    Args:
        name: what the names of new tensors begin with.
    """

    def __init__(self, name: str) -> None:
        self.name = name
        self.nodes: list[onnx.NodeProto] = []

    def add(self, kind: str, inputs: Iterable[str], output: str, **settings: Any) -> str:
        """A node with one output, of which the name is returned; ``output`` is made unique by the part's own name."""
        return self.named(kind, inputs, f"{self.name}.{output}", **settings)

    def named(self, kind: str, inputs: Iterable[str], output: str, **settings: Any) -> str:
        """The same, with an output that is called so."""
        from onnx import helper

        self.nodes.append(helper.make_node(kind, list(inputs), [output], **settings))
        return output

    def integers(self, output: str, *values: int) -> str:
        """A constant vector."""
        return self.add("Constant", [], output, value_ints=values)

    def ceil_divide(self, dividend: str, *divisors: int, output: str) -> str:
        """``dividend`` (non-negative integers) over ``divisors``, rounded up: the size of a strided map."""
        raised = self.integers(f"{output}.raising", *(divisor - 1 for divisor in divisors))
        sum_ = self.add("Add", [dividend, raised], f"{output}.raised")
        return self.add("Div", [sum_, self.integers(f"{output}.stride", *divisors)], output)

    def replace(self, graph: "onnx.GraphProto", last: str, others: set[str], weights: list[Weights]) -> None:
        """Put the nodes where ``last`` was computed; remove what computed ``others``, and weights that nobody reads."""
        from onnx import numpy_helper

        nodes: list[onnx.NodeProto] = []
        for node in graph.node:
            if node.output[0] == last:
                nodes += self.nodes
            elif node.output[0] not in others:
                nodes.append(type(node).FromString(node.SerializeToString()))
        read = {name for node in nodes for name in node.input}
        kept = [type(item).FromString(item.SerializeToString()) for item in graph.initializer if item.name in read]
        there = {item.name for item in kept}
        kept += [
            numpy_helper.from_array(value, name)
            for name, value in weights[0].items()
            if name in read and name not in there
        ]
        del graph.node[:], graph.initializer[:]
        graph.node.extend(nodes)
        graph.initializer.extend(kept)
