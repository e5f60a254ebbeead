"""Subsystems that a chart calls by its output events, and the inputs of the chart that come from them.

A called subsystem runs in the midst of the chart's step. Where the chart reads what it makes, it is built at the call,
with the chart's outputs as they are by then.
"""

from collections.abc import Callable, Iterator, Mapping

import numpy as np

from kennfeld.models.simulink.code.errors import MEND
from kennfeld.models.simulink.expressions.signals import Nodes, Wired
from kennfeld.models.simulink.files.ports import port_number
from kennfeld.models.simulink.flattening.atoms import Atom
from kennfeld.models.simulink.stateflow.diagram import Event
from kennfeld.models.simulink.stateflow.execution import Machine
from kennfeld.models.simulink.stateflow.guards import Guard
from kennfeld.models.simulink.weaving.site import Site
from kennfeld.models.simulink.weaving.unsupported import UnsupportedError

__all__ = ["Calls", "port_names"]


def port_names(atom: Atom, kind: str) -> list[str]:
    """The names of a chart's Inports or Outports, in the order of their ports."""
    system = atom.block.system
    if system is None:
        raise UnsupportedError("the file does not say its ports")
    ports = sorted(system.of(kind), key=port_number)
    return [one.name.removesuffix("()") for one in ports]


class Calls:
    """The calls that a chart makes within a step.

    `late` are the inputs that come from what it calls, each with the names of the events that call it.
    """

    def __init__(self, site: Site) -> None:
        self.site = site
        self._nodes: dict[str, int] = {}
        self._made: list[tuple[str, Guard, Mapping[str, Nodes]]] = []
        self._built: set[Atom] = set()
        self._controls = dict(self._called())
        found = {at: self._callers(at) for at in range(len(site.atom.inputs)) if self._controls}
        self.late = {at: names for at, names in found.items() if names}

    @property
    def early(self) -> tuple[int, ...]:
        """The inputs that do not come from called subsystems."""
        return tuple(at for at in range(len(self.site.atom.inputs)) if at not in self.late)

    def _called(self) -> Iterator[tuple[Atom, str]]:
        """What stands for the subsystems that this chart calls, each with the name of the event."""
        names = port_names(self.site.atom, "Outport")
        for atom in self.site.weaver.flat.atoms:
            trigger = atom.special.get("trigger") if atom.kind == "Control" else None
            if trigger is not None and trigger.value("TriggerType") == "function-call":
                for source in atom.inputs:
                    if source is not None and source.atom is self.site.atom and 0 <= source.port < len(names):
                        yield atom, names[source.port]

    def _callers(self, at: int) -> frozenset[str]:
        """The events on whose subsystems an input depends within the step."""
        source = self.site.atom.inputs[at]
        waiting = [source.atom] if source is not None else []
        seen: set[Atom] = {self.site.atom}
        found: set[str] = set()
        while waiting:
            atom = waiting.pop()
            if atom in seen:
                continue
            seen.add(atom)
            if atom in self._controls:
                found.add(self._controls[atom])
            if atom.kind == "Chart":  # which of its inputs it needs is asked in turn
                waiting += [one.atom for one in atom.inputs if one is not None]
            else:
                waiting += self.site.weaver.needs.now(atom)
        return frozenset(found)

    def start(self, at: int) -> Nodes:
        """What a late input is before the first call."""
        source = self.site.atom.inputs[at]
        held = source is not None and source.atom.kind == "Held"
        stated = self.site.weaver.site(source.atom).initial_output() if source is not None and held else None
        return (stated or self.site.constant(0.0)).nodes.reshape(-1, 1)

    def node(self, name: str) -> int:
        """The node that is 1 where the chart has called so far."""
        return self._nodes.get(name, self.site.loom.const(0.0))

    def called(self, event: Event, guard: Guard, machine: Machine, outputs: Callable[[], tuple[Wired, ...]]) -> None:
        """Note a call; where the chart reads what it makes, build the called subsystem now."""
        name = event.written.name
        before = self._nodes.get(name)
        if before is not None and machine.logic.truth(before, guard) is not False:
            raise UnsupportedError(f"it may call {name} twice in a step", MEND)
        self._nodes[name] = guard.node if before is None else machine.loom.call("or", before, guard.node)
        self._made.append((name, guard, dict(machine.variables.values)))
        late = [at for at, names in self.late.items() if name in names]
        if not late:
            return
        if before is not None or any(len(self.late[at]) > 1 for at in late):
            raise UnsupportedError(f"it calls {name} in several places, and reads what it makes", MEND)
        self._build(name, late, machine, outputs())

    def _build(self, name: str, late: list[int], machine: Machine, outputs: tuple[Wired, ...]) -> None:
        atom = self.site.atom
        goals = [source.atom for at in late if (source := atom.inputs[at]) is not None]
        built = self.site.weaver.visits.meanwhile(atom, outputs, goals)
        for one in built:
            reads = any(source is not None and source.atom is atom for source in one.inputs)
            if reads and one not in self._controls and self._caller(one) != name:
                raise UnsupportedError(f"what it calls by {name} needs {one.path}, which needs the chart", MEND)
        self._built.update(built)
        names = port_names(atom, "Inport")
        for at in late:
            key = machine.diagram.data["", names[at]].key
            machine.variables.values[key] = self.site.input(at).nodes.reshape(-1, 1)

    def _caller(self, atom: Atom) -> str:
        """The event that calls the subsystem that a block is in; empty where this chart does not call it."""
        here = atom.control
        while here is not None:
            if here in self._controls:
                return self._controls[here]
            here = here.control
        return ""

    def check(self, machine: Machine) -> None:
        """Refuse outputs that change after a call, where the called subsystem reads them."""
        names = port_names(self.site.atom, "Outport")
        for name, guard, values in self._made:
            changed = {
                at for at, port in enumerate(names)
                if port in values and not self._same(machine, guard, values[port], machine.variables.values[port])
            }  # fmt: skip
            for atom in self.site.weaver.flat.atoms:
                if atom in self._built or self._caller(atom) != name:
                    continue
                for source in atom.inputs:
                    if source is not None and source.atom is self.site.atom and source.port in changed:
                        what = f"it changes {names[source.port]}, which {atom.path} reads, after it has called {name}"
                        raise UnsupportedError(what, MEND)

    def _same(self, machine: Machine, guard: Guard, one: Nodes, other: Nodes) -> bool:
        logic = machine.logic
        return bool(np.array_equal(logic.simplified(one, guard), logic.simplified(other, guard)))
