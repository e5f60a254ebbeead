"""Kinds of the elements that operators return, as the schemas of ONNX declare them."""

from collections.abc import Sequence
from functools import cache

import numpy as np

from kennfeld.importers.onnx.network import Operator
from kennfeld.importers.onnx.tensors import NodeTensor, Tensor, kind_of


def with_declared_kinds(op: Operator, results: Sequence[Tensor], arguments: Sequence[Tensor | None]) -> list[Tensor]:
    """Return the results of an operator as integers where its schema says that they are of the type of its arguments.

    A rule computes with numbers and need not think of their kind. Later operators do: a division of integers truncates.
    """
    inputs, outputs = _type_names(op.domain, op.kind, op.version)
    kinds: dict[str, set[str]] = {}
    for name, argument in zip(inputs, arguments, strict=False):
        if argument is not None:
            kinds.setdefault(name, set()).add(kind_of(argument))
    return [
        _as_integers(result) if _is_integer(outputs[i] if i < len(outputs) else "", kinds) else result
        for i, result in enumerate(results)
    ]


def _is_integer(name: str, kinds: dict[str, set[str]]) -> bool:
    """Return whether a type of a schema is one of integers, given the kinds of the arguments of each type."""
    if name.startswith("tensor("):
        return name.startswith(("tensor(int", "tensor(uint"))
    return "int" in kinds.get(name, ()) and "float" not in kinds[name]


def _as_integers(tensor: Tensor) -> Tensor:
    if kind_of(tensor) == "int":
        return tensor
    if isinstance(tensor, NodeTensor):
        return NodeTensor(tensor.nodes, "int")
    return tensor.astype(np.int64) if np.isfinite(tensor).all() else tensor


@cache
def _type_names(domain: str, kind: str, version: int) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the types of inputs and outputs by name; empty for an operator without a schema, or of mixed types."""
    from onnx import defs

    try:
        schema = defs.get_schema(kind, version, domain)
    except defs.SchemaError:
        return (), ()
    variadic = defs.OpSchema.FormalParameterOption.Variadic
    ports = (*schema.inputs, *schema.outputs)
    # the values that a loop or a branch hands on are each of a type of their own
    if any(port.option == variadic and not port.is_homogeneous for port in ports):
        return (), ()
    inputs = [port.type_str for port in schema.inputs]
    if schema.inputs and schema.inputs[-1].option == variadic:
        inputs += inputs[-1:] * 1000
    outputs = [port.type_str for port in schema.outputs]
    if schema.outputs and schema.outputs[-1].option == variadic:
        outputs += outputs[-1:] * 1000
    return tuple(inputs), tuple(outputs)
