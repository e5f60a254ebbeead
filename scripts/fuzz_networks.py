"""Small ONNX networks of many operators, and damage to their fields, their graphs and their external data."""

import random
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

MOST_OPERATORS = 100_000
LEVELS = 60  # of functions that call another one twice
NESTED = 31  # graphs within graphs, which the format can hold
OUTSIDE = ("../secret.bin", "/etc/passwd", "sub/../../secret.bin", "", ".", "..", "weights.bin/x", "\0", "x" * 5000)
_NUMBERS = (0, 1, -1, 2, 7, 64, 255, 2**31 - 1, -(2**31), 2**40, 2**63 - 1, -(2**63))
_REALS = (0.0, -1.0, 1e-300, 1e308, float("inf"), float("-inf"), float("nan"))
_NAMES = ("", "x", "y", "missing", "w", "\n", "ä" * 40)
_VERSIONS = (0, -1, 1, 5, 6, 8, 9, 10, 12, 13, 20, 23, 26, 999, 2**62)
_TYPES = tuple(range(26))  # of tensors, some of which do not exist


def networks() -> Iterator[tuple[str, dict[str, bytes]]]:
    """Yield networks, each as the name of its file and the contents of this file and of those beside it."""
    for name, model in (
        ("layers", _layers()),
        ("image", _image()),
        ("shapes", _shapes()),
        ("recurrent", _recurrent()),
        ("trees", _trees()),
        ("models", _models()),
        ("functions", _functions(3)),
        ("graphs", _graphs()),
    ):
        yield f"{name}.onnx", {f"{name}.onnx": model.SerializeToString()}
    model, data = _external()
    yield "external.onnx", {"external.onnx": model.SerializeToString(), "weights.bin": data}


def _model(nodes: Sequence[Any], shape: Sequence[int], constants: dict[str, Any], outputs: int = 1) -> Any:
    """Return a network from `x` to `y`, or to `y0`, `y1`, ..."""
    from onnx import TensorProto, helper, numpy_helper

    names = ["y"] if outputs == 1 else [f"y{number}" for number in range(outputs)]
    graph = helper.make_graph(
        nodes,
        "network",
        [helper.make_tensor_value_info("x", TensorProto.FLOAT, shape)],
        [helper.make_tensor_value_info(name, TensorProto.FLOAT, ["rows", "columns"]) for name in names],
        [numpy_helper.from_array(np.asarray(array), name) for name, array in constants.items()],
    )
    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("ai.onnx.ml", 3), helper.make_opsetid("local", 1)]
    return helper.make_model(graph, opset_imports=opsets, ir_version=8)


def _numbers(*shape: int) -> Any:
    return np.random.default_rng(len(shape)).standard_normal(shape).astype(np.float32)


def _layers() -> Any:
    from onnx.helper import make_node

    nodes = [
        make_node("Gemm", ["x", "w", "b"], ["z"], transB=1),
        make_node("Tanh", ["z"], ["a"]),
        make_node("MatMul", ["a", "v"], ["p"]),
        make_node("Add", ["p", "c"], ["q"]),
        make_node("LayerNormalization", ["q", "c"], ["n"], axis=-1),
        make_node("Softmax", ["n"], ["s"], axis=1),
        make_node("Clip", ["s", "low", "high"], ["y"]),
    ]
    constants = {"w": _numbers(6, 3), "b": _numbers(6), "v": _numbers(6, 4), "c": _numbers(4)}
    return _model(nodes, [1, 3], constants | {"low": np.float32(0.01), "high": np.float32(0.9)})


def _image() -> Any:
    from onnx.helper import make_node

    nodes = [
        make_node("Conv", ["x", "w", "b"], ["c"], kernel_shape=[3, 3], pads=[1, 1, 1, 1], group=1),
        make_node("BatchNormalization", ["c", "b", "b", "b", "v"], ["n"]),
        make_node("Relu", ["n"], ["r"]),
        make_node("MaxPool", ["r"], ["m"], kernel_shape=[2, 2], strides=[2, 2]),
        make_node("AveragePool", ["m"], ["a"], kernel_shape=[2, 2], ceil_mode=1),
        make_node("Pad", ["a", "pads"], ["p"], mode="reflect"),
        make_node("Flatten", ["p"], ["y"]),
    ]
    constants = {"w": _numbers(2, 1, 3, 3), "b": _numbers(2), "v": np.ones(2, np.float32)}
    return _model(nodes, [1, 1, 6, 6], constants | {"pads": np.array([0, 0, 1, 1, 0, 0, 1, 1])})


