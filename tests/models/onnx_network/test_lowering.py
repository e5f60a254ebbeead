"""The test networks of the package onnx whose operators are supported give the outputs that come with them."""

import warnings

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

from onnx import TensorProto, numpy_helper
from onnx.backend.test.case.node import collect_testcases

from kennfeld.errors import InputError
from kennfeld.graph.builder import GraphBuilder
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.onnx_network.importing import network_function
from kennfeld.models.onnx_network.lowering import unsupported
from kennfeld.models.onnx_network.reading import read_network

# differences from the standard, which docs/functions.md states
KNOWN = {
    "test_mod_float_edge_cases",  # infinite numbers
    "test_castlike",  # an input without elements
    "test_l2normalization_axis_0",  # its outputs are rounded to single precision
}
TOLERANCES = {"float16": 2e-2, "bfloat16": 2e-2, "float32": 2e-5}


def numbers(arrays):
    dense = [numpy_helper.to_array(each) if isinstance(each, TensorProto) else np.asarray(each) for each in arrays]
    return np.concatenate([array.astype(np.float64).ravel() for array in dense])


def computed(function, inputs):
    b = GraphBuilder()
    nodes = function.write(b, [b.input(f"i{number}") for number in range(len(inputs))])
    graph = b.finish({f"o{number}": node for number, node in enumerate(nodes)})
    columns = {f"i{number}": [value] for number, value in enumerate(inputs)}
    with np.errstate(all="ignore"):
        return np.array([values[0] for values in evaluate(graph, columns, function.values).values()])


def test_test_networks_give_their_outputs(tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of the package onnx
        cases = collect_testcases(None)
    compared, refused, wrong = 0, [], []
    for case in cases:
        (tmp_path / "net.onnx").write_bytes(case.model.SerializeToString())
        if case.name.startswith(tuple(KNOWN)):
            continue
        try:
            network = read_network(tmp_path / "net.onnx")
            if unsupported(network):
                continue
            function = network_function(network)
        except InputError as error:
            refused.append((case.name, str(error)))
            continue
        for inputs, outputs in case.data_sets:
            got, expected = computed(function, numbers([*inputs, np.zeros(0)])), numbers(outputs)
            kinds = {port.kind for port in (*network.inputs, *network.outputs)}
            tolerance = max([TOLERANCES.get(kind, 1e-10) for kind in kinds])
            if got.shape != expected.shape or not np.allclose(got, expected, tolerance, tolerance, equal_nan=True):
                wrong.append(case.name)
        compared += 1
    assert not wrong
    assert compared >= 400
    print(f"{compared} networks compared, {len(refused)} refused")
