"""Files that are damaged, too large or hostile are refused with one clear message."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("onnx", reason="the package onnx is not installed")

import onnx
from onnx import TensorProto, external_data_helper, helper, numpy_helper

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.importers.onnx import loops, reading, tensors
from kennfeld.importers.onnx.reading import read_network
from tests.importers.onnx.networks import perceptron, random_layers, save


def network(tmp_path, **options):
    return perceptron(tmp_path / "net.onnx", random_layers([2, 40, 1]), **options)


def with_external_data(tmp_path, location="weights.bin"):
    """A network whose first weights are in a file of their own; `location` is written in place of its name."""
    model = onnx.load(network(tmp_path))
    for tensor in model.graph.initializer:
        external_data_helper.set_external_data(tensor, "weights.bin")
    onnx.save(model, tmp_path / "net.onnx")
    model = onnx.load(tmp_path / "net.onnx", load_external_data=False)
    for tensor in model.graph.initializer:
        tensor.external_data[0].value = location
    (tmp_path / "net.onnx").write_bytes(model.SerializeToString())
    return tmp_path / "net.onnx"


def message_of(path):
    with pytest.raises(InputError) as caught:
        kf.onnx(path)
    return str(caught.value)


@pytest.mark.parametrize("content", [b"", b"\x00" * 50, b"not a network", b"\x08\x08" + b"\xff" * 300])
def test_a_file_of_another_kind_is_refused(tmp_path, content):
    (tmp_path / "net.onnx").write_bytes(content)
    assert message_of(tmp_path / "net.onnx").count("\n") == 0


def test_every_cut_of_a_file_is_refused_or_read(tmp_path):
    content = network(tmp_path).read_bytes()
    for end in range(0, len(content), 37):
        (tmp_path / "cut.onnx").write_bytes(content[:end])
        try:
            kf.onnx(tmp_path / "cut.onnx")
        except InputError as error:
            assert "cut.onnx" in str(error)  # noqa: PT017


@pytest.mark.parametrize("count", [60, pytest.param(300, marks=pytest.mark.slow)])
def test_every_changed_byte_is_refused_or_read(tmp_path, count):
    content, random = network(tmp_path).read_bytes(), np.random.default_rng(0)
    for _ in range(count):
        changed = bytearray(content)
        for at in random.integers(0, len(content), 3):
            changed[at] = random.integers(0, 256)
        (tmp_path / "changed.onnx").write_bytes(changed)
        try:
            kf.onnx(tmp_path / "changed.onnx")
        except InputError as error:
            assert "changed.onnx" in str(error)  # noqa: PT017


def test_external_data_are_read_from_the_folder_of_the_network(tmp_path):
    plain = read_network(network(tmp_path)).constants
    assert not (tmp_path / "weights.bin").exists()
    external = read_network(with_external_data(tmp_path)).constants
    assert (tmp_path / "weights.bin").exists()
    for name, array in plain.items():
        np.testing.assert_array_equal(external[name], array)


@pytest.mark.parametrize("location", ["../weights.bin", "/etc/passwd", "sub/../../weights.bin", ""])
def test_external_data_outside_of_the_folder_are_refused(tmp_path, location):
    (tmp_path / "inside").mkdir()
    path = with_external_data(tmp_path / "inside", location)
    (tmp_path / "weights.bin").write_bytes(b"\0" * 10_000)
    assert "outside of the folder" in message_of(path)


def test_a_link_that_leads_out_of_the_folder_is_refused(tmp_path):
    (tmp_path / "inside").mkdir()
    path = with_external_data(tmp_path / "inside")
    (tmp_path / "inside" / "weights.bin").rename(tmp_path / "secret.bin")
    (tmp_path / "inside" / "weights.bin").symlink_to(tmp_path / "secret.bin")
    assert "outside of the folder" in message_of(path)


def test_missing_and_short_external_data_are_refused(tmp_path):
    path = with_external_data(tmp_path)
    content = (tmp_path / "weights.bin").read_bytes()
    (tmp_path / "weights.bin").write_bytes(content[: len(content) // 2])
    assert "ends within the data" in message_of(path)
    (tmp_path / "weights.bin").unlink()
    assert "weights.bin with its data does not exist" in message_of(path)


def test_a_large_file_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = network(tmp_path)
    monkeypatch.setattr(reading, "MAX_FILE", 100)
    assert "the maximum is 100" in message_of(path)


def test_a_small_file_that_creates_large_tensors_is_refused(tmp_path):
    nodes = [
        helper.make_node("ConstantOfShape", ["shape"], ["large"]),
        helper.make_node("Add", ["x", "large"], ["y"]),
    ]
    path = save(tmp_path / "net.onnx", nodes, {"x": [1]}, {"y": ["a", "b"]}, {"shape": np.array([10**6, 10**6])})
    assert "the maximum is 1000000" in message_of(path)


@pytest.mark.parametrize(
    ("attributes", "reason"),
    [
        ({"group": 0}, "its kernel does not fit 2 channels in 0 groups"),
        ({"group": 2}, "its kernel does not fit 2 channels in 2 groups"),
        ({"strides": [0], "auto_pad": "SAME_UPPER"}, "its windows have invalid sizes"),
        ({"strides": [1], "dilations": [-1]}, "its windows have invalid sizes"),
    ],
)
def test_damaged_attributes_of_a_convolution_are_refused(tmp_path, attributes, reason):
    node = helper.make_node("Conv", ["x", "kernel"], ["y"], **attributes)
    path = save(tmp_path / "net.onnx", [node], {"x": [1, 2, 4]}, {"y": ["a", "b", "c"]}, {"kernel": np.ones((2, 2, 3))})
    assert reason in message_of(path)


def test_a_network_that_grows_without_bound_is_refused(tmp_path):
    nodes = [helper.make_node("Concat", [f"t{i}"] * 8, [f"t{i + 1}"], axis=0) for i in range(12)]
    path = save(tmp_path / "net.onnx", nodes, {"t0": [1]}, {"t12": ["n"]})
    assert "the maximum is 1000000" in message_of(path)


def with_functions(tmp_path, calls):
    """A network that calls function `F0`; `calls` are the operators of each function."""
    path = save(tmp_path / "net.onnx", [helper.make_node("F0", ["x"], ["y"], domain="local")], {"x": [1]}, {"y": [1]})
    model, opsets = onnx.load(path), [helper.make_opsetid("", 18), helper.make_opsetid("local", 1)]
    model.opset_import.append(opsets[1])
    for number, kinds in enumerate(calls):
        names = ["a", *(f"t{i}" for i in range(len(kinds) - 1)), "b"]
        nodes = [
            helper.make_node(kind, [first], [second], domain="local" if kind.startswith("F") else "")
            for kind, (first, second) in zip(kinds, pairwise(names), strict=True)
        ]
        model.functions.append(helper.make_function("local", f"F{number}", ["a"], ["b"], nodes, opsets))
    onnx.save(model, path)
    return path


def test_functions_of_the_file_are_replaced_by_their_operators(tmp_path):
    path = with_functions(tmp_path, [["F1", "F1"], ["Tanh", "Sin"]])
    model = kf.onnx(path)
    expected = np.sin(np.tanh(np.sin(np.tanh(0.5))))
    assert kf.simulate(model, {"x": [0.5]}, {})["y"].values[0] == pytest.approx(expected, rel=1e-14)


def test_functions_that_multiply_are_refused_before_they_fill_the_memory(tmp_path):
    calls = [[f"F{number + 1}"] * 2 for number in range(60)]
    assert f"has {2**60} operators; the maximum is 20000" in message_of(with_functions(tmp_path, [*calls, ["Tanh"]]))


@pytest.mark.parametrize("calls", [[["F0"]], [["F1"], ["F0"]], [*([f"F{n + 1}"] for n in range(150)), ["Tanh"]]])
def test_functions_that_call_themselves_or_nest_too_deeply_are_refused(tmp_path, calls):
    assert "call themselves, or each other in more than 100 levels" in message_of(with_functions(tmp_path, calls))


def test_constants_of_functions_are_not_read_from_other_folders(tmp_path, monkeypatch):
    """The package onnx would read them from the working directory."""
    (tmp_path / "inside").mkdir()
    path = with_functions(tmp_path / "inside", [["Tanh"]])
    model = onnx.load(path)
    tensor = numpy_helper.from_array(np.array([0.0]))
    external_data_helper.set_external_data(tensor, "secret.bin")
    tensor.ClearField("raw_data")
    nodes = [helper.make_node("Constant", [], ["c"], value=tensor), helper.make_node("Add", ["a", "c"], ["b"])]
    model.functions[0].ClearField("node")
    model.functions[0].node.extend(nodes)
    path.write_bytes(model.SerializeToString())
    (tmp_path / "secret.bin").write_bytes(np.array([41.0]).tobytes())
    monkeypatch.chdir(tmp_path)
    assert "secret.bin with its data does not exist" in message_of(path)
    (tmp_path / "inside" / "secret.bin").write_bytes(np.array([1.0]).tobytes())
    assert kf.simulate(kf.onnx(path), {"x": [0.5]}, {})["y"].values.tolist() == [1.5]


def scan(tmp_path, kinds=("Add", "Tanh"), rows=3, second="row", **attributes):
    """A network that adds the rows of `x` to a state, one after the other."""
    real = TensorProto.DOUBLE
    inputs, outputs = (
        [helper.make_tensor_value_info(name, real, [2]) for name in names] for names in (("state", "row"), ("z", "y"))
    )
    nodes = [helper.make_node(kinds[0], ["state", second], ["z"]), helper.make_node(kinds[1], ["z"], ["y"])]
    body = helper.make_graph(nodes, "body", inputs, outputs)
    node = helper.make_node("Scan", ["start", "x"], ["end", "all"], body=body, num_scan_inputs=1, **attributes)
    return save(
        tmp_path / "net.onnx", [node], {"x": [rows, 2]}, {"end": [2], "all": [rows, 2]}, {"start": np.array([0.5, 0.0])}
    )


def test_a_loop_over_rows_carries_its_state_and_stacks_its_results(tmp_path):
    x = np.array([[1.0, 2.0], [-0.5, 0.1], [0.3, 0.4]])
    data = {f"x[{i},{j}]": [x[i, j]] for i in range(3) for j in range(2)}
    result = kf.simulate(kf.onnx(scan(tmp_path)), data, {})
    sums = np.cumsum(x, axis=0) + np.array([0.5, 0.0])
    actual = [result[f"all[{i},{j}]"].values[0] for i in range(3) for j in range(2)]
    np.testing.assert_allclose(actual, np.tanh(sums).ravel(), rtol=1e-14)
    assert [result[f"end[{j}]"].values[0] for j in range(2)] == pytest.approx(sums[-1], rel=1e-14)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"kinds": ("Add", "Det")}, "operator Det within it is not supported"),
        ({"scan_input_directions": [1]}, "reversed directions are not supported"),
    ],
)
def test_loops_that_are_not_supported_are_refused_by_name(tmp_path, options, message):
    assert message in message_of(scan(tmp_path, **options))


def test_loops_of_many_passes_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(loops, "MAX_COMPUTATIONS", 5)
    assert "its 3 passes take more than 5 operators" in message_of(scan(tmp_path))


def test_all_missing_operators_are_named_at_once(tmp_path):
    nodes = [
        helper.make_node("Det", ["x"], ["a"]),
        helper.make_node("Tanh", ["a"], ["b"]),
        helper.make_node("Det", ["b"], ["c"]),
        helper.make_node("LRN", ["c"], ["y"], size=3),
    ]
    path = save(tmp_path / "net.onnx", nodes, {"x": [1, 1]}, {"y": ["n", 1]})
    with pytest.raises(InputError) as caught:
        kf.onnx(path)
    messages = [finding.message for finding in caught.value.findings]
    assert messages == ["operator Det is not supported (2 times)", "operator LRN is not supported"]


def test_an_input_of_unknown_shape_is_refused_by_name(tmp_path):
    node = helper.make_node("Tanh", ["x"], ["y"])
    assert "not stated: x" in message_of(
        save(tmp_path / "net.onnx", [node], {"x": [1, "length"]}, {"y": [1, "length"]})
    )


def test_an_input_other_than_a_tensor_is_refused(tmp_path):
    sequence = helper.make_tensor_sequence_value_info("x", TensorProto.FLOAT, [1])
    output = helper.make_tensor_value_info("y", TensorProto.FLOAT, [1])
    graph = helper.make_graph([helper.make_node("ConcatFromSequence", ["x"], ["y"], axis=0)], "g", [sequence], [output])
    onnx.save(helper.make_model(graph, ir_version=8), tmp_path / "net.onnx")
    assert "must be tensors, got sequence_type" in message_of(tmp_path / "net.onnx")


@pytest.mark.parametrize(
    ("limit", "argument", "text"),
    [
        ("MAX_COMPUTED", "x", "the network computes more than 50 elements"),
        ("MAX_FOLDED", "c", "the network computes more than 50 elements of constants"),
    ],
)
def test_equal_operators_count_although_they_share_their_nodes(tmp_path, monkeypatch, limit, argument, text):
    monkeypatch.setattr(tensors, limit, 50)
    names = [f"y{i}" for i in range(20)]
    nodes = [helper.make_node("Tanh", [argument], [name]) for name in names]
    nodes.append(helper.make_node("Sum", [*names, "x"], ["y"]))
    path = save(tmp_path / "net.onnx", nodes, {"x": [4]}, {"y": [4]}, {"c": np.ones(4)})
    assert text in message_of(path)
