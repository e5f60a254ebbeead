"""Products of quantised numbers, dynamic scales and places that depend on the inputs, against ONNX itself."""

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

import onnx
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from kennfeld.graph.interpreter import evaluate
from kennfeld.importers.onnx.importing import onnx as read_network

RNG = np.random.default_rng(4)
ROWS = RNG.normal(0, 2, (12, 3)).astype(np.float32)
BYTES = RNG.integers(0, 256, (3, 2)).astype(np.uint8)
OPSETS = [helper.make_opsetid("", 18), helper.make_opsetid("ai.onnx.ml", 3)]
FLOAT, UINT8 = np.float32, np.uint8
CONSTANTS = {
    "scale": FLOAT(0.05), "zero": UINT8(117), "weights": BYTES, "scales": np.array([0.02, 0.3], FLOAT),
    "zeros": np.array([100, 130], UINT8), "out": FLOAT(0.4), "out_zero": UINT8(3), "half": FLOAT(2.0),
    "table": np.arange(12.0, dtype=FLOAT), "shape": np.array([4, 3]),
}  # fmt: skip


def node(kind, inputs, outputs, **attributes):
    return helper.make_node(kind, inputs.split(), outputs.split(), **attributes)


QUANTIZED = node("QuantizeLinear", "x scale zero", "q")
DYNAMIC = node("DynamicQuantizeLinear", "x", "q s z")
PLACES = [node("Abs", "x", "a"), node("Min", "a half", "m"), node("Cast", "m", "i", to=TensorProto.INT64)]
NETWORKS = {
    "MatMulInteger": [QUANTIZED, node("MatMulInteger", "q weights zero zeros", "p")],
    "dynamic zero points": [DYNAMIC, node("MatMulInteger", "q weights z", "p")],
    "QLinearMatMul": [
        QUANTIZED,
        node("QLinearMatMul", "q scale zero weights scales zeros out out_zero", "p"),
    ],
    "GatherElements": [
        *PLACES,
        node("Reshape", "table shape", "r"),
        node("GatherElements", "r i", "p", axis=0),
    ],
    "OneHotEncoder": [*PLACES, node("OneHotEncoder", "i", "p", domain="ai.onnx.ml", cats_int64s=[0, 2, 1, 7])],
}


@pytest.mark.parametrize("name", NETWORKS)
def test_it_computes_what_the_reference_computes(name, tmp_path):
    nodes = [*NETWORKS[name], helper.make_node("Cast", ["p"], ["y"], to=TensorProto.FLOAT)]
    tensors = [numpy_helper.from_array(np.asarray(array), key) for key, array in CONSTANTS.items()]
    shapes = {"x": [1, 3], "y": [1, 3, 4] if name == "OneHotEncoder" else [1, 3 if name == "GatherElements" else 2]}
    ports = [[helper.make_tensor_value_info(key, TensorProto.FLOAT, shape)] for key, shape in shapes.items()]
    network = helper.make_model(helper.make_graph(nodes, "n", *ports, tensors), opset_imports=OPSETS, ir_version=8)
    onnx.save(network, tmp_path / "n.onnx")
    reference = ReferenceEvaluator(network)
    expected = np.array([reference.run(None, {"x": row[None]})[0].ravel() for row in ROWS])
    model = read_network(tmp_path / "n.onnx")
    channels = {key: ROWS[:, at].astype(float) for at, key in enumerate(model.graph.inputs)}
    outputs = evaluate(model.graph, channels, model.carried)
    columns = [np.broadcast_to(outputs[key], len(ROWS)) for key in model.graph.outputs]
    np.testing.assert_array_equal(np.column_stack(columns), expected)
