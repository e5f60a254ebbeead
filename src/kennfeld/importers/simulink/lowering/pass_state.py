"""State of one pass: inferred attributes of earlier passes, model inputs and pending completions."""

import math
from collections import deque
from collections.abc import Callable, Collection, Mapping
from dataclasses import field, replace
from functools import partial
from typing import TypeAlias

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import CLOCK
from kennfeld.graph.builder import GraphBuilder
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock
from kennfeld.importers.simulink.float_types import FloatType, float_type_of
from kennfeld.importers.simulink.lowering.bus_structure import BusStructure
from kennfeld.importers.simulink.reader.block_ports import port_label
from kennfeld.importers.simulink.signals import CONTINUOUS, Bus, ExternalBus, InputWidth, Signal, SignalOrBus
from kennfeld.importers.simulink.variables.data_types import BusElement, BusType, DataType, UndefinedType

Key: TypeAlias = tuple[FlatBlock, int | str]  # a block and the number of its state, or the name of its input
Shape: TypeAlias = tuple[int, ...]
BusNames: TypeAlias = "tuple[tuple[str, BusNames], ...]"  # of the signals of a bus, () for a signal

_MAX_SUGGESTED_SIZE = 1000


@dataclass(frozen=True)
class RequiredShape:
    """A shape that a block requires of a signal whose shape nothing else determines.

    A `certain` one holds in any case; another one is tried if a block fails without it.
    """

    shape: Shape
    path: str
    certain: bool = False


@dataclass
class InferredAttributes:
    """Attributes found in an earlier pass: shapes of states and sample times of their blocks.

    `wished` are shapes that no input determined but a block downstream requires, `buses` the signals of the buses that
    states hold, `types` the floating-point types of states.
    """

    shapes: dict[Key, Shape] = field(default_factory=dict)
    periods: dict[FlatBlock, float] = field(default_factory=dict)
    taken: frozenset[str] = frozenset()
    wished: dict[Key, RequiredShape] = field(default_factory=dict)
    buses: dict[FlatBlock, BusNames] = field(default_factory=dict)
    types: dict[Key, FloatType] = field(default_factory=dict)
    changed: bool = False

    def bus(self, flat: FlatBlock, names: BusNames) -> None:
        """Record the signals of a bus that a block delays for the next pass."""
        if self.buses.get(flat) != names:
            self.buses[flat] = names
            self.changed = True

    def shape(self, key: Key, shape: Shape) -> None:
        """Record the shape of a state for the next pass."""
        if self.shapes.get(key) != shape:
            self.shapes[key] = shape
            self.changed = True

    def type(self, key: Key, kind: FloatType) -> None:
        """Record the type of a state for the next pass; types only grow, so that passes come to an end."""
        if kind > self.types.get(key, -1):
            self.types[key] = kind
            self.changed = True

    def period(self, flat: FlatBlock, value: float) -> None:
        """Record the sample time of a block for the next pass."""
        if self.periods.get(flat, CONTINUOUS) != value:
            self.periods[flat] = value
            self.changed = True

    def wish(self, wishes: Mapping[Key, RequiredShape], only_certain: bool) -> bool:
        """Take over shapes for the next pass; return False if there is no new one."""
        new = {
            key: required
            for key, required in wishes.items()
            if key not in self.wished and (required.certain or not only_certain)
        }
        self.wished = {**self.wished, **new}
        self.shapes.update({key: required.shape for key, required in new.items()})
        return bool(new)


class DimensionInference:
    """Shapes of states and inputs in one pass; `wishes` are shapes that blocks suggest to scalar inputs."""

    def __init__(self, guesses: InferredAttributes) -> None:
        self.guesses = guesses
        self.wishes: dict[Key, RequiredShape] = {}
        self._scalars: dict[FlatBlock, Key] = {}

    def state_shape(self, key: Key, init: Signal) -> Shape:
        """Infer the shape of a state: from an earlier pass, else of its initial value."""
        if init.size == 1 and key not in self.guesses.shapes:
            # a scalar that nothing determines may be widened by a block that reads it
            self._scalars.setdefault(key[0], key)
        return self.guesses.shapes.get(key, init.shape)

    def wish(self, signal: Signal, source: FlatBlock, shape: Shape, path: str, certain: bool = False) -> None:
        """Record the shape that a block suggests to a signal: that of an input, or of a state of its source."""
        width = signal.width
        key = width.key if width is not None else self._scalars.get(source)
        if key is None or int(np.prod(shape)) > _MAX_SUGGESTED_SIZE:
            return
        # of several suggestions, the first one counts, unless a bus object decides
        if key not in self.wishes or (certain and not self.wishes[key].certain):
            self.wishes[key] = RequiredShape(shape, path, certain)