def _shapes() -> Any:
    from onnx.helper import make_node

    nodes = [
        make_node("Reshape", ["x", "shape"], ["r"]),
        make_node("Transpose", ["r"], ["t"], perm=[1, 0]),
        make_node("Gather", ["t", "places"], ["g"], axis=1),
        make_node("Slice", ["g", "starts", "ends", "axes", "steps"], ["s"]),
        make_node("Tile", ["s", "repeats"], ["i"]),
        make_node("Expand", ["i", "expanded"], ["e"]),
        make_node("Concat", ["e", "e"], ["c"], axis=0),
        make_node("ConstantOfShape", ["shape"], ["o"]),
        make_node("TopK", ["c", "k"], ["v", "index"], axis=-1),
        make_node("OneHot", ["places", "depth", "values"], ["h"], axis=0),
        make_node("CumSum", ["v", "axis"], ["u"]),
        make_node("Range", ["start", "limit", "delta"], ["range"]),
        make_node("Einsum", ["u", "u"], ["m"], equation="...ij,...kj->...ik"),
        make_node("ReduceSum", ["m"], ["d"], keepdims=0),
        make_node("Resize", ["x", "", "scales"], ["large"]),
        make_node("Split", ["c"], ["y0", "y1"], axis=0, num_outputs=2),
        make_node("Identity", ["d"], ["y2"]),
        make_node("Add", ["o", "range"], ["y3"]),
    ]
    whole = {"shape": [2, 3], "places": [1, 0], "starts": [0], "ends": [3], "axes": [0], "steps": [2], "k": [2]}
    more = {"repeats": [1, 2], "expanded": [2, 2, 4], "depth": 3, "axis": 1, "start": 0, "limit": 3, "delta": 1}
    constants = {name: np.array(values, dtype=np.int64) for name, values in (whole | more).items()}
    real = {"values": np.array([0.0, 1.0], np.float32), "scales": np.array([1.0, 2.0], np.float32)}
    return _model(nodes, [1, 6], constants | real, 4)


def _recurrent() -> Any:
    from onnx.helper import make_node

    nodes = [
        make_node("LSTM", ["x", "w", "r", "b"], ["s", "h", "c"], hidden_size=2),
        make_node("GRU", ["x", "w3", "r3"], ["g"], hidden_size=2, linear_before_reset=1, direction="forward"),
        make_node("Add", ["s", "g"], ["y0"]),
        make_node("QuantizeLinear", ["h", "scale", "zero"], ["q"]),
        make_node("DequantizeLinear", ["q", "scale", "zero"], ["y1"]),
    ]
    constants = {"w": _numbers(1, 8, 3), "r": _numbers(1, 8, 2), "b": _numbers(1, 16), "w3": _numbers(1, 6, 3)}
    constants |= {"r3": _numbers(1, 6, 2), "scale": np.float32(0.1), "zero": np.int8(3)}
    return _model(nodes, [2, 1, 3], constants, 2)


def _trees() -> Any:
    from onnx.helper import make_node

    tree = {
        "nodes_treeids": [0, 0, 0, 1],
        "nodes_nodeids": [0, 1, 2, 0],
        "nodes_featureids": [1, 0, 0, 0],
        "nodes_modes": ["BRANCH_LEQ", "LEAF", "LEAF", "LEAF"],
        "nodes_values": [0.5, 0.0, 0.0, 0.0],
        "nodes_truenodeids": [1, 0, 0, 0],
        "nodes_falsenodeids": [2, 0, 0, 0],
    }
    rows = {"treeids": [0, 0, 1], "nodeids": [1, 2, 0], "ids": [0, 0, 0], "weights": [1.0, -1.0, 0.3]}
    target, scores = ({f"{prefix}_{name}": row for name, row in rows.items()} for prefix in ("target", "class"))
    domain = "ai.onnx.ml"
    nodes = [
        make_node("TreeEnsembleRegressor", ["x"], ["y0"], domain=domain, n_targets=1, **tree, **target),
        make_node(
            "TreeEnsembleClassifier",
            ["x"],
            ["label", "y1"],
            domain=domain,
            classlabels_int64s=[0, 1],
            post_transform="LOGISTIC",
            **tree,
            **scores,
        ),
    ]
    return _model(nodes, [1, 2], {}, 2)


