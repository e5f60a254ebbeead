"""Buses of parameters, and buses that must be as their objects specify."""

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from kennfeld.base.formatting import join_names, size_text
from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, evaluating
from kennfeld.importers.simulink.lowering.bus_structure import BusStructure
from kennfeld.importers.simulink.signals import (
    CONSTANT,
    Bus,
    ExternalBus,
    Signal,
    SignalOrBus,
    as_vector,
    fit_to_shape,
    width_notes,
)
from kennfeld.importers.simulink.variables.data_types import BusElement, BusType, DataType, UndefinedType
from kennfeld.importers.simulink.variables.mask_scope import ParameterValue
from kennfeld.matlab.parser import parse_expression
from kennfeld.models.imperative.evaluation_errors import EvaluationError
from kennfeld.program.traversal import element_path

_MAX_NAMED = 8


def parameter_or_bus(block: BlockContext, field: str) -> SignalOrBus:
    """Return a field as a signal, or as a bus of signals if its value is a struct, whose numbers stay parameters."""
    text = block.field_text(field)
    try:
        value = block.compiler.expressions.evaluate(text, block.flat.scope, live=False)
    except EvaluationError:
        # the parameter itself reports what it lacks
        return block.parameter(field)
    if not isinstance(value, Mapping):
        return block.parameter(field)
    path = element_path(parse_expression(text))
    with evaluating(f"its {field} ({text[:60]}) has no value"):
        return _bus_of_struct(block, value, ".".join(path) if path is not None else "")


def _bus_of_struct(block: BlockContext, fields: Mapping[str, ParameterValue], path: str) -> Bus:
    """Return the bus of a struct; numbers at the path of a variable are looked up as parameters."""
    members: dict[str, SignalOrBus] = {}
    for name, value in fields.items():
        inner = f"{path}.{name}" if path else ""
        if isinstance(value, Mapping):
            members[name] = _bus_of_struct(block, value, inner)
        elif isinstance(value, np.ndarray):
            expressions = block.compiler.expressions
            nodes = expressions.array(inner, block.flat.scope) if inner else expressions.freeze(value)
            members[name] = block.signal(as_vector(nodes), CONSTANT)
        elif isinstance(value, tuple) and all(isinstance(part, Mapping) for part in value):
            parts = enumerate((part for part in value if isinstance(part, Mapping)), 1)
            members[name] = Bus(
                {f"({at})": _bus_of_struct(block, part, f"{inner}({at})" if inner else "") for at, part in parts}
            )
    return Bus(members)


def fit_to_bus(block: BlockContext, bus: BusType, wired: SignalOrBus, fill: bool = False) -> SignalOrBus:
    """Return a bus with the names and widths of its object.

    Args:
        block: the block that specifies the object.
        bus: the object.
        wired: the bus as it arrives; names that differ are replaced in order.
        fill: take a number for all elements, and 0 for elements that are missing.

    Raises:
        UnsupportedError: if an element does not have the width or the elements that the object specifies.
    """

    def zeros(path: str, element: BusElement, kind: DataType | None) -> SignalOrBus:
        # what the object does not tell is left as it arrives
        if element.dimensions is None or isinstance(kind, UndefinedType):
            return ExternalBus(name=path)
        return block.signal(np.full(element.dimensions, block.builder.const(0.0)), CONSTANT)

    return _BusFit(block, bus, fill).fit(BusStructure(block.flat.scope, zeros).bus(bus, ""), wired, "")


class _BusFit:
    """Compares what arrives at a block with a template of the bus that its object specifies."""

    def __init__(self, block: BlockContext, bus: BusType, fill: bool) -> None:
        self.block, self.bus, self.fill = block, bus, fill

    def fit(self, template: SignalOrBus, wired: SignalOrBus, path: str) -> SignalOrBus:
        if isinstance(template, ExternalBus) or (isinstance(wired, Signal) and not wired.sound):
            return wired
        if isinstance(template, Bus):
            return self._fit_bus(template, wired, path)
        signal = wired.signal if isinstance(wired, ExternalBus) else wired
        if isinstance(signal, Bus):
            raise UnsupportedError(f"its element {path} is a bus, but {self.bus} specifies numbers there")
        return self._fit_signal(template, signal, path)

    def _fit_bus(self, template: Bus, wired: SignalOrBus, path: str) -> Bus:
        if isinstance(wired, Signal) and not self.fill:
            where = f"its element {path}" if path else "it"
            raise UnsupportedError(f"{where} is a signal, but {self.bus} specifies a bus there{width_notes(wired)}")
        members = self._members(template, wired, path)
        prefix = f"{path}." if path else ""
        return Bus({name: self.fit(part, members[name], prefix + name) for name, part in template.members.items()})

    def _members(self, template: Bus, wired: SignalOrBus, path: str) -> dict[str, SignalOrBus]:
        """Return what arrives for each element of the template."""
        if isinstance(wired, Signal):
            return dict.fromkeys(template.members, wired)
        if isinstance(wired, ExternalBus):
            return {name: wired.member(name) for name in template.members}
        names, wanted = list(wired.members), list(template.members)
        # the fields of a struct are found by name and may be missing, the inputs of a block follow the object in order
        matches = set(names) <= set(wanted) if self.fill else len(names) == len(wanted)
        if not matches:
            where = f"its element {path}" if path else "it"
            listed = f"{where} contains {join_names(names, _MAX_NAMED)}, but {self.bus} specifies"
            raise UnsupportedError(f"{listed} {join_names(wanted, _MAX_NAMED)}")
        if self.fill:
            return {**template.members, **wired.members}
        if names != wanted:
            renamed = ", ".join(f"{a} as {b}" for a, b in zip(names, wanted, strict=True) if a != b)
            self.block.warn(f"takes elements in the order of its inputs, because {self.bus} names {renamed}")
        return dict(zip(wanted, wired.members.values(), strict=True))

    def _fit_signal(self, template: Signal, signal: Signal, path: str) -> Signal:
        return fit_to_dimensions(self.block, signal, template.shape, f"its element {path}", str(self.bus), self.fill)


def fit_to_dimensions(
    block: BlockContext, signal: Signal, shape: tuple[int, ...], name: str, source: str, fill: bool = False
) -> Signal:
    """Return a signal in the dimensions that `source` specifies for it.

    Raises:
        UnsupportedError: if it has another size; the message calls it `name`.
    """
    if signal.size == math.prod(shape):
        return replace(signal, nodes=fit_to_shape(signal.nodes, shape))
    is_open = signal.width is None or signal.width.key is not None
    if signal.size == 1 and (fill or is_open):
        # no valid model widens a scalar here: its width is not known yet, or only this source tells it
        block.compiler.shapes.wish(signal, block.flat, shape, block.flat.path, certain=True)
        return replace(signal, nodes=fit_to_shape(signal.nodes, shape), width=None)
    sizes = f"has size {size_text(signal.shape)}, but {source} specifies {size_text(shape)}"
    raise UnsupportedError(f"{name} {sizes}{width_notes(signal)}")
