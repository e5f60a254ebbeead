"""Blocks as they are once subsystems are dissolved: where their inputs come from, and what is around them.

A conditional subsystem leaves a block `Control` behind that says when it runs.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

from kennfeld.models.simulink.files.tree import Block
from kennfeld.models.simulink.variables.scopes import Scope

__all__ = ["SHOWING", "STATE", "Atom", "Flat", "Source", "begins_anew", "controls", "is_triggered", "resets"]

STATE = -1  # the number of a state port among the outputs of its block
SHOWING = ("Scope", "Display", "ToFile", "XYGraph")


class Source(NamedTuple):
    """Where a wire begins: a block and its output, counted from 0, or its state port."""

    atom: "Atom"
    port: int


@dataclass(eq=False)
class Atom:
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
    block: Block
    path: str
    scope: Scope
    control: "Atom | None" = None
    inputs: list[Source | None] = field(default_factory=list)
    names: dict[int, str] = field(default_factory=dict)
    taken: dict[int, str] = field(default_factory=dict)
    special: dict[str, Block] = field(default_factory=dict)
    why: str = ""
    undefined: str = ""
    places: tuple[tuple[str, int | None], ...] = ()
    store: "Atom | None" = None
    shared: tuple[str, ...] = ()
    made: bool = False
    passes: tuple[int, ...] = ()
    element: int = 0
    earlier: "Atom | None" = None
    later: "Atom | None" = None
    begins: bool = False
    hidden: bool = False
    ways: tuple[str, ...] = ()

    @property
    def repeats(self) -> bool:
        """Whether it is one of several passes."""
        return self.earlier is not None or self.later is not None

    @property
    def first(self) -> "Atom":
        """The same block in the first pass."""
        here = self
        while here.earlier is not None:
            here = here.earlier
        return here

    @property
    def last(self) -> "Atom":
        """The same block in the last pass."""
        here = self
        while here.later is not None:
            here = here.later
        return here

    def __repr__(self) -> str:
        return f"<{self.kind} {self.path}>"


@dataclass
class Flat:
    """All blocks of what is imported; `inports` and `outports` in the order of their ports.

    `chosen` says which variants are active, `counts` are the passes of subsystems by their paths.
    """

    atoms: list[Atom]
    inports: list[Atom]
    outports: list[Atom]
    chosen: list[str] = field(default_factory=list)
    counts: dict[str, int] = field(default_factory=dict)

    @cached_property
    def readers(self) -> dict[Atom, list[Atom]]:
        """The blocks that read the outputs of a block."""
        found: dict[Atom, list[Atom]] = {}
        for atom in self.atoms:
            for before in {source.atom for source in atom.inputs if source is not None}:
                found.setdefault(before, []).append(atom)
        return found

    @property
    def recorded(self) -> list[Atom]:
        """The blocks that record a signal."""
        return [atom for atom in self.atoms if atom.kind == "ToWorkspace"]

    @property
    def results(self) -> list[Atom]:
        """The blocks whose signals are the outputs: outports, else what records, else what shows or writes signals."""
        return self.outports or self.recorded or [a for a in self.atoms if a.kind in SHOWING and any(a.inputs)]


def controls(atom: Atom) -> Iterator[Atom]:
    """The conditional subsystems around a block, from the inside."""
    here = atom.control
    while here is not None:
        yield here
        here = here.control


def resets(control: Atom) -> bool:
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


def begins_anew(atom: Atom) -> bool:
    """Whether the memory of a block may begin anew with a subsystem around it."""
    return any(resets(control) or "reset" in control.special for control in controls(atom))


def is_triggered(atom: Atom) -> bool:
    """Whether a block is in a subsystem that runs at triggers."""
    return any("trigger" in control.special for control in controls(atom))