def _models() -> Any:
    from onnx.helper import make_node

    domain, vectors = "ai.onnx.ml", [0.1, 0.2, -0.3, 0.4]
    nodes = [
        make_node("Scaler", ["x"], ["s"], domain=domain, offset=[0.1, 0.2], scale=[1.0, 2.0]),
        make_node("Imputer", ["s"], ["i"], domain=domain, imputed_value_floats=[0.5], replaced_value_float=0.0),
        make_node("Normalizer", ["i"], ["n"], domain=domain, norm="L2"),
        make_node(
            "SVMRegressor",
            ["n"],
            ["y0"],
            domain=domain,
            kernel_type="RBF",
            kernel_params=[0.5, 0.0, 3.0],
            n_supports=2,
            support_vectors=vectors,
            coefficients=[1.0, -0.5],
            rho=[0.1],
        ),
        make_node(
            "LinearClassifier",
            ["n"],
            ["label", "y1"],
            domain=domain,
            coefficients=vectors,
            intercepts=[0.1, 0.2],
            classlabels_ints=[0, 1],
            post_transform="SOFTMAX",
        ),
        make_node("ArrayFeatureExtractor", ["n", "place"], ["y2"], domain=domain),
    ]
    return _model(nodes, [1, 2], {"place": np.array([1])}, 3)


def _functions(levels: int) -> Any:
    """Return a network whose functions call each the one before twice: 2^levels operators."""
    from onnx import helper

    opsets = [helper.make_opsetid("", 18), helper.make_opsetid("local", 1)]
    model = _model([helper.make_node(f"F{levels}", ["x"], ["y"], domain="local")], [1, 2], {})
    for level in range(levels + 1):
        inner, domain = ("Tanh", "") if level == 0 else (f"F{level - 1}", "local")
        nodes = [helper.make_node(inner, [a], [b], domain=domain) for a, b in (("a", "t"), ("t", "b"))]
        model.functions.append(helper.make_function("local", f"F{level}", ["a"], ["b"], nodes, opsets))
    return model


def _graphs() -> Any:
    """Return a network with a condition and a loop, whose bodies are graphs."""
    from onnx import TensorProto, helper, numpy_helper

    real, whole = TensorProto.FLOAT, TensorProto.INT64
    branches = [
        helper.make_graph(
            [helper.make_node(kind, ["x"], ["r"])], kind, [], [helper.make_tensor_value_info("r", real, [1, 2])]
        )
        for kind in ("Tanh", "Exp")
    ]
    ports = (("i", whole, []), ("going", TensorProto.BOOL, []), ("v", real, [1, 2]))
    ends = (("still", TensorProto.BOOL, []), ("next", real, [1, 2]))
    steps = [helper.make_node("Identity", ["going"], ["still"]), helper.make_node("Sin", ["v"], ["next"])]
    body = helper.make_graph(
        steps, "body", *([helper.make_tensor_value_info(*port) for port in each] for each in (ports, ends))
    )
    nodes = [
        helper.make_node("If", ["truth"], ["z"], then_branch=branches[0], else_branch=branches[1]),
        helper.make_node("Loop", ["count", "truth", "z"], ["y"], body=body),
    ]
    model = _model(nodes, [1, 2], {"count": np.array(3)})
    model.graph.initializer.append(numpy_helper.from_array(np.array(True), "truth"))
    return model


def _external() -> tuple[Any, bytes]:
    model, data = _layers(), b""
    for tensor in model.graph.initializer:
        raw, tensor.raw_data = tensor.raw_data, b""
        entries = {"location": "weights.bin", "offset": str(len(data)), "length": str(len(raw))}
        for key, value in entries.items():
            tensor.external_data.add(key=key, value=value)
        tensor.data_location = 1
        data += raw
    return model, data


def damaged_network(content: bytes, folder: Path, draw: random.Random) -> bytes:
    """Return a network with one to four kinds of damage; some replace files of the folder by links that lead out."""
    from onnx import ModelProto

    model = ModelProto.FromString(content)
    for _ in range(draw.choice((1, 1, 2, 4))):
        (damage,) = draw.choices(list(_DAMAGES), list(_DAMAGES.values()))
        model = damage(model, folder, draw) or model
    return bytes(model.SerializeToString())


