"""Integers stay integers through every operator, so that a division that follows truncates."""

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

import onnx
from onnx import TensorProto, helper, numpy_helper
from onnx.reference import ReferenceEvaluator

from kennfeld.graph.interpreter import evaluate
from kennfeld.importers.onnx.importing import onnx as read_network

ROWS = np.array([[3, 4], [-7, 2], [5, 9], [-6, -1]])
WEIGHTS = np.array([[1, 2], [3, -1]])
OPERATORS = {
    **{f"Reduce{kind}": ([1], {}) for kind in ("Sum", "Max", "Min", "Prod", "Mean", "L1", "SumSquare")},
    "MatMul": (WEIGHTS, {}),
    "Gemm": (WEIGHTS, {"transB": 1}),
    "Einsum": (WEIGHTS, {"equation": "ij,jk->ik"}),
    "Mod": (np.array([4, -3]), {"fmod": 1}),
    "Max": (np.array([2, 1]), {}),
    "Sub": (np.array([2, 1]), {}),
    "Concat": (WEIGHTS[:1], {"axis": 1}),
    "CumSum": (np.array(1), {}),
    "ArgMax": (None, {"axis": 1}),
    "TopK": (np.array([1]), {}),
}
SIZES = {kind: 4 if kind == "Concat" else 1 for kind in OPERATORS if kind[:6] in ("Reduce", "Concat", "ArgMax", "TopK")}


def network(path, kind):
    """An operator on two integers, and half of what it returns."""
    other, attributes = OPERATORS[kind]
    outputs = ["z", "places"] if kind == "TopK" else ["z"]
    node = helper.make_node(kind, ["x", *([] if other is None else ["other"])], outputs, **attributes)
    nodes = [node, helper.make_node("Div", ["z", "two"], ["y"])]
    constants = [numpy_helper.from_array(np.array(2), "two")]
    constants += [] if other is None else [numpy_helper.from_array(np.asarray(other, dtype=np.int64), "other")]
    shapes = {"x": [1, 2], "y": [1, SIZES.get(kind, 2)]}
    ports = [[helper.make_tensor_value_info(name, TensorProto.INT64, shape)] for name, shape in shapes.items()]
    graph = helper.make_graph(nodes, "n", *ports, constants)
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 18)], ir_version=8)
    onnx.save(model, path)
    return model


@pytest.mark.parametrize("kind", OPERATORS)
def test_half_of_a_result_is_truncated(tmp_path, kind):
    reference = ReferenceEvaluator(network(tmp_path / "n.onnx", kind))
    expected = np.array([reference.run(None, {"x": row[None]})[0].ravel() for row in ROWS])
    model = read_network(tmp_path / "n.onnx")
    channels = {name: ROWS[:, i].astype(float) for i, name in enumerate(model.graph.inputs)}
    outputs = evaluate(model.graph, channels, model.carried)
    np.testing.assert_array_equal(np.column_stack([outputs[name] for name in model.graph.outputs]), expected)
