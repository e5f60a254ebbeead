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


HALVES = (np.arange(-30, 31) + 0.5).astype(FLOAT) * FLOAT(0.1)


def outputs_of(model, columns):
    """The outputs of a model, [outputs, samples], in the order of its graph."""
    outputs = evaluate(model.graph, dict(zip(model.graph.inputs, columns, strict=True)), model.carried)
    return [np.broadcast_to(outputs[key], len(columns[0])) for key in model.graph.outputs]


@pytest.mark.parametrize("scale", [0.05, 0.1, 0.02, 0.3, 0.7])
def test_halves_of_a_scale_are_rounded_as_in_single_precision(scale, tmp_path):
    tensors = [numpy_helper.from_array(np.asarray(array), key) for key, array in (("s", FLOAT(scale)), ("z", UINT8(9)))]
    ports = [[helper.make_tensor_value_info(key, kind, [1])] for key, kind in (("x", 1), ("y", TensorProto.UINT8))]
    graph = helper.make_graph([node("QuantizeLinear", "x s z", "y")], "n", *ports, tensors)
    onnx.save(helper.make_model(graph, opset_imports=OPSETS, ir_version=8), tmp_path / "n.onnx")
    expected = np.clip(np.rint(HALVES / FLOAT(scale)) + 9, 0, 255)
    (y,) = outputs_of(read_network(tmp_path / "n.onnx"), [HALVES.astype(float)])
    np.testing.assert_array_equal(y, expected)


def test_halves_of_a_product_are_rounded_as_in_single_precision(tmp_path):
    scales = {"a": FLOAT(0.1), "b": FLOAT(0.7), "c": FLOAT(0.02)}
    constants = scales | {"one": FLOAT(1), "zero": UINT8(0), "w": np.ones((1, 1), UINT8)}
    nodes = [
        node("QuantizeLinear", "x one zero", "q"),
        node("QLinearMatMul", "q a zero w b zero c zero", "y"),
    ]
    ports = [[helper.make_tensor_value_info(key, kind, [1, 1])] for key, kind in (("x", 1), ("y", TensorProto.UINT8))]
    tensors = [numpy_helper.from_array(np.asarray(array), key) for key, array in constants.items()]
    graph = helper.make_graph(nodes, "n", *ports, tensors)
    onnx.save(helper.make_model(graph, opset_imports=OPSETS, ir_version=8), tmp_path / "n.onnx")
    products = np.arange(60)
    (y,) = outputs_of(read_network(tmp_path / "n.onnx"), [products.astype(float)])
    np.testing.assert_array_equal(y, np.rint(products.astype(FLOAT) * (scales["a"] * scales["b"] / scales["c"])))


def test_a_dynamic_scale_is_that_of_single_precision_where_it_decides_halves(tmp_path):
    kinds = {"y": TensorProto.UINT8, "s": TensorProto.FLOAT, "z": TensorProto.UINT8}
    ends = [helper.make_tensor_value_info(key, kind, [6] if key == "y" else []) for key, kind in kinds.items()]
    starts = [helper.make_tensor_value_info("x", TensorProto.FLOAT, [6])]
    graph = helper.make_graph([node("DynamicQuantizeLinear", "x", "y s z")], "n", starts, ends)
    network = helper.make_model(graph, opset_imports=OPSETS, ir_version=8)
    onnx.save(network, tmp_path / "n.onnx")
    rows = np.concatenate([[[0, 2, -3, -2.5, 1.34, 0.5]], RNG.choice(HALVES, (30, 6)), np.zeros((1, 6))]).astype(FLOAT)
    reference = ReferenceEvaluator(network)
    expected = [np.concatenate([np.ravel(part) for part in reference.run(None, {"x": row})]) for row in rows]
    outputs = np.transpose(outputs_of(read_network(tmp_path / "n.onnx"), rows.T.astype(float)))
    rows_without_zeros = slice(-1)  # ONNX leaves the scale of zeros open
    np.testing.assert_array_equal(outputs[:, [*range(6), 7]], np.array(expected)[:, [*range(6), 7]])
    np.testing.assert_allclose(outputs[rows_without_zeros, 6], np.array(expected)[rows_without_zeros, 6], rtol=1e-7)


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
