"""Subsystems dissolved: a flat list of blocks, each knowing where its inputs come from.

Inports, outports, Goto and From blocks and plain subsystems are but wires. A conditional subsystem leaves two things
behind: a block `Control` that says when it runs, and a block `Held` for each of its outputs.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from kennfeld.models.simulink.bus_ports import element_of, elements
from kennfeld.models.simulink.comments import in_use
from kennfeld.models.simulink.expressions import NoValueError
from kennfeld.models.simulink.iteration import Plan, element_scope, iterator_of, planned
from kennfeld.models.simulink.libraries import is_of_simulink
from kennfeld.models.simulink.scopes import Scope, written_names
from kennfeld.models.simulink.tree import Block, Endpoint, Ports, System, joined, split
from kennfeld.models.simulink.variants import active, is_variant, labels_of, member, said, with_choice

__all__ = ["SHOWING", "STATE", "Atom", "Flat", "Source", "controls", "flatten", "member_names", "resets"]

STATE = -1  # the number of a state port among the outputs of its block
SHOWING = ("Scope", "Display", "ToFile", "XYGraph")

_SPECIAL = {"EnablePort": "enable", "TriggerPort": "trigger", "ActionPort": "ifaction", "ResetPort": "reset"}
_NESTED = ("SubSystem", "ModelReference")
_MOST = 100_000  # blocks, all instances of libraries counted


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

    @property
    def recorded(self) -> list[Atom]:
        """The blocks that record a signal."""
        return [atom for atom in self.atoms if atom.kind == "ToWorkspace"]

    @property
    def results(self) -> list[Atom]:
        """The blocks whose signals are the outputs: outports, else what records, else what shows or writes signals."""
        return self.outports or self.recorded or [a for a in self.atoms if a.kind in SHOWING and any(a.inputs)]


class Level:
    """One system on the way: what is in it, and what is around it."""

    def __init__(self, system: System, path: tuple[str, ...], scope: Scope, control: Atom | None) -> None:
        self.system = system
        self.path = path
        self.scope = scope
        self.control = control
        self.parent: Level | None = None
        self.holder: Block | None = None
        self.variant = False
        self.passes: tuple[int, ...] = ()
        self.element = 0
        self.repeated: Plan | None = None
        self.places: tuple[tuple[str, int | None], ...] = ()
        self.below: dict[str, Level] = {}
        self.atoms: dict[str, Atom] = {}
        self.sources: dict[Endpoint, Endpoint] = {}
        self.labels: dict[Endpoint, str] = {}
        self.passing: dict[Endpoint, Endpoint] = {}
        self.fed: dict[str, int] = {}
        self.named: dict[str, dict[int, str]] = {}
        for line in system.lines:
            for end in line.destinations:
                if line.source is not None:
                    self.sources[end] = line.source
                    self.labels[end] = line.name
                    if end.port == "in":
                        self.fed[end.block] = max(end.number, self.fed.get(end.block, 0))
            if line.source is not None and line.name:
                self.labels.setdefault(line.source, line.name)
                if line.source.port == "out":
                    self.named.setdefault(line.source.block, {})[line.source.number - 1] = line.name

    def within(self, parent: "Level | None", holder: Block | None) -> None:
        """Put it into another level, as the content of one of its blocks."""
        self.parent, self.holder = parent, holder
        if parent is not None and holder is not None:
            self.places = (*parent.places, (holder.sid, _priority(holder)))
            self.passes, self.element = parent.passes, parent.element

    def port(self, kind: str, number: int) -> Block | None:
        """The Inport or Outport block of a number."""
        return next((b for b in self.system.of(kind) if _number(b) == number), None)


def _original(level: Level, source: Endpoint | None) -> Endpoint | None:
    """The end of the inport itself, where a line begins at another mark of the same inport."""
    block = level.system.by_sid.get(source.block) if source is not None else None
    if source is None or block is None or block.type != "InportShadow":
        return source
    inport = level.port("Inport", _number(block))
    return Endpoint(inport.sid, source.port, source.number) if inport is not None else None


def _number(block: Block) -> int:
    written = (block.value("Port") or "1").strip()
    return int(written) if written.isdecimal() else 1


def flatten(
    system: System,
    scope: Scope,
    cuts: Mapping[str, str],
    opaque: frozenset[str] = frozenset(),
    models: Mapping[str, Scope] | None = None,
    known: frozenset[str] = frozenset(),
    counts: Mapping[str, int] | None = None,
) -> Flat:
    """The blocks of a system and of all below it.

    `cuts` are the paths of blocks whose outputs are given from outside; `opaque` are the types of masks that are
    blocks of their own and not looked into. `models` are the names that referenced models see, by the models' names.
    `known` are all types of blocks; a link to Simulink's own library of a type that is not among them goes by the name
    that the block has there. `counts` are the passes that subsystems were found to need, by path.
    """
    work = _Flattening(cuts, opaque, models or {}, known, counts or {})
    system = in_use(system)
    root = work.level(Level(system, (), scope, None))
    work.connect()
    ports = {kind: sorted(system.of(kind), key=_number) for kind in ("Inport", "Outport")}
    inports, outports = ([root.atoms[b.sid] for b in ports[kind]] for kind in ("Inport", "Outport"))
    return Flat(work.atoms, inports, outports, work.chosen, work.built)


class _Flattening:
    def __init__(
        self,
        cuts: Mapping[str, str],
        opaque: frozenset[str],
        models: Mapping[str, Scope],
        known: frozenset[str],
        counts: Mapping[str, int],
    ) -> None:
        self.models = models
        self.known = known
        self.counts = counts
        self.joints: list[tuple[Atom, list[tuple[Level, Endpoint] | Source]]] = []
        self.cuts = cuts
        self.opaque = opaque
        self.atoms: list[Atom] = []
        self.levels: list[Level] = []
        self.chosen: list[str] = []
        self.built: dict[str, int] = {}
        self.gotos: dict[str, list[tuple[Level, Block]]] = {}

    def level(self, made: Level, parent: Level | None = None, holder: Block | None = None) -> Level:
        """Place the blocks of a level within another one."""
        made.within(parent, holder)
        self.levels.append(made)
        for block in made.system.blocks:
            self._place(made, block)
        return made

    def _place(self, level: Level, block: Block) -> None:
        path = joined(*level.path, block.name)
        if path in self.cuts:
            self._atom(level, block, "Bound")
        elif is_variant(block):
            self._variant(level, block)
        elif level.parent is not None and element_of(block) is not None:
            self._element(level, block)
        elif block.type in _NESTED and block.system is not None and not (why := self._closed(block)):
            self._enter(level, block, block.system)
        elif block.type == "Goto":
            self.gotos.setdefault((block.value("GotoTag") or "A").strip(), []).append((level, block))
        elif block.type == "Inport" and level.parent is not None:
            self._inport(level, block)
        elif block.type in ("From", "GotoTagVisibility", "InportShadow") or block.type in _SPECIAL:
            pass
        elif block.type == "Outport" and level.parent is not None:
            if level.control is not None and level.control.block is level.holder and level.repeated is None:
                self._atom(level, block, "Held")
        else:
            closed = block.type in _NESTED and block.system is not None
            self._atom(level, block, _kind(block, self.known), why if closed else "")

    def _variant(self, level: Level, block: Block) -> None:
        """A block of variants: only the active one is left of it."""
        labels = labels_of(block)
        scope = level.scope.within(block)
        try:
            at = active(block, labels, scope)
            if block.type == "SubSystem":
                choice = member(block, at) if at is not None else None
                self._enter(level, block, with_choice(block, choice))
                level.below[block.sid].variant = True
        except NoValueError as error:
            self._atom(level, block, block.type, f"a block of variants, and {error}").undefined = error.undefined
            return
        if block.type != "SubSystem":
            self._passed(level, block, at)
        self.chosen.append(f"{joined(*level.path, block.name)}: {said(labels, at, scope)}")

    def _passed(self, level: Level, block: Block, at: int | None) -> None:
        """A variant source or sink that passes on one signal; what reads another one is told."""
        number = 1 if at is None else at + 1
        ends = (1, number) if block.type == "VariantSource" else (number, 1)
        if at is not None:
            level.passing[Endpoint(block.sid, "out", ends[0])] = Endpoint(block.sid, "in", ends[1])
        self._atom(level, block, "Inactive")

    def _element(self, level: Level, block: Block) -> None:
        """A port that several blocks share: one block for each element that goes in, one for the bus that goes out."""
        why = ""
        if level.repeated is not None:
            why = "a bus element of a subsystem that runs several times in a step"
        elif level.control is not None and level.control.block is level.holder:
            why = "an output of a conditional subsystem that is made of bus elements"
        if block.type == "Inport":
            self._atom(level, block, "BusElement", why if level.repeated is not None else "")
        elif block is elements(level.system, "Outport", (block.value("Port") or "1").strip())[0]:
            self._atom(level, block, "BusElements", why)

    def _closed(self, block: Block) -> str:
        """Why a subsystem is not looked into; empty where it is."""
        assert block.system is not None
        chart = block.value("SFBlockType") or "NONE"
        if chart != "NONE" or block.chart is not None:
            return f"a {chart if chart != 'NONE' else 'Chart'}"
        if block.mask is not None and block.mask.type in self.opaque:
            return block.mask.type
        return ""

    def _enter(self, level: Level, block: Block, system: System) -> None:
        system = in_use(system)
        path = (*level.path, block.name)
        scope = level.scope.within(block) if block.type == "SubSystem" else self.models.get(block.model, level.scope)
        iterator = iterator_of(system)
        try:
            plan = planned(iterator, block, path, scope, self.counts) if iterator is not None else None
        except NoValueError as error:
            why = f"a subsystem that runs several times in a step, and {error}"
            self._atom(level, block, block.type, why).undefined = error.undefined
            return
        special = {_SPECIAL[b.type]: b for b in system.of(*_SPECIAL)}
        control = level.control
        if special:
            control = self._atom(level, block, "Control")
            control.special = special
        made = Level(system, path, scope, control)
        if plan is None:
            level.below[block.sid] = self.level(made, level, block)
        else:
            made.within(level, block)
            level.below[block.sid] = made
            self._repeat(level, made, plan)

    # several passes

    def _repeat(self, level: Level, face: Level, plan: Plan) -> None:
        """Place the blocks of a subsystem once for each pass; `face` is what is seen of it from outside."""
        assert face.holder is not None
        self.built[joined(*face.path)] = plan.count
        made: list[Level] = []
        passing: list[Atom] = []
        before: list[Atom] = []
        for number in range(1, plan.count + 1):
            start = len(self.atoms)
            inner = self._pass(level, face, plan, number, made, passing)
            made.append(inner)
            atoms = self.atoms[start:]
            (_beside if plan.each else _behind)(before, atoms)
            if number == 1 and plan.reset and not plan.each:
                _begin(atoms)
            before = atoms
        for outport in face.system.of("Outport"):
            self._result(face, outport, plan, made, passing)

    def _pass(
        self, level: Level, face: Level, plan: Plan, number: int, made: list[Level], passing: list[Atom]
    ) -> Level:
        """One pass, or one element."""
        assert face.holder is not None
        scope = element_scope(plan.block, face.holder, face.scope, number) if plan.each else face.scope
        inner = Level(face.system, face.path, scope, face.control)
        inner.within(level, face.holder)
        inner.repeated = plan
        inner.element = number if plan.each else level.element
        inner.passes = level.passes if plan.each else (*level.passes, number)
        inner.places = (*inner.places, (f"{face.holder.sid}:{number}", number))
        if plan.decides:
            passing.append(self._decision(inner, plan, made))
            inner.control = passing[-1]
        self.levels.append(inner)
        for block in inner.system.blocks:
            self._place(inner, block)
        return inner

    def _decision(self, inner: Level, plan: Plan, made: list[Level]) -> Atom:
        """What says whether a pass takes place: the condition of the pass before, for the first one that to begin."""
        found = self._atom(inner, plan.block, "Pass")
        condition = Endpoint(plan.block.sid, "in", 1 if made else 2)
        if made or plan.asks_first:
            self.joints.append((found, [(made[-1] if made else inner, condition)]))
        return found

    def _result(self, face: Level, outport: Block, plan: Plan, made: list[Level], passing: list[Atom]) -> None:
        """An output: that of the last pass that took place, or of all elements side by side."""
        found = self._atom(face, outport, "Joined" if plan.each else "Iterated")
        found.special = {"each": plan.block} if plan.each else {}
        end = Endpoint(outport.sid, "in")
        ends: list[tuple[Level, Endpoint] | Source] = [(inner, end) for inner in (made if plan.each else made[-1:])]
        if plan.decides:
            ends = [one for inner, say in zip(made, passing, strict=True) for one in ((inner, end), Source(say, 0))]
        self.joints.append((found, ends))
        if face.control is not None and face.control.block is face.holder:
            held = self._atom(face, outport, "Held")
            held.inputs = [Source(found, 0)]

    def _inport(self, level: Level, block: Block) -> None:
        """An inport within a subsystem is but a wire, unless each element gets a part of the signal."""
        plan = level.repeated
        number = _number(block)
        on = plan.block.listed("InputPartition") if plan is not None else ()
        if plan is None or not plan.each or (number <= len(on) and on[number - 1] == "off"):
            return
        assert level.parent is not None
        assert level.holder is not None
        found = self._atom(level, block, "Part")
        found.special = {"each": plan.block}
        self.joints.append((found, [(level.parent, Endpoint(level.holder.sid, "in", number))]))

    def _atom(self, level: Level, block: Block, kind: str, why: str = "") -> Atom:
        made = Atom(kind, block, joined(*level.path, block.name), level.scope, level.control, why=why)
        made.passes, made.element = level.passes, level.element
        self.atoms.append(made)
        if kind != "Control":
            level.atoms[block.sid] = made
        if len(self.atoms) > _MOST:
            raise OverflowError(f"it has more than {_MOST} blocks, all instances of libraries and all passes counted")
        made.places = (*level.places, (block.sid, _priority(block)))
        return made

    def connect(self) -> None:
        """Find the sources of all inputs; a From without a Goto is an input of the model."""
        for level in self.levels:
            for block in level.system.of("From"):
                if self._goto(level, (block.value("GotoTag") or "A").strip()) is None:
                    self._atom(level, block, "From").hidden = level.element > 1 or max(level.passes, default=1) > 1
        for level in self.levels:
            for sid, atom in level.atoms.items():
                self._inputs(level, sid, atom)
                if atom.kind in ("DataStoreRead", "DataStoreWrite"):
                    atom.store = _store(level, atom.block)
            for sid, below in level.below.items():
                control = below.control
                if control is not None and control.block is below.holder:
                    control.inputs = [self._controlling(level, sid, port) for port in control.special]
            for atom in [one for one in level.atoms.values() if one.kind == "MATLAB Function"]:
                self._share(level, atom)
        for atom, ends in self.joints:
            atom.inputs = [end if isinstance(end, Source) else self.source(*end) for end in ends]

    def _share(self, level: Level, atom: Atom) -> None:
        """Blocks that read and write the data stores of code for it."""
        data = atom.block.chart.data if atom.block.chart is not None and not atom.passes else ()
        atom.shared = tuple(one.name for one in data if one.scope == "DATA_STORE_MEMORY_DATA")
        written = written_names(atom.block.script) if atom.shared else frozenset()
        outputs = sum(one.scope == "OUTPUT_DATA" for one in data)
        for at, name in enumerate(atom.shared):
            atom.inputs.append(Source(self._access(level, atom, "DataStoreRead", name), 0))
            if name in written:
                self._access(level, atom, "DataStoreWrite", name).inputs.append(Source(atom, outputs + at))

    def _access(self, level: Level, atom: Atom, kind: str, name: str) -> Atom:
        block = Block(kind, name, "", f"{atom.block.path}/{name}", {"DataStoreName": name}, ports=Ports())
        made = Atom(kind, block, f"{atom.path}/{name}", level.scope, level.control, places=atom.places, made=True)
        made.store = _store(level, block)
        self.atoms.append(made)
        return made

    def _controlling(self, level: Level, sid: str, port: str) -> Source | None:
        """The source at a special port; that of a variant is at the subsystem around it."""
        while level.variant:
            assert level.parent is not None
            assert level.holder is not None
            sid, level = level.holder.sid, level.parent
        return self.source(level, Endpoint(sid, port))

    def _inputs(self, level: Level, sid: str, atom: Atom) -> None:
        count = max(level.fed.get(sid, 0), atom.block.ports.inputs if atom.block.ports is not None else 0)
        ends = [Endpoint(sid, "in", number) for number in range(1, count + 1)]
        if atom.kind == "BusElements":
            shared = elements(level.system, "Outport", (atom.block.value("Port") or "1").strip())
            ends = [Endpoint(one.sid, "in") for one in shared]
            atom.ways = tuple(element_of(one) or "" for one in shared)
        atom.inputs = [self.source(level, end) for end in ends]
        if atom.kind == "BusElement" and level.parent is not None and level.holder is not None:
            atom.inputs = [self.source(level.parent, Endpoint(level.holder.sid, "in", _number(atom.block)))]
            atom.ways = (element_of(atom.block) or "",)
        if atom.kind == "Chart" and atom.block.system is not None:
            atom.special = {_SPECIAL[port.type]: port for port in atom.block.system.of("TriggerPort")}
            ends += [Endpoint(sid, kind) for kind in atom.special]
            atom.inputs += [self.source(level, Endpoint(sid, kind)) for kind in atom.special]
        atom.taken = {i: name for i, end in enumerate(ends) if (name := self._label(level, end))}
        atom.names = {number - 1: name for number, name in atom.block.signals.items()} | level.named.get(sid, {})

    def _label(self, level: Level, end: Endpoint) -> str:
        """The name of the line into a port, or of the line that it comes from through ports and tags."""
        for here, source in self._way(level, end):
            name = here.labels.get(source, "")
            block = here.system.by_sid.get(source.block)
            if name and not name.startswith("<"):
                return name
            if name.startswith("<") and name.endswith(">"):
                return name[1:-1]
            if block is not None and source.number in block.signals:
                return block.signals[source.number]
        return ""

    def source(self, level: Level, end: Endpoint) -> Source | None:
        """The block output that feeds an input port, through subsystems and tags."""
        last = self._begin(level, end)
        if last is None:
            return None
        here, source = last
        if (picked := self._picked(here, source)) is not None:
            return self.source(*picked)
        if (atom := here.atoms.get(source.block)) is not None:
            port = {"out": source.number - 1, "state": STATE}.get(source.port)
            return None if port is None else Source(atom, port)
        below = here.below.get(source.block)
        if below is not None:
            outport = below.port("Outport", source.number)
            held = below.atoms.get(outport.sid) if outport is not None else None
            return Source(held, 0) if held is not None else None
        return None

    def _picked(self, level: Level, source: Endpoint) -> tuple[Level, Endpoint] | None:
        """The input of a bus creator whose signal a bus selector picks; None where there is more between them.

        So a bus may hold a signal that is computed from another one of the same bus.
        """
        atom = level.atoms.get(source.block)
        if atom is None or atom.kind != "BusSelector" or (atom.block.value("OutputAsBus") or "off") == "on":
            return None
        ways = (atom.block.value("OutputSignals") or "").split(",")
        if not source.number <= len(ways):
            return None
        found: tuple[Level, Endpoint] | None = (level, Endpoint(source.block, "in"))
        for name in ways[source.number - 1].strip().split("."):
            found = self._member(*found, name) if found is not None else None
        return found

    def _member(self, level: Level, end: Endpoint, name: str) -> tuple[Level, Endpoint] | None:
        """The input of the bus creator that feeds an end, by the name of its signal."""
        last = self._begin(level, end)
        atom = last[0].atoms.get(last[1].block) if last is not None else None
        if last is None or atom is None or atom.kind != "BusCreator":
            return None
        here, sid = last[0], atom.block.sid
        ends = [Endpoint(sid, "in", number) for number in range(1, here.fed.get(sid, 0) + 1)]
        names = member_names([self._label(here, one) for one in ends], atom.block.value("Inputs") or "")
        return (here, ends[names.index(name)]) if name in names else None

    def _begin(self, level: Level, end: Endpoint) -> tuple[Level, Endpoint] | None:
        """Where the signal at an end is made."""
        way = list(self._way(level, end))
        return way[-1] if way else None

    def _way(self, level: Level, end: Endpoint) -> Iterator[tuple[Level, Endpoint]]:
        """The ends of lines that a signal passes, from where it is used back to where it is made."""
        here: Level | None = level
        at: Endpoint | None = end
        seen: set[tuple[int, Endpoint]] = set()
        while here is not None and at is not None and (id(here), at) not in seen:
            seen.add((id(here), at))
            source = _original(here, here.sources.get(at))
            if source is None:
                return
            yield here, source
            here, at = self._behind(here, source)

    def _behind(self, level: Level, source: Endpoint) -> tuple[Level | None, Endpoint | None]:
        """The input port that a block output merely passes on; None where the block computes something."""
        if source in level.passing:
            return level, level.passing[source]
        if source.block in level.atoms:
            return None, None
        block = level.system.by_sid[source.block]
        if block.type == "Inport" and level.holder is not None and level.parent is not None:
            return level.parent, Endpoint(level.holder.sid, "in", _number(block))
        if block.type == "From":
            goto = self._goto(level, (block.value("GotoTag") or "A").strip())
            return (goto[0], Endpoint(goto[1].sid, "in")) if goto is not None else (None, None)
        below = level.below.get(source.block)
        outport = below.port("Outport", source.number) if below is not None else None
        if below is None or outport is None or outport.sid in below.atoms:
            return None, None
        return below, Endpoint(outport.sid, "in")

    def _goto(self, level: Level, tag: str) -> tuple[Level, Block] | None:
        """The Goto of a tag: local ones in the same system, scoped ones below their mark, global ones anywhere."""
        wide = None
        for where, goto in self.gotos.get(tag, ()):
            if where is level:
                return where, goto
            visibility = goto.value("TagVisibility") or "local"
            if visibility == "global" or (visibility == "scoped" and self._scoped(level, where, tag)):
                wide = wide or (where, goto)
        return wide

    def _scoped(self, level: Level, where: Level, tag: str) -> bool:
        """Whether a mark of the tag's visibility stands in a system around both the From and the Goto."""
        around = set(_around(where))
        return any(
            (mark.value("GotoTag") or "A").strip() == tag
            for here in _around(level)
            if here in around
            for mark in here.system.of("GotoTagVisibility")
        )


