"""Small networks, written by the package onnx."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

OPSETS = [helper.make_opsetid("", 18), helper.make_opsetid("ai.onnx.ml", 3)]
KINDS = {np.float64: TensorProto.DOUBLE, np.float32: TensorProto.FLOAT}


def save(path: Path, nodes, inputs, outputs, constants=(), *, kind=np.float64, opsets=OPSETS) -> Path:
    """Write a network; `inputs` and `outputs` are shapes by name, `constants` arrays by name."""
    ports = [
        [helper.make_tensor_value_info(name, KINDS[kind], shape) for name, shape in each.items()]
        for each in (inputs, outputs)
    ]
    tensors = [numpy_helper.from_array(np.asarray(array), name) for name, array in dict(constants).items()]
    graph = helper.make_graph(list(nodes), "network", *ports, tensors)
    onnx.save(helper.make_model(graph, opset_imports=opsets, ir_version=8), path)
    return path


def random_layers(sizes, seed=0, kind=np.float64):
    """Weights [inputs, outputs] and biases of layers of these sizes."""
    random = np.random.default_rng(seed)
    return [
        (
            (random.standard_normal((a, b)) / np.sqrt(a)).astype(kind),
            (random.standard_normal(b) / 2).astype(kind),
        )
        for a, b in pairwise(sizes)
    ]


def perceptron(path: Path, layers, activation="Tanh", *, form="Gemm", kind=np.float64, **attributes) -> Path:
    """Write a perceptron with layers as `Gemm`, as `MatMul` and `Add`, or `written` out as products and sums."""
    nodes, constants, x = [], {}, "x"
    for number, (weights, biases) in enumerate(layers):
        last = number == len(layers) - 1
        names = w, b, product, total = [f"{name}{number}" for name in "wbpz"]
        constants |= {w: weights, b: biases}
        y = "y" if last else f"a{number}"
        if form == "Gemm":
            nodes.append(helper.make_node("Gemm", [x, w, b], [y if last else total]))
        elif form == "MatMul":
            nodes.append(helper.make_node("MatMul", [x, w], [product]))
            nodes.append(helper.make_node("Add", [b, product], [y if last else total]))
        else:
            constants |= {"axis": np.array([1]), "last": np.array([2])}
            nodes.append(helper.make_node("Unsqueeze", [x, "last"], [f"column{number}"]))
            nodes.append(helper.make_node("Mul", [f"column{number}", w], [f"parts{number}"]))
            nodes.append(helper.make_node("ReduceSum", [f"parts{number}", "axis"], [product], keepdims=0))
            nodes.append(helper.make_node("Add", [product, b], [y if last else total]))
        if not last:
            nodes.append(helper.make_node(activation, [names[3]], [y], **attributes))
            x = y
    shapes = {"x": ["batch", len(layers[0][0])]}, {"y": ["batch", len(layers[-1][1])]}
    return save(path, nodes, *shapes, constants, kind=kind)
