"""A network of two hidden layers of tanh with a map before and a curve after it, as ONNX file and in numpy.

y = After(net(Before(n, load), T))
"""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

__all__ = ["AFTER", "BEFORE", "FORMULA", "LOAD", "SPEED", "START", "data_of", "write_network"]

Float = NDArray[np.float64]
FORMULA = "raw = net(Before(n, load), T)\ny = After(raw)"
SPEED, LOAD = np.linspace(1000.0, 6000.0, 8), np.linspace(10.0, 100.0, 6)  # axes of Before
AFTER = np.linspace(-2.0, 2.0, 10)  # axis of After
BEFORE = 0.8 * np.sin(SPEED[:, None] / 2000) * (LOAD / 100) + 0.3  # the values that made the data
START = {"Before": np.tile(LOAD / 100 - 0.3, (8, 1)), "After": 0.5 * AFTER}
NOISE = 0.01


def write_network(path: Path, width: int) -> Path:
    """Write a network of 2 inputs, two hidden layers of `width` neurons and one output, in double precision."""
    import onnx
    from onnx import TensorProto, helper, numpy_helper

    random = np.random.default_rng(width)
    sizes, nodes, tensors, x = (2, width, width, 1), [], [], "x"
    for number in range(3):
        weights = random.normal(0, 1.5 / np.sqrt(sizes[number]), (sizes[number], sizes[number + 1]))
        biases = random.normal(0, 0.3, sizes[number + 1])
        tensors += [numpy_helper.from_array(weights, f"w{number}"), numpy_helper.from_array(biases, f"b{number}")]
        z = f"z{number}" if number < 2 else "y"
        nodes.append(helper.make_node("Gemm", [x, f"w{number}", f"b{number}"], [z]))
        if number < 2:
            x = f"a{number}"
            nodes.append(helper.make_node("Tanh", [z], [x]))
    ports = [
        [helper.make_tensor_value_info(name, TensorProto.DOUBLE, ["batch", size])]
        for name, size in (("x", 2), ("y", 1))
    ]
    graph = helper.make_graph(nodes, "network", *ports, tensors)
    onnx.save(helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8), path)
    return path


def data_of(samples: int) -> dict[str, Float]:
    """The inputs of all samples."""
    random = np.random.default_rng(0)
    low, high = (1000.0, 10.0, -1.0), (6000.0, 100.0, 1.0)
    return dict(zip(("n", "load", "T"), random.uniform(low, high, (samples, 3)).T.copy(), strict=True))
