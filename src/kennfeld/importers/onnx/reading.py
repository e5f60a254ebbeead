"""Reads ONNX files: checks them, bounds their size, and loads external data only from their own folder."""

from collections.abc import Iterator, Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from kennfeld.base.errors import InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import one_line
from kennfeld.base.optional_packages import optional_package
from kennfeld.importers.onnx.inlining import MAX_OPERATORS, expanded_size, inlined, plain_domain
from kennfeld.importers.onnx.network import Array, Network, NetworkPort, Operator

MAX_FILE = 64_000_000  # bytes of a file, and of its external data
MAX_PORTS = 4096  # elements of an input or output
_REMEDY = "Export the network again."
_SMALLER = "Use a smaller network."
_KINDS = frozenset(
    {
        "float16",
        "bfloat16",
        "float32",
        "float64",
        "int8",
        "int16",
        "int32",
        "int64",
        "uint8",
        "uint16",
        "uint32",
        "uint64",
        "bool",
    }
)


def read_network(path: Path) -> Network:
    """Read a network without running it.

    Raises:
        InputError: the package onnx is missing, or the file is damaged, invalid or too large.
    """
    location = Location.of_file(path)
    with convert_errors(path, "cannot be read"):
        size = path.stat().st_size
        if size > MAX_FILE:
            raise InputError.of(location, f"the network has {size} bytes; the maximum is {MAX_FILE}", _SMALLER)
        content = path.read_bytes()
    with optional_package(location, "onnx"):
        import onnx
        import onnx.checker
        from google.protobuf.message import DecodeError
    try:
        model = onnx.ModelProto.FromString(content)
    except (DecodeError, RecursionError):
        raise InputError.of(location, "not an ONNX file, or damaged", _REMEDY) from None
    # protobuf reads an empty file as a model without content
    if not model.graph.node and not model.graph.output:
        raise InputError.of(location, "the file holds no network", _REMEDY)
    # before functions are inlined, which could fill the memory
    _check_size(model, location)
    _load_external_data(model, path)
    try:
        onnx.checker.check_model(model)
        model = inlined(model)
    except Exception as error:  # the checker raises errors of several kinds
        raise InputError.of(location, f"invalid network: {_first_line(error)}", _REMEDY) from None
    return _network(model, path)


def _check_size(model: Any, location: Location) -> None:
    """Raise `InputError` if a network has too many operators, those of its functions included."""
    try:
        operators, size, _ = expanded_size(model)
    except ValueError as error:
        raise InputError.of(location, str(error), _REMEDY) from None
    if operators > MAX_OPERATORS:
        message = f"the network has {operators} operators; the maximum is {MAX_OPERATORS}"
        raise InputError.of(location, message, _SMALLER)
    if size > MAX_FILE:
        message = f"the operators of its functions have {size} bytes; the maximum is {MAX_FILE}"
        raise InputError.of(location, message, _SMALLER)


def _first_line(error: Exception) -> str:
    text = one_line(next((line for line in str(error).splitlines() if line.strip()), type(error).__name__))
    return text if len(text) <= 300 else f"{text[:300]}..."


def _tensors(model: Any) -> Iterator[Any]:
    """Yield the tensors of a model: its constants, and those in attributes of its operators."""
    yield from model.graph.initializer
    for nodes in (model.graph.node, *(function.node for function in model.functions)):
        for node in nodes:
            for attribute in node.attribute:
                if attribute.HasField("t"):
                    yield attribute.t
                yield from attribute.tensors


def _load_external_data(model: Any, path: Path) -> None:
    """Move data that lie in other files into the model."""
    total = 0
    for tensor in _tensors(model):
        if not tensor.external_data:
            continue
        entries = {entry.key: entry.value for entry in tensor.external_data}
        data = _external_bytes(path, tensor.name, entries)
        total += len(data)
        if total > MAX_FILE:
            raise InputError.of(Location.of_file(path), f"its external data exceed {MAX_FILE} bytes", _SMALLER)
        tensor.ClearField("external_data")
        tensor.ClearField("data_location")
        tensor.raw_data = data


def _external_bytes(path: Path, tensor: str, entries: Mapping[str, str]) -> bytes:
    name, location = entries.get("location", ""), Location.of_file(path).within(tensor)
    folder = path.parent.resolve()
    try:
        # resolved, so that neither `..` nor a link leads out of the folder
        file = (folder / name).resolve()
        offset, length = int(entries.get("offset", 0)), int(entries.get("length", -1))
    except (ValueError, OSError, RuntimeError):
        raise InputError.of(location, "invalid reference to external data", _REMEDY) from None
    if not name or not file.is_relative_to(folder):
        message = f"external data {one_line(name)!r} lie outside of the folder of the network"
        raise InputError.of(location, message, "Put the file next to the network, and export it again.")
    if offset < 0 or length > MAX_FILE:
        raise InputError.of(location, "invalid reference to external data", _REMEDY)
    with convert_errors(file, "the external data cannot be read"):
        if not file.is_file():
            raise InputError.of(location, f"the file {one_line(name)} with its data does not exist", "Copy it as well.")
        with file.open("rb") as stream:
            stream.seek(offset)
            # one byte more than the limit shows that the file is too long
            data = stream.read(length if length >= 0 else MAX_FILE + 1)
    if 0 <= length != len(data):
        raise InputError.of(location, f"{one_line(name)} ends within the data", _REMEDY)
    return data