def member_names(labels: Sequence[str], stated: str) -> list[str]:
    """The names of a bus creator's signals: those of its lines, else as stated, else numbered.

    >>> member_names(["n", "", "n", ""], "'a','b'")
    ['n', 'b', 'n3', 'signal4']
    """
    listed = re.findall(r"'([^']*)'", stated)
    names: list[str] = []
    for at, label in enumerate(labels):
        name = label or (listed[at] if at < len(listed) else "") or f"signal{at + 1}"
        names.append(f"{name}{at + 1}" if name in names else name)
    return names


def _behind(before: list[Atom], atoms: list[Atom]) -> None:
    """Note which block of a pass is which one of the pass before; those that begin anew have none before them."""
    heads = [(one.last, other) for one, other in zip(before, atoms, strict=False) if other.earlier is None]
    for last, other in heads:
        if not other.begins:
            last.later, other.earlier = other, last
    for one in before:
        one.hidden = True


def _beside(before: list[Atom], atoms: list[Atom]) -> None:
    """Note that the blocks of an element stand for those of the others."""
    for atom in atoms if before else ():
        atom.hidden = True


def _begin(atoms: list[Atom]) -> None:
    """Note that the memories of a first pass begin anew in each step."""
    for atom in atoms:
        if atom.earlier is None:
            atom.begins = True


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


