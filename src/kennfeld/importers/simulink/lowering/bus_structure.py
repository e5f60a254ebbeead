"""Buses as their objects specify them: nested elements, arrays of buses, and a signal for each other element."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Final, TypeAlias

from kennfeld.importers.simulink.signals import Bus, SignalOrBus
from kennfeld.importers.simulink.variables.data_types import BusElement, BusType, DataType, data_type
from kennfeld.importers.simulink.variables.mask_scope import Scope
from kennfeld.models.imperative.evaluation_errors import EvaluationError

# of the path and the element, and its type if that is no bus object: undefined, or of numbers
ElementSignal: TypeAlias = Callable[[str, BusElement, DataType | None], SignalOrBus]

MAX_ELEMENTS: Final = 10_000  # of a port, each an input of the model
_MAX_DEPTH: Final = 50


class BusStructure:
    """Builds the bus of a bus object; `signal` returns the signal of an element that is not a bus itself."""

    def __init__(self, scope: Scope, signal: ElementSignal) -> None:
        # objects are variables of the base workspace, which masks do not hide
        self.scope = Scope(scope.variables)
        self.signal = signal
        self._count = 0

    def bus(self, bus: BusType, path: str, depth: int = 0) -> Bus:
        """Build a bus whose elements have the path "path.element".

        Raises:
            EvaluationError: if the bus contains itself or has too many elements.
        """
        if depth > _MAX_DEPTH:
            raise EvaluationError(f"{bus} contains itself")
        prefix = f"{path}." if path else ""
        members: dict[str, SignalOrBus] = {}
        for element in bus.elements:
            members[element.name] = self._member(bus, element, f"{prefix}{element.name}", depth)
        return Bus(members)

    def _member(self, bus: BusType, element: BusElement, path: str, depth: int) -> SignalOrBus:
        kind = data_type(element.type, self.scope)
        if isinstance(kind, BusElement):
            # a value type brings dimensions and unit, and the type of its numbers
            element = replace(kind, name=element.name, unit=element.unit or kind.unit)
            kind = data_type(element.type, self.scope)
        count = math.prod(element.dimensions or (1,))
        self._count += count
        if self._count > MAX_ELEMENTS:
            raise EvaluationError(f"{bus} has more than {MAX_ELEMENTS} elements")
        if not isinstance(kind, BusType):
            return self.signal(path, element, kind)
        if count == 1:
            return self.bus(kind, path, depth + 1)
        # an array of buses is a bus of its numbered elements, from which a Selector takes some
        return Bus({f"({at})": self.bus(kind, f"{path}({at})", depth + 1) for at in range(1, count + 1)})
