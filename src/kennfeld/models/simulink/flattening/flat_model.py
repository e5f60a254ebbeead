"""Blocks as they are once subsystems are dissolved: where their inputs come from, and what is around them.

A conditional subsystem leaves a block `Control` behind that says when it runs.

Data stores: who writes a named memory, and which of its writers run before a reader within the step.

Tasks decide where each sample time is one. Within a task, priorities decide, those of the nearest blocks around both in
the system that they share; the lower number runs first. Where neither decides, a reader gets what the step before has
left.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from functools import cached_property, cmp_to_key
from typing import NamedTuple, TypeAlias

from kennfeld.models.simulink.reader.model_tree import ModelBlock
from kennfeld.models.simulink.variables.mask_scope import Scope

__all__ = [
    "SINK_TYPES",
    "STATE_PORT",
    "DataStoreOrder",
    "FlatBlock",
    "FlatModel",
    "SignalSource",
    "is_triggered",
    "resets",
    "resets_with_subsystem",
]

STATE_PORT = -1  # the number of a state port among the outputs of its block
SINK_TYPES = ("Scope", "Display", "ToFile", "XYGraph")


class SignalSource(NamedTuple):
    """Where a wire begins: a block and its output, counted from 0, or its state port."""

    atom: "FlatBlock"
    port: int


@dataclass(eq=False)
class FlatBlock:
    """A block that computes something, or one that stands for a conditional subsystem.

    `kind` is its type as the registry of blocks knows it, `path` leads to it from where the import begins. `inputs` are
    the sources of its input ports, None where nothing is connected. `control` says when the conditional subsystem
    around it runs. `names` are the names of the lines at its outputs, `taken` those at its inputs. `places` are the
    blocks around it and itself, from the outside, each with the priority that it is given. `store` is the memory that a
    block reads or writes by its name, `ways` are the elements of a bus that it stands for; `shared` are the memories
    that code uses, by name: what it reads is an input behind its ports, what it leaves an output behind them; blocks
    that are `made` for that read and write the stores. `why` says why it cannot be built, `undefined` which variable
    has no value then.

    In a subsystem that runs several times in a step, `passes` are the passes that it belongs to, of each such subsystem
    around it; `earlier` and `later` are the same block one pass before and behind. `begins` is set in a first pass
    whose memories begin anew in each step, `element` in a For Each subsystem, `hidden` where another one stands for it.
    """

    kind: str
    block: ModelBlock
    path: str
    scope: Scope
    control: "FlatBlock | None" = None
    inputs: list[SignalSource | None] = field(default_factory=list)
    names: dict[int, str] = field(default_factory=dict)
    taken: dict[int, str] = field(default_factory=dict)
    special: dict[str, ModelBlock] = field(default_factory=dict)
    why: str = ""
    undefined: str = ""
    places: tuple[tuple[str, int | None], ...] = ()
    store: "FlatBlock | None" = None
    shared: tuple[str, ...] = ()
    made: bool = False
    passes: tuple[int, ...] = ()
    element: int = 0
    earlier: "FlatBlock | None" = None
    later: "FlatBlock | None" = None
    begins: bool = False
    hidden: bool = False
    ways: tuple[str, ...] = ()

    @property
    def repeats(self) -> bool:
        """Whether it is one of several passes."""
        return self.earlier is not None or self.later is not None

    @property
    def first(self) -> "FlatBlock":
        """The same block in the first pass."""
        here = self
        while here.earlier is not None:
            here = here.earlier
        return here

    @property
    def last(self) -> "FlatBlock":
        """The same block in the last pass."""
        here = self
        while here.later is not None:
            here = here.later
        return here

    def __repr__(self) -> str:
        return f"<{self.kind} {self.path}>"


@dataclass
class FlatModel:
    """All blocks of what is imported; `inports` and `outports` in the order of their ports.

    `chosen` says which variants are active, `counts` are the passes of subsystems by their paths.
    """

    atoms: list[FlatBlock]
    inports: list[FlatBlock]
    outports: list[FlatBlock]
    chosen: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    @cached_property
    def readers(self) -> dict[FlatBlock, list[FlatBlock]]:
        """The blocks that read the outputs of a block."""
        found: dict[FlatBlock, list[FlatBlock]] = {}
        for atom in self.atoms:
            for before in {source.atom for source in atom.inputs if source is not None}:
                found.setdefault(before, []).append(atom)
        return found

    @property
    def recorded(self) -> list[FlatBlock]:
        """The blocks that record a signal."""
        return [atom for atom in self.atoms if atom.kind == "ToWorkspace"]

    @property
    def results(self) -> list[FlatBlock]:
        """The blocks whose signals are the outputs: outports, else what records, else what shows or writes signals."""
        return self.outports or self.recorded or [a for a in self.atoms if a.kind in SINK_TYPES and any(a.inputs)]


def enclosing_conditions(atom: FlatBlock) -> Iterator[FlatBlock]:
    """The conditional subsystems around a block, from the inside."""
    here = atom.control
    while here is not None:
        yield here
        here = here.control


def resets(control: FlatBlock) -> bool:
    """Whether the memories of a conditional subsystem begin anew when it is enabled again."""
    for port, key in (("enable", "StatesWhenEnabling"), ("ifaction", "InitializeStates")):
        if port in control.special and (control.special[port].value(key) or "held") == "reset":
            return True
    trigger = control.special.get("trigger")
    return (
        trigger is not None
        and (trigger.value("StatesWhenEnabling") or "inherit") == "reset"
        and "enable" in control.special
    )


def resets_with_subsystem(atom: FlatBlock) -> bool:
    """Whether the memory of a block may begin anew with a subsystem around it."""
    return any(resets(control) or "reset" in control.special for control in enclosing_conditions(atom))


def is_triggered(atom: FlatBlock) -> bool:
    """Whether a block is in a subsystem that runs at triggers."""
    return any("trigger" in control.special for control in enclosing_conditions(atom))


Order: TypeAlias = Callable[[FlatBlock, FlatBlock], int]


def _by_priority(one: FlatBlock, other: FlatBlock) -> int:
    """-1 where the first block runs before the second by their priorities, 1 where after, 0 where none decides."""
    for (place, priority), (place_2, priority_2) in zip(one.places, other.places, strict=False):
        if place != place_2:
            if priority is None or priority_2 is None or priority == priority_2:
                return 0
            return -1 if priority < priority_2 else 1
    return 0


class DataStoreOrder:
    """The writers of each data store in the order in which they run; `undecided` are pairs that nothing orders.

    `by_task` is -1 where the task of the first of two blocks runs before that of the second, 1 where after, else 0.
    """

    def __init__(self, atoms: Iterable[FlatBlock], by_task: Order = lambda one, other: 0) -> None:
        self._by_task = by_task
        self.writers: dict[FlatBlock, list[FlatBlock]] = {}
        readers: list[FlatBlock] = []
        for atom in atoms:
            if atom.store is not None and atom.kind == "DataStoreWrite":
                self.writers.setdefault(atom.store, []).append(atom)
            elif atom.store is not None:
                readers.append(atom)
        for writers in self.writers.values():
            writers.sort(key=cmp_to_key(self._order))
        self.undecided = [
            (writer, reader) for reader in readers for writer in self._of(reader) if self._open(writer, reader)
        ]

    def _order(self, one: FlatBlock, other: FlatBlock) -> int:
        return self._by_task(one, other) or _by_priority(one, other)

    def _open(self, writer: FlatBlock, reader: FlatBlock) -> bool:
        """Whether nothing says which runs first; code reads what it writes itself before it does."""
        return not self._order(writer, reader) and writer.places != reader.places

    def _of(self, reader: FlatBlock) -> list[FlatBlock]:
        return self.writers.get(reader.store, []) if reader.store is not None else []

    def before(self, reader: FlatBlock) -> list[FlatBlock]:
        """The writers that have run when a block reads; none of a block that writes."""
        if reader.kind != "DataStoreRead":
            return []
        return [writer for writer in self._of(reader) if self._order(writer, reader) < 0]
