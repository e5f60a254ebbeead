"""Replaces operators by the functions that define them: functions of the file, and those of the standard."""

from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple

from kennfeld.importers.onnx.lowering import is_supported

MAX_OPERATORS = 20_000
MAX_DEPTH = 100  # of functions that call each other
_MAX_NESTED = 5  # functions within functions of the standard

_Key = tuple[str, str, str]  # domain, name, overload


def plain_domain(domain: str) -> str:
    """Return the domain of an operator, which is empty for the standard."""
    return "" if domain == "ai.onnx" else domain


class ExpandedSize(NamedTuple):
    """The operators that nodes stand for without functions, their bytes, and the levels of calls and graphs."""

    operators: int
    size: int
    depth: int


def expanded_size(model: Any) -> ExpandedSize:
    """Compute the size that a model has without functions of its own.

    A small file can hold functions that call each other so often that they would not fit into memory.

    Raises:
        ValueError: functions call themselves, or each other in too many levels.
    """
    return _Sizes(model.functions).total(model.graph.node, 0)


class _Sizes:
    """The sizes of functions, computed when they are first called."""

    def __init__(self, functions: Sequence[Any]) -> None:
        self._functions = {_key(function, function.name): function for function in functions}
        self._sizes: dict[_Key, ExpandedSize] = {}

    def total(self, nodes: Sequence[Any], level: int) -> ExpandedSize:
        """Add up the size of nodes, which themselves are within so many calls and graphs."""
        operators = size = depth = 0
        for node in nodes:
            for part in self._parts(node, level):
                operators, size, depth = operators + part.operators, size + part.size, max(depth, part.depth)
        if level + depth > MAX_DEPTH:
            raise ValueError(f"its functions call themselves, or each other in more than {MAX_DEPTH} levels")
        return ExpandedSize(operators, size, depth)

    def _parts(self, node: Any, level: int) -> Iterator[ExpandedSize]:
        for attribute in node.attribute:
            for graph in (attribute.g, *attribute.graphs):
                if graph.node:
                    yield self._inner(graph.node, level)
        key = _key(node, node.op_type)
        if key not in self._functions:
            yield ExpandedSize(1, node.ByteSize(), 0)
            return
        # measured once: n functions that each call the one before twice stand for 2^n operators
        if key not in self._sizes:
            self._sizes[key] = self._inner(self._functions[key].node, level)
        yield self._sizes[key]

    def _inner(self, nodes: Sequence[Any], level: int) -> ExpandedSize:
        # one level more than the limit, so that `total` of the caller raises
        if level >= MAX_DEPTH:
            return ExpandedSize(0, 0, 1)
        inner = self.total(nodes, level + 1)
        return inner._replace(depth=inner.depth + 1)


def _key(item: Any, name: str) -> _Key:
    return plain_domain(item.domain), name, getattr(item, "overload", "")  # older versions have no overloads


def inlined(model: Any) -> Any:
    """Inline the functions of a model, and operators that only the standard defines by others.

    Raises:
        Exception: of several kinds, from the package onnx, if the model is invalid.
    """
    from onnx import inliner

    return _defined_by_others(inliner.inline_local_functions(model) if model.functions else model)


def _defined_by_others(model: Any) -> Any:
    """Replace operators without a rule that the standard defines as functions of other operators by these."""
    for _ in range(_MAX_NESTED):
        kinds = {(node.domain, node.op_type) for node in model.graph.node}
        missing = [(domain, kind) for domain, kind in kinds if not is_supported(plain_domain(domain), kind)]
        if not missing or len(model.graph.node) > MAX_OPERATORS:
            break
        replaced = _replaced(model, missing)
        # the rest has no function in the standard, or the package is too old
        if len(replaced.graph.node) == len(model.graph.node):
            break
        model = replaced
    return model


def _replaced(model: Any, kinds: Sequence[tuple[str, str]]) -> Any:
    """Return a network without operators of some kinds, or the same if the package onnx cannot replace them."""
    from onnx import helper, inliner, shape_inference

    # a copy, since what the inliner needs must not stay in the model if it fails
    typed = type(model).FromString(model.SerializeToString())
    inputs = {port.name for port in typed.graph.input}
    for tensor in typed.graph.initializer:  # the inliner needs the types of constants as well
        if tensor.name not in inputs:
            typed.graph.input.append(helper.make_tensor_value_info(tensor.name, tensor.data_type, list(tensor.dims)))
    try:
        _state_defaults(typed, kinds)
        typed = shape_inference.infer_shapes(typed)
        return inliner.inline_selected_functions(typed, list(kinds), inline_schema_functions=True)
    except Exception:  # of several kinds; a TypeError in older versions, which cannot do that
        return model


def _state_defaults(model: Any, kinds: Sequence[tuple[str, str]]) -> None:
    """State the default values of attributes, which the inliner does not pass on to functions."""
    from onnx import defs

    versions = {entry.domain: entry.version for entry in model.opset_import}
    for node in model.graph.node:
        if (node.domain, node.op_type) in kinds and defs.has(node.op_type, node.domain):
            schema = defs.get_schema(node.op_type, versions.get(node.domain, 1), node.domain)
            stated = {attribute.name for attribute in node.attribute}
            for name, attribute in schema.attributes.items():
                if name not in stated and attribute.default_value.type:
                    node.attribute.append(attribute.default_value)
