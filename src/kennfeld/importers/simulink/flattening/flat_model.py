"""Flat blocks: blocks after subsystems are dissolved, and the access order of data stores.

A conditional subsystem leaves a block "ConditionalSubsystem" behind, which computes when it runs. In multitasking mode,
faster tasks run first. Within a task, priorities decide: those of the outermost differing systems, the lower number
first. If neither decides, a reader gets the value of the previous step, and writers run in the order of the file.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import field
from functools import cached_property
from heapq import heapify, heappop, heappush
from itertools import combinations
from typing import NamedTuple, TypeAlias

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.variables.data_types import DataType, output_type
from kennfeld.importers.simulink.variables.mask_scope import Scope

STATE_PORT = -1  # the number of a state port among the outputs of its block
RECORDING_TYPES = ("ToWorkspace", "SignalToWorkspace")  # the second one of the DSP System Toolbox
SINK_TYPES = ("Scope", "Display", "ToFile", "XYGraph", "XY scope.", "Record", "SpectrumAnalyzer")


class SignalSource(NamedTuple):
    """Start of a signal: a block and its output, from 0, or its state port."""

    flat: "FlatBlock"
    port: int


@dataclass(eq=False)
class FlatBlock:
    """A block that computes something, or stands for a conditional subsystem.

    Attributes:
        type: block type in the registry.
        path: path from the imported system.
        inputs: sources of the input ports, None if unconnected.
        control: "ConditionalSubsystem" block of the enclosing conditional subsystem.
        output_names: line names at the outputs; `input_names` at the inputs.
        priority_path: the enclosing blocks from the outside and the block itself, each with its priority.
        data_store: memory that the block reads or writes by name.
        bus_paths: bus elements that it stands for.
        code_stores: data stores used by its code, by name. Reads are inputs after its ports, writes outputs after its
            ports; `synthetic` blocks read and write the stores on its behalf.
        unsupported_reason: why it cannot be built; `undefined` names a variable without a value.
        passes: iteration number in each enclosing iterated subsystem.
        previous_pass: the same block one iteration earlier; `next_pass` one later.
        resets_each_step: set in a first iteration whose states are reset in each step.
        element: set in a For Each subsystem.
        hidden: set if another block stands for it.
        commented: paths of commented-out blocks that fed its inputs, by input.
    """

    type: str
    block: ModelBlock
    path: str
    scope: Scope
    control: "FlatBlock | None" = None
    inputs: list[SignalSource | None] = field(default_factory=list)
    output_names: dict[int, str] = field(default_factory=dict)
    input_names: dict[int, str] = field(default_factory=dict)
    control_ports: dict[str, ModelBlock] = field(default_factory=dict)
    unsupported_reason: str = ""
    undefined: str = ""
    priority_path: tuple[tuple[str, int | None], ...] = ()
    data_store: "FlatBlock | None" = None
    code_stores: tuple[str, ...] = ()
    synthetic: bool = False
    passes: tuple[int, ...] = ()
    element: int = 0
    previous_pass: "FlatBlock | None" = None
    next_pass: "FlatBlock | None" = None
    resets_each_step: bool = False
    hidden: bool = False
    commented: dict[int, str] = field(default_factory=dict)
    bus_paths: tuple[str, ...] = ()

    @cached_property
    def output_type(self) -> DataType | None:
        """The data type that the block specifies for its output, None if it is inherited."""
        return output_type(self.block, self.scope)

    @property
    def repeats(self) -> bool:
        """True if it is one of several iterations."""
        return self.previous_pass is not None or self.next_pass is not None

    @property
    def first(self) -> "FlatBlock":
        """The same block in the first iteration."""
        here = self
        while here.previous_pass is not None:
            here = here.previous_pass
        return here

    @property
    def last(self) -> "FlatBlock":
        """The same block in the last iteration."""
        here = self
        while here.next_pass is not None:
            here = here.next_pass
        return here

    def __repr__(self) -> str:
        return f"<{self.type} {self.path}>"


@dataclass
class FlatModel:
    """All blocks of the imported system; `outports` are in port order.

    `ends` are blocks with outputs that lead nowhere, if nothing else is a result. `variant_choices` describes the
    active variants, `counts` are iteration counts by subsystem path.
    """

    blocks: list[FlatBlock]
    outports: list[FlatBlock]
    ends: tuple[FlatBlock, ...] = ()
    variant_choices: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    @cached_property
    def readers(self) -> dict[FlatBlock, list[FlatBlock]]:
        """Blocks that read the outputs of each block."""
        readers: dict[FlatBlock, list[FlatBlock]] = {}
        for flat in self.blocks:
            for before in {source.flat for source in flat.inputs if source is not None}:
                readers.setdefault(before, []).append(flat)
        return readers

    @property
    def recorded(self) -> list[FlatBlock]:
        """Blocks that record a signal."""
        return [flat for flat in self.blocks if flat.type in RECORDING_TYPES]

    @property
    def results(self) -> list[FlatBlock]:
        """Blocks whose signals are the outputs: outports, else recording blocks, else displays, else ends."""
        displays = [flat for flat in self.blocks if flat.type in SINK_TYPES and any(flat.inputs)]
        return self.outports or self.recorded or displays or list(self.ends)


def enclosing_conditions(flat: FlatBlock) -> Iterator[FlatBlock]:
    """Yield the conditional subsystems around a block, innermost first."""
    here = flat.control
    while here is not None:
        yield here
        here = here.control


def resets_on_enable(control: FlatBlock) -> bool:
    """Return True if enabling a conditional subsystem resets its states."""
    for port, key in (("enable", "StatesWhenEnabling"), ("ifaction", "InitializeStates")):
        if port in control.control_ports and control.control_ports[port].is_set_to(key, "reset"):
            return True
    # a trigger alone never disables its subsystem, so that nothing enables it again
    trigger = control.control_ports.get("trigger")
    resets = trigger is not None and trigger.is_set_to("StatesWhenEnabling", "reset")
    return resets and "enable" in control.control_ports


def resets_with_subsystem(flat: FlatBlock) -> bool:
    """Return True if an enclosing subsystem may reset the states of a block."""
    return any(resets_on_enable(control) or "reset" in control.control_ports for control in enclosing_conditions(flat))


def is_triggered(flat: FlatBlock) -> bool:
    """Return True if a block is in a triggered subsystem."""
    return any("trigger" in control.control_ports for control in enclosing_conditions(flat))


def _exclude_each_other(flat: FlatBlock, other: FlatBlock) -> bool:
    """Return True if two blocks never run in one step: they are in branches of one If or Switch Case block."""
    branches = dict(_branches(flat))
    return any(branches.get(decision, port) != port for decision, port in _branches(other))


def _branches(flat: FlatBlock) -> Iterator[SignalSource]:
    """Yield the outputs of If and Switch Case blocks that make the enclosing subsystems of a block run."""
    for control in enclosing_conditions(flat):
        for port, source in zip(control.control_ports, control.inputs, strict=False):
            if port == "ifaction" and source is not None:
                yield source


Order: TypeAlias = Callable[[FlatBlock, FlatBlock], int]


def _compare_priority(flat: FlatBlock, other: FlatBlock) -> int:
    """Return -1 if the first block runs first by priority, 1 if the second does, 0 if undecided."""
    for (place, priority), (place_2, priority_2) in zip(flat.priority_path, other.priority_path, strict=False):
        # the first systems that differ decide; below them, blocks do not compete
        if place != place_2:
            if priority is None or priority_2 is None or priority == priority_2:
                return 0
            return -1 if priority < priority_2 else 1
    return 0


class DataStoreOrder:
    """Execution order of the writers of each data store.

    `undecided` are writer-reader pairs without an order, `undecided_writers` pairs of writers of one store that are in
    the order of the file, as nothing else decides it.

    `by_task` returns -1 if the task of the first of two blocks runs first, 1 if that of the second does, else 0.
    """

    def __init__(self, blocks: Iterable[FlatBlock], by_task: Order = lambda flat, other: 0) -> None:
        self._by_task = by_task
        self.writers: dict[FlatBlock, list[FlatBlock]] = {}
        readers: list[FlatBlock] = []
        for flat in blocks:
            if flat.data_store is not None and flat.type == "DataStoreWrite":
                self.writers.setdefault(flat.data_store, []).append(flat)
            elif flat.data_store is not None:
                readers.append(flat)
        self.writers = {memory: self._in_order(writers) for memory, writers in self.writers.items()}
        self.undecided_writers = [
            pair
            for writers in self.writers.values()
            for pair in combinations(writers, 2)
            # all iterations of a block have one path
            if self._order(*pair) >= 0 and pair[0].priority_path != pair[1].priority_path
            if not _exclude_each_other(*pair)
        ]
        self.undecided = [
            (writer, reader)
            for reader in readers
            for writer in self._writers_of(reader)
            # code reads a store before it writes it
            if not self._order(writer, reader) and writer.priority_path != reader.priority_path
        ]

    def _in_order(self, writers: Sequence[FlatBlock]) -> list[FlatBlock]:
        """Return writers in a topological order of the pairs with an order, of several ones the first in file order.

        A sort cannot do it: without priorities in between, two writers do not compare, though each may with a third.
        """
        later = [[k for k, other in enumerate(writers) if self._order(flat, other) < 0] for flat in writers]
        awaited = [0] * len(writers)
        for k in (k for following in later for k in following):
            awaited[k] += 1
        ready = [k for k, count in enumerate(awaited) if not count]
        heapify(ready)
        ordered: dict[int, None] = {}
        while len(ordered) < len(writers):
            # an unknown task may make priorities contradict the tasks; file order breaks such a cycle
            first = heappop(ready) if ready else next(k for k in range(len(writers)) if k not in ordered)
            ordered[first] = None
            for k in later[first]:
                awaited[k] -= 1
                if not awaited[k] and k not in ordered:
                    heappush(ready, k)
        return [writers[k] for k in ordered]

    def _order(self, flat: FlatBlock, other: FlatBlock) -> int:
        return self._by_task(flat, other) or _compare_priority(flat, other)

    def _writers_of(self, reader: FlatBlock) -> list[FlatBlock]:
        return self.writers.get(reader.data_store, []) if reader.data_store is not None else []

    def writers_before(self, reader: FlatBlock) -> list[FlatBlock]:
        """Return the writers that run before a reader, [] for a block that also writes."""
        if reader.type != "DataStoreRead":
            return []
        return [writer for writer in self._writers_of(reader) if self._order(writer, reader) < 0]