def _priority(block: Block) -> int | None:
    written = (block.parameters.get("Priority") or "").strip()
    return int(written) if re.fullmatch(r"-?\d{1,9}", written) else None


def _store(level: Level, block: Block) -> Atom | None:
    """The memory of a name that is nearest around a block."""
    name = (block.value("DataStoreName") or "A").strip()
    for here in _around(level):
        for memory in here.system.of("DataStoreMemory"):
            if (memory.value("DataStoreName") or "A").strip() == name:
                return here.atoms.get(memory.sid)
    return None


def _around(level: Level) -> Iterator[Level]:
    here: Level | None = level
    while here is not None:
        yield here
        here = here.parent


def _kind(block: Block, known: frozenset[str]) -> str:
    if block.chart is not None and block.chart.kind == "Chart":
        return "Chart"
    if block.script and (block.value("SFBlockType") or "") == "MATLAB Function":
        return "MATLAB Function"
    if block.type == "Reference" and block.reference is not None:
        link = block.reference
        last = (split(link.source) or ("",))[-1]
        by_name = link.type not in known and is_of_simulink(link.source) and last in known
        return last if by_name else f"{link.type or link.source}"
    if block.type == "SubSystem" and block.mask is not None and block.mask.type:
        return block.mask.type
    return block.type