class ModelInputs(dict[str, FlatBlock | None]):
    """Channels of the model by name, each with its port, None if no port has that name.

    `widths` are the widths of signals that no bus object specifies, `units` the units of signals of buses, by name.
    """

    def __init__(self, builder: GraphBuilder, guesses: InferredAttributes) -> None:
        super().__init__()
        self.builder = builder
        self.guesses = guesses
        self.widths: dict[str, InputWidth] = {}
        self.units: dict[str, str] = {}

    def name(self, flat: FlatBlock) -> str:
        """Name the channel of a port."""
        own = port_label(flat.block) if flat.type == "Inport" else (flat.block.value("GotoTag") or "A").strip()
        return self.channel(flat, own)

    def channel(self, flat: FlatBlock, name: str) -> str:
        """Register a channel of a block under a name, or under one beside it if that is taken."""
        # the names of the clock are channels of their own, those of parameters are taken
        if name in self.guesses.taken or name in CLOCK:
            name = f"{name}_in"
        self[name] = flat
        return name

    def open_signal(self, flat: FlatBlock, name: str, why: str) -> Signal:
        """Return an input whose width is unknown: a scalar, or as wide as a block downstream requires."""
        # by name as well, since each signal of a bus has a shape of its own
        key: Key = (flat, name)
        shape, required = self.guesses.shapes.get(key, (1,)), self.guesses.wished.get(key)
        path = required.path if required is not None else ""
        return self.signal(name, shape, InputWidth(name, math.prod(shape), why, key, path))

    def signal(self, name: str, shape: Shape, width: InputWidth | None = None) -> Signal:
        """Return an input of a known shape, with a channel for each element, column by column."""
        count = math.prod(shape)
        names = [name] if count == 1 else [f"{name}[{i + 1}]" for i in range(count)]
        nodes = np.array([self.builder.input(text) for text in names], dtype=np.int64)
        return Signal(nodes.reshape(shape, order="F"), CONTINUOUS, builder=self.builder, width=width)

    def open_bus(self, flat: FlatBlock, why: str, name: str = "") -> ExternalBus:
        """Return the bus of a port, or a bus within it, whose object is unknown; each used signal becomes an input."""
        return ExternalBus(name=name or self.name(flat), create=partial(self._member, flat, why), why=why)

    def _member(self, flat: FlatBlock, why: str, name: str) -> Signal:
        self.setdefault(name, None)
        signal = self.open_signal(flat, name, why)
        assert signal.width is not None
        self.widths[name] = signal.width
        return signal

    def bus(self, flat: FlatBlock, bus: BusType) -> Bus:
        """Return the bus of a port as its object specifies; raise `EvaluationError` if it is too large."""

        def element_signal(path: str, element: BusElement, kind: DataType | None) -> SignalOrBus:
            self.setdefault(path, None)
            if element.unit:
                self.units[path] = element.unit
            if element.dimensions is None:
                return self._member(flat, f"{bus} leaves it open", path)
            size = math.prod(element.dimensions)
            signal = self.signal(path, element.dimensions, InputWidth(path, size, str(bus)))
            signal = replace(signal, type=float_type_of(kind, flat.scope))
            if not isinstance(kind, UndefinedType):
                return signal
            # without its object, a type may be that of numbers or a bus
            inner = self.open_bus(flat, undefined_reason(kind), path)
            return replace(inner, create=lambda name: signal if name == path else inner.create(name))

        return BusStructure(flat.scope, element_signal).bus(bus, self.name(flat))


def undefined_reason(kind: UndefinedType) -> str:
    """Return why the elements of a bus are unknown whose object is not defined."""
    return f"the bus {kind.name} is not defined"


class PendingCompletions:
    """Completions to run once everything a block depends on is lowered."""

    def __init__(self) -> None:
        self._open: deque[tuple[FlatBlock, Callable[[], None]]] = deque()

    def add(self, flat: FlatBlock, complete: Callable[[], None] = lambda: None) -> None:
        """Schedule a block for lowering and an optional completion after it."""
        self._open.append((flat, complete))

    def __len__(self) -> int:
        return len(self._open)

    def drop(self, blocks: Collection[FlatBlock], since: int) -> None:
        """Drop the completions of some blocks added since a mark; their dependencies are lowered all the same."""
        for at in range(since, len(self._open)):
            if self._open[at][0] in blocks:
                self._open[at] = (self._open[at][0], lambda: None)

    def next(self) -> tuple[FlatBlock, Callable[[], None]] | None:
        """Return the oldest pending entry, None if there is none."""
        return self._open.popleft() if self._open else None