def _messages(message: Any) -> Iterator[Any]:
    """Yield a message and all that it contains."""
    yield message
    for field, value in message.ListFields():
        if field.message_type is not None:
            for inner in value if hasattr(value, "extend") else [value]:
                yield from _messages(inner)


def _change_fields(model: Any, folder: Path, draw: random.Random) -> None:
    for _ in range(draw.choice((1, 1, 3, 10))):
        message = draw.choice([each for each in _messages(model) if each.ListFields()])
        _change_field(message, *draw.choice(message.ListFields()), draw)


def _change_field(message: Any, field: Any, value: Any, draw: random.Random) -> None:
    """Remove a field, repeat or remove one of its elements, or replace a number or text."""
    if draw.random() < 0.15:
        message.ClearField(field.name)
    elif field.message_type is not None:
        if hasattr(value, "extend"):
            _change_list(value, draw)
    elif hasattr(value, "extend"):
        value[draw.randrange(len(value))] = _other(field, value[0], draw)
        if draw.random() < 0.3:
            value.extend([value[0]] * draw.choice((1, 3, 1000)))
    else:
        setattr(message, field.name, _other(field, value, draw))


def _change_list(messages: Any, draw: random.Random) -> None:
    at = draw.randrange(len(messages))
    if draw.random() < 0.5:
        del messages[at]
    else:
        messages.add().CopyFrom(messages[at])


def _other(field: Any, value: Any, draw: random.Random) -> Any:
    if field.enum_type is not None:
        return draw.choice(list(field.enum_type.values_by_number))
    if isinstance(value, float):
        return draw.choice(_REALS)
    if isinstance(value, int):
        number = draw.choice(_NUMBERS)
        return number if field.cpp_type == field.CPPTYPE_INT64 else max(min(number, 2**31 - 1), -(2**31))
    if isinstance(value, bytes):
        return value[: draw.randrange(len(value) + 1)] + bytes(draw.choice((0, 1, 4, 1000)))
    return draw.choice(_NAMES)


def _change_version(model: Any, folder: Path, draw: random.Random) -> None:
    for entry in model.opset_import:
        entry.version = draw.choice(_VERSIONS)


def _change_type(model: Any, folder: Path, draw: random.Random) -> None:
    tensors = list(model.graph.initializer)
    ports = [port.type.tensor_type for port in (*model.graph.input, *model.graph.output)]
    if tensors or ports:
        chosen = draw.choice([*tensors, *ports])
        setattr(chosen, "data_type" if hasattr(chosen, "data_type") else "elem_type", draw.choice(_TYPES))


def _change_shape(model: Any, folder: Path, draw: random.Random) -> None:
    """State other dimensions of an input or constant, or make a constant of shapes and sizes extreme."""
    from onnx import numpy_helper

    if not model.graph.initializer or draw.random() < 0.3:
        if not model.graph.input:
            return
        shape = draw.choice(model.graph.input).type.tensor_type.shape
        if draw.random() < 0.3:
            shape.dim.add(dim_value=draw.choice(_NUMBERS))
        for dimension in shape.dim:
            if draw.random() < 0.5:
                dimension.dim_value = draw.choice(_NUMBERS)
        return
    tensor = draw.choice(model.graph.initializer)
    if tensor.data_type == 7 and draw.random() < 0.7 and tensor.raw_data:
        numbers = numpy_helper.to_array(tensor).copy()
        numbers.reshape(-1)[:] = [draw.choice((*_NUMBERS, 1000, 100_000)) for _ in range(numbers.size)]
        tensor.CopyFrom(numpy_helper.from_array(numbers, tensor.name))
    elif tensor.dims:
        tensor.dims[draw.randrange(len(tensor.dims))] = draw.choice(_NUMBERS)


def _remove_nodes(model: Any, folder: Path, draw: random.Random) -> None:
    for _ in range(draw.choice((1, 1, 2))):
        if model.graph.node:
            del model.graph.node[draw.randrange(len(model.graph.node))]


def _shuffle_nodes(model: Any, folder: Path, draw: random.Random) -> None:
    nodes = list(model.graph.node)
    draw.shuffle(nodes)
    model.graph.ClearField("node")
    model.graph.node.extend(nodes)


def _remove_tensors(model: Any, folder: Path, draw: random.Random) -> None:
    if model.graph.initializer:
        del model.graph.initializer[draw.randrange(len(model.graph.initializer))]