def _network(model: Any, path: Path) -> Network:
    # the size is checked again, because functions of the standard have been replaced by their operators
    graph, location = model.graph, Location.of_file(path)
    _check_size(model, location)
    if graph.sparse_initializer:
        raise InputError.of(location, "sparse constants are not supported", "Export the network with dense ones.")
    constants = {tensor.name: _array(tensor, location) for tensor in graph.initializer}
    versions = {plain_domain(entry.domain): int(entry.version) for entry in model.opset_import}
    return Network(
        name=graph.name,
        file=str(path),
        producer=f"{model.producer_name} {model.producer_version}".strip(),
        inputs=tuple(_port(value, location) for value in graph.input if value.name not in constants),
        outputs=tuple(_output(value, location) for value in graph.output),
        constants=MappingProxyType(constants),
        operators=tuple(_operator(node, versions, location) for node in graph.node),
        opsets=MappingProxyType(versions),
    )


def _array(tensor: Any, location: Location) -> Array:
    from onnx import TensorProto, numpy_helper

    if tensor.data_location == TensorProto.EXTERNAL:  # not one that was loaded: it would be read from another folder
        raise InputError.of(location.within(tensor.name), "invalid reference to external data", _REMEDY)
    try:
        array = np.asarray(numpy_helper.to_array(tensor))
    except Exception as error:  # of several kinds, for damaged data
        raise InputError.of(location.within(tensor.name), f"invalid constant: {_first_line(error)}", _REMEDY) from None
    return np.asarray(array, dtype=np.float64) if array.dtype.name in ("float16", "bfloat16") else array


def _port(value: Any, location: Location) -> NetworkPort:
    from onnx import helper

    place = location.within(value.name)
    if not value.type.HasField("tensor_type"):
        kind = value.type.WhichOneof("value") or "unknown type"
        raise InputError.of(place, f"inputs and outputs must be tensors, got {kind}", _REMEDY)
    tensor = value.type.tensor_type
    try:
        kind = np.dtype(helper.tensor_dtype_to_np_dtype(tensor.elem_type)).name
    except (KeyError, TypeError, ValueError):
        kind = "unknown"
    if kind not in _KINDS:
        raise InputError.of(place, f"elements of type {kind} are not supported", "Export it with float or double.")
    if not tensor.HasField("shape"):
        return NetworkPort(value.name, None, kind)
    # 0 for a size that is a name or missing, which only the first dimension, the batch, may have
    dimensions = [int(d.dim_value) if d.HasField("dim_value") else 0 for d in tensor.shape.dim]
    if any(size <= 0 for size in dimensions[1:]):
        return NetworkPort(value.name, None, kind)
    shape = tuple(max(size, 1) for size in dimensions)
    if np.prod([float(size) for size in shape]) > MAX_PORTS:
        message = f"it has shape {'x'.join(map(str, shape))}; at most {MAX_PORTS} elements are supported"
        raise InputError.of(place, message, _SMALLER)
    return NetworkPort(value.name, shape, kind)


def _output(value: Any, location: Location) -> NetworkPort:
    """Return an output, which may also hold texts, or the scores of classes by their labels."""
    from onnx import TensorProto

    if value.type.HasField("sequence_type"):
        return NetworkPort(value.name, None, "sequence")
    if value.type.HasField("tensor_type") and value.type.tensor_type.elem_type == TensorProto.STRING:
        return NetworkPort(value.name, None, "text")
    return _port(value, location)


def _operator(node: Any, versions: Mapping[str, int], location: Location) -> Operator:
    domain = plain_domain(node.domain)
    attributes = {attribute.name: _attribute(attribute, versions, location) for attribute in node.attribute}
    return Operator(
        node.name,
        node.op_type,
        domain,
        versions.get(domain, 1),
        tuple(node.input),
        tuple(node.output),
        MappingProxyType(attributes),
    )


def _attribute(attribute: Any, versions: Mapping[str, int], location: Location) -> Any:
    """Return the value of an attribute: a number, a text, a list of them, an array or a graph; None for others."""
    from onnx import AttributeProto

    match attribute.type:
        case AttributeProto.FLOAT:
            return float(attribute.f)
        case AttributeProto.INT:
            return int(attribute.i)
        case AttributeProto.STRING:
            return attribute.s.decode("utf-8", errors="replace")
        case AttributeProto.TENSOR:
            return _array(attribute.t, location)
        case AttributeProto.FLOATS:
            return np.array(attribute.floats, dtype=np.float64)
        case AttributeProto.INTS:
            return [int(number) for number in attribute.ints]
        case AttributeProto.STRINGS:
            return [text.decode("utf-8", errors="replace") for text in attribute.strings]
        case AttributeProto.GRAPH:
            return _body(attribute.g, versions, location)
        case _:
            return None


def _body(graph: Any, versions: Mapping[str, int], location: Location) -> Network:
    """Return a graph within an operator, whose inputs and outputs have the shapes of what it is applied to."""
    constants = {tensor.name: _array(tensor, location) for tensor in graph.initializer}
    return Network(
        graph.name,
        location.file,
        "",
        inputs=tuple(NetworkPort(value.name, None, "") for value in graph.input),
        outputs=tuple(NetworkPort(value.name, None, "") for value in graph.output),
        constants=MappingProxyType(constants),
        operators=tuple(_operator(node, versions, location) for node in graph.node),
        opsets=versions,
    )