def _connect(model: Any, folder: Path, draw: random.Random) -> None:
    """Connect an operator with other tensors, such as its own output."""
    names = [name for node in model.graph.node for name in (*node.input, *node.output)] or ["x"]
    if model.graph.node:
        node = draw.choice(model.graph.node)
        places = node.output if draw.random() < 0.3 or not node.input else node.input
        if places:
            places[draw.randrange(len(places))] = draw.choice(names)


def _change_kind(model: Any, folder: Path, draw: random.Random) -> None:
    """Give an operator the name of another one."""
    from kennfeld.importers.onnx.lowering import RULES

    if model.graph.node:
        draw.choice(model.graph.node).op_type = draw.choice(sorted(kind for domain, kind in RULES if not domain))


def _change_external(model: Any, folder: Path, draw: random.Random) -> None:
    tensors = [tensor for tensor in model.graph.initializer if tensor.external_data]
    if not tensors:
        _refer_outside(model, draw)
        return
    for entry in draw.choice(tensors).external_data:
        if draw.random() < 0.5:
            entry.value = draw.choice(OUTSIDE) if entry.key == "location" else str(draw.choice((*_NUMBERS, "", "x")))
    if draw.random() < 0.4 and (folder / "weights.bin").is_file():
        (folder / "weights.bin").unlink()
        (folder / "weights.bin").symlink_to(draw.choice(("/etc/passwd", "/dev/zero", "weights.bin", "../none", "/")))


def _refer_outside(model: Any, draw: random.Random) -> None:
    if model.graph.initializer:
        tensor = draw.choice(model.graph.initializer)
        tensor.ClearField("raw_data")
        tensor.external_data.add(key="location", value=draw.choice(OUTSIDE))
        tensor.data_location = 1


def _multiply_nodes(model: Any, folder: Path, draw: random.Random) -> None:
    """Put a chain of operators behind the first output, or let sizes grow along the chain."""
    from onnx import helper

    kind, count = draw.choice(
        (
            ("Tanh", 19_000),
            ("MeanVarianceNormalization", 5000),
            ("Tanh", MOST_OPERATORS),
            ("Concat", 40),
            ("Add", 400),
            ("Mul", 4000),
        )
    )
    last = model.graph.output[0].name if model.graph.output else "y"
    for number in range(count):
        arguments = [last] if count >= 5000 else [last, last]
        attributes = {"axis": 0} if kind == "Concat" else {}
        model.graph.node.append(helper.make_node(kind, arguments, [f"chain{number}"], **attributes))
        last = f"chain{number}"
    if model.graph.output:
        model.graph.output[0].name = last


def _nest_functions(model: Any, folder: Path, draw: random.Random) -> Any:
    return _functions(draw.choice((14, 30, LEVELS)))


def _nest_graphs(model: Any, folder: Path, draw: random.Random) -> None:
    """Put graphs into graphs, as conditions within conditions."""
    from google.protobuf.message import DecodeError
    from onnx import helper

    inner = model.graph
    for _ in range(draw.choice((3, 10, NESTED))):
        try:
            node = helper.make_node("If", ["truth"], ["y"], then_branch=inner)
        except DecodeError:  # protobuf allows no further level
            break
        inner = helper.make_graph([node], "outer", [], list(model.graph.output))
    outer = helper.make_graph(list(inner.node), "outer", list(model.graph.input), list(model.graph.output))
    model.graph.CopyFrom(outer)


def _call_itself(model: Any, folder: Path, draw: random.Random) -> Any:
    """Return a network with a function that calls itself, or two that call each other."""
    recursive = _functions(2)
    recursive.functions[0].node[0].op_type = draw.choice(("F0", "F1", "F2"))
    recursive.functions[0].node[0].domain = "local"
    return recursive


_DAMAGES: Mapping[Callable[[Any, Path, random.Random], Any], int] = {
    _change_fields: 12,
    _change_version: 4,
    _change_type: 4,
    _change_shape: 8,
    _remove_nodes: 4,
    _shuffle_nodes: 2,
    _remove_tensors: 4,
    _connect: 6,
    _change_kind: 6,
    _change_external: 6,
    _multiply_nodes: 2,
    _nest_functions: 1,
    _nest_graphs: 1,
    _call_itself: 1,
}  # with their frequencies
