"""Blocks to graph: every block in the order of its inputs, memories closed when all else is there.

Sizes and sample times of memories that are fed back are not known when they are first read: they are guessed, and the
graph is built again with what was found until nothing changes.
"""

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from kennfeld.graph import CLOCK
from kennfeld.models.formula.functions import Loom
from kennfeld.models.simulink.blocktypes.registry import KINDS, Kind, UnsupportedError
from kennfeld.models.simulink.bus_ports import port_label
from kennfeld.models.simulink.code.files import FunctionFiles
from kennfeld.models.simulink.declared import Declared
from kennfeld.models.simulink.expressions import Expressions, NoValueError, each
from kennfeld.models.simulink.flatten import STATE, Atom, Flat, Source, controls, resets
from kennfeld.models.simulink.integration import Integrated, advance
from kennfeld.models.simulink.iteration import LOOPS
from kennfeld.models.simulink.libraries import is_of_simulink
from kennfeld.models.simulink.schedule import Clock, Rate, stated_rate
from kennfeld.models.simulink.scopes import Scope, Variable
from kennfeld.models.simulink.signals import CONSTANT, CONTINUOUS, Bus, Nodes, OpenBus, Signal, Wired, fastest
from kennfeld.models.simulink.site import Site, resized
from kennfeld.models.simulink.starts import at_start
from kennfeld.models.simulink.stores import Stores
from kennfeld.models.simulink.tree import joined, split

__all__ = ["Failure", "Guesses", "Weaver", "settled", "unknown"]

UNFIT = (ValueError, IndexError, TypeError, ArithmeticError, NoValueError)
_MOST_PASSES = 500
_WIDEST_WISH = 1000


class Failure(NamedTuple):
    """Why a block could not be built, what would unblock it, and the variable that has no value, if that is why."""

    atom: Atom
    why: str
    mend: str = ""
    undefined: str = ""


@dataclass
class Guesses:
    """What an earlier pass found: the shapes of memories, the sample times of their blocks, names of two things.

    `wished` are shapes that no input gave but a matrix behind the memory asks for.
    """

    shapes: dict[tuple[Atom, int], tuple[int, ...]] = field(default_factory=dict)
    periods: dict[Atom, float] = field(default_factory=dict)
    taken: frozenset[str] = frozenset()
    wished: dict[tuple[Atom, int], tuple[int, ...]] = field(default_factory=dict)
    changed: bool = False

    def shape(self, key: tuple[Atom, int], found: tuple[int, ...]) -> None:
        if self.shapes.get(key) != found:
            self.shapes[key] = found
            self.changed = True

    def period(self, atom: Atom, found: float) -> None:
        if self.periods.get(atom, CONTINUOUS) != found:
            self.periods[atom] = found
            self.changed = True


class Weaver:
    """One pass over the blocks. `bound` gives the nodes of blocks that are cut, `clock` the steps of the model."""

    def __init__(
        self,
        flat: Flat,
        clock: Clock,
        promoted: Iterable[str],
        bound: Callable[["Weaver", Atom], Wired | tuple[Wired, ...]],
        guesses: Guesses,
    ) -> None:
        self.flat = flat
        self.clock = clock
        self.bound = bound
        self.guesses = guesses
        self.loom = Loom()
        self.declared = Declared(frozenset(promoted))
        self.expressions = Expressions(self.loom, self.declared)
        self.failures: dict[Atom, Failure] = {}
        self.loops: list[tuple[Atom, ...]] = []
        self.integrated: list[Integrated] = []
        self.stores = Stores(flat.atoms)
        self._stored: dict[Atom, Signal] = {}
        self._ports: dict[Atom, Nodes] = {}  # states that ports may show, and those that are shown
        self._shown: dict[Atom, Signal] = {}
        self._scalars: dict[Atom, tuple[Atom, int]] = {}
        self.wishes: dict[tuple[Atom, int], tuple[int, ...]] = {}
        self._writes: dict[tuple[Atom, int], Callable[[], Nodes]] = {}
        self._written: dict[tuple[Atom, int], Nodes] = {}
        self.counts: dict[str, int] = {}
        self.inputs: dict[str, Atom | None] = {}
        self.files = FunctionFiles(())
        self._values: dict[Atom, tuple[Wired, ...]] = {}
        self._sites: dict[Atom, Site] = {}
        self._begun: set[Atom] = set()
        self._pending: list[tuple[Atom, Callable[[], None]]] = []

    # order

    def demand(self, atoms: Iterable[Atom]) -> None:
        """Build blocks and all that they need, memories included."""
        for atom in atoms:
            self._visit(atom)
        while self._pending:
            atom, complete = self._pending.pop(0)
            self._visit(atom)
            for needed in self._all_inputs(atom):
                self._visit(needed)
            try:
                complete()
            except UnsupportedError as unsupported:
                self._fail(atom, *unsupported.parts)
            except UNFIT as error:
                self._fail(atom, f"its settings do not fit its signals: {str(error)[:200]}")
        self._settle_starts()

    def _settle_starts(self) -> None:
        """Free the first values behind state ports of the states themselves."""
        reads = [self.loom.node("state", (), which) for which in range(len(self.loom.states))]
        inits = {read: s.init for read, s in zip(reads, self.loom.states, strict=True) if s.init >= 0}
        inits |= {one.state: one.init for one in self.integrated}
        found: dict[int, int] = {}
        for atom in self._shown:
            for state in map(int, self._ports[atom].ravel()):
                made = at_start(self.loom, state, inits) if state in inits else self.loom.const(0.0)
                if made is None:
                    self._fail(atom, "its initial value depends on its own state")
                elif state in inits:
                    found[state] = made
        self.integrated = [one._replace(init=found.get(one.state, one.init)) for one in self.integrated]
        for which, read in enumerate(reads):
            if read in found and self.loom.states[which].init >= 0:
                self.loom.states[which] = self.loom.states[which]._replace(init=found[read])

    def finish(self, solver: str) -> None:
        """Advance the continuous states, now that everything they depend on is there."""
        advance(self.loom, self.integrated, solver)

    def _all_inputs(self, atom: Atom) -> list[Atom]:
        found = [source.atom for source in atom.inputs if source is not None]
        found += self.stores.writers.get(atom, ())
        here = atom.control
        return [*found, here] if here is not None else found

    def _visit(self, root: Atom) -> None:
        stack = [root]
        while stack:
            atom = stack[-1]
            if atom in self._values:
                stack.pop()
                continue
            self._begun.add(atom)
            missing = [needed for needed in self._needed(atom) if needed not in self._values]
            if not missing:
                self._values[atom] = self._built(atom)
                stack.pop()
                continue
            looped = next((needed for needed in missing if needed in self._begun), None)
            if looped is not None:
                begun = [one for one in stack if one in self._begun and one not in self._values]
                self._loop(tuple(dict.fromkeys(begun[begun.index(looped) :])))
            else:
                stack.extend(reversed(missing))

    def _loop(self, atoms: tuple[Atom, ...]) -> None:
        """Note an algebraic loop; one of its blocks gets a signal that stands in."""
        self.loops.append(atoms)
        self._values[atoms[0]] = self._unsound(atoms[0])

    def _needed(self, atom: Atom) -> list[Atom]:
        site, kind = self.site(atom), self.kind(atom)
        try:
            every = range(len(atom.inputs)) if kind is not None else ()
            wanted = every if kind is None or kind.needs is None else kind.needs(site)
            sources = [atom.inputs[index] for index in wanted if index < len(atom.inputs)]
        except UnsupportedError as unsupported:
            self._fail(atom, *unsupported.parts)
            return []
        except UNFIT as error:
            self._fail(atom, f"its settings do not fit its signals: {str(error)[:200]}")
            return []
        found = [source.atom for source in sources if source is not None and not self._ahead(source)]
        if atom.kind in ("Held", "Control", "Pass", "DataStoreWrite") or self._resets(atom):
            found += [atom.control] if atom.control is not None else []
        if atom.earlier is not None:
            found += self._written_by(atom.earlier)
        return [*found, *(self.stores.before(atom) if atom.store is not None else ())]

    def needed(self, atom: Atom) -> list[Atom]:
        """The blocks that a block's outputs depend on within the step."""
        return self._needed(atom)

    def _written_by(self, atom: Atom) -> list[Atom]:
        """What has to be there so that the next pass can read the memory of a block."""
        site = self.site(atom)
        remembers = atom in self._values and (site.memories or site.before)
        return [atom, *self._all_inputs(atom)] if remembers else [atom]

    # blocks

    def kind(self, atom: Atom) -> Kind | None:
        """What the registry knows of a block's type."""
        return KINDS.get(atom.kind)

    def site(self, atom: Atom) -> Site:
        """The site of a block."""
        if atom not in self._sites:
            self._sites[atom] = Site(self, atom)
        return self._sites[atom]

    def value(self, source: Source) -> Wired:
        """The signal of a block's output; the block has been built already, unless it is its state port."""
        if self._ahead(source):
            return self._state_port(source.atom)
        outputs = self._values.get(source.atom)
        if outputs is None:
            raise UnsupportedError(f"its input from {source.atom.path} comes too late")
        if source.port == STATE and source.atom.kind != "DiscreteIntegrator" and outputs[-1].sound:
            self._fail(source.atom, "its state port is read, which is not supported")
            return self._nan()
        port = len(outputs) - 1 if source.port == STATE else source.port  # a state port is the last output
        return outputs[port] if port < len(outputs) else self._nan()

    def outputs(self, atom: Atom) -> tuple[Wired, ...]:
        """The outputs of a block that has been built; none of others."""
        return self._values.get(atom, ())

    def _built(self, atom: Atom) -> tuple[Wired, ...]:
        kind = self.kind(atom)
        if atom in self.failures:
            return self._unsound(atom)
        if kind is None:
            self._fail(atom, *unknown(atom), atom.undefined)
            self._pending.append((atom, lambda: None))  # what stands before it is looked at all the same
            return self._unsound(atom)
        if any(not wired.sound for wired in self._arriving(atom)):
            self._look_for_values(atom, kind)
            return self._unsound(atom)
        try:
            made = kind.rule(self.site(atom))
        except UnsupportedError as unsupported:
            self._fail(atom, *unsupported.parts)
            return self._unsound(atom)
        except UNFIT as error:
            self._fail(atom, f"its settings do not fit its signals: {str(error)[:200]}")
            return self._unsound(atom)
        outputs = made if isinstance(made, tuple) else (made,)
        return tuple(self._sampled(atom, wired) for wired in outputs) if kind.held else outputs

    def _look_for_values(self, atom: Atom, kind: Kind) -> None:
        """Note a variable without a value behind a block that stops: all of them are told at once."""
        try:
            kind.rule(self.site(atom))
        except UnsupportedError as unsupported:
            if unsupported.undefined:
                self._fail(atom, *unsupported.parts)
        except UNFIT:
            return

    def _arriving(self, atom: Atom) -> list[Wired]:
        return [self.value(s) for s in atom.inputs if s is not None and (s.atom in self._values or self._ahead(s))]

    def _fail(self, atom: Atom, what: str, mend: str = "", undefined: str = "") -> None:
        self.failures.setdefault(atom, Failure(atom, what, mend, undefined))

    def unsettled(self, atom: Atom) -> None:
        """Note that sizes and sample times in feedback do not come to an end."""
        self._fail(atom, "the sizes or sample times of the signals that are fed back before it do not settle")

    def counted(self, path: str, count: int) -> None:
        """Note how many passes a subsystem needs, as one of its inputs says."""
        if self.counts.setdefault(path, count) != count:
            raise UnsupportedError(f"its inputs ask for {self.counts[path]} and for {count} passes")

    def uncounted(self, paths: Collection[str]) -> None:
        """Note that subsystems have another number of passes than their inputs ask for."""
        for atom in self.flat.atoms:
            if atom.kind in LOOPS and joined(*split(atom.path)[:-1]) in paths:
                self._fail(atom, "its inputs and its parameters ask for different numbers of passes")

    def _nan(self) -> Signal:
        return Signal(np.array([self.loom.const(float("nan"))], dtype=np.int64), CONSTANT, sound=False)

    def _unsound(self, atom: Atom) -> tuple[Wired, ...]:
        count = atom.block.ports.outputs if atom.block.ports is not None else 1
        return tuple(self._nan() for _ in range(max(count, 1)))

    def input_name(self, atom: Atom) -> str:
        """The name of the channel that a port takes."""
        name = port_label(atom.block) if atom.kind == "Inport" else (atom.block.value("GotoTag") or "A").strip()
        if name in self.guesses.taken or name in CLOCK:
            name = f"{name}_in"
        self.inputs[name] = atom
        return name

    def opened(self, atom: Atom) -> OpenBus:
        """The bus that a port takes; each of its signals that is used becomes an input."""
        return OpenBus(name=self.input_name(atom), node=self._member)

    def _member(self, name: str) -> int:
        self.inputs.setdefault(name, None)
        return self.loom.input(name)

    def missing(self, atom: Atom, number: int) -> Signal:
        """The signal of an output that is not bound though another of the block is."""
        self._fail(atom, f"its output {number} is not bound", f'Bind it as well: "{atom.path}:{number}".')
        return self._nan()

    def built_meanwhile(self, atom: Atom, outputs: tuple[Wired, ...], goals: Iterable[Atom]) -> list[Atom]:
        """Build blocks while another one is built that they depend on, with its outputs as they are by then.

        The blocks that were built for it.
        """
        known = set(self._values)
        self._values[atom] = outputs
        try:
            for goal in goals:
                self._visit(goal)
        finally:
            del self._values[atom]
        return [one for one in self._values if one not in known]

    # parameters

    def promoted(self, name: str, text: str, scope: Scope, given: Variable | None) -> Nodes:
        """The nodes of a literal that is a parameter by its block and field; `given` has another value for it."""
        literal = Variable(self.expressions.numbers(text, scope), source="a literal of the block")
        return self.declared.array(self.loom, name, given or literal)

    # time

    def rate(self, atom: Atom) -> Rate | None:
        """The sample time that a block states by itself; None where it inherits."""
        try:
            return stated_rate(atom, self.expressions, self.kind(atom))
        except NoValueError as error:
            self._fail(atom, f"its sample time has no value: {error}", "", error.undefined)
            return None

    def stated_period(self, atom: Atom) -> float | None:
        """The period of the sample time that a block states in s; None where it inherits."""
        found = self.rate(atom)
        return None if found is None else found.period

    def guessed_period(self, atom: Atom) -> float:
        """The period that a block inherits from its inputs, as an earlier pass found it."""
        return self.guesses.periods.get(atom, CONTINUOUS)

    def _sampled(self, atom: Atom, wired: Wired) -> Wired:
        """An output as it is with the block's own sample time: held between its hits."""
        remembers = self.site(atom).memories > 0
        rate = self.rate(atom) or (Rate(self.guessed_period(atom)) if remembers else None)
        if rate is None or rate.period in (CONTINUOUS, CONSTANT) or isinstance(wired, OpenBus):
            return wired
        if isinstance(wired, Bus):
            return Bus({name: self._sampled(atom, member) for name, member in wired.members.items()})
        if wired.period == CONSTANT or (wired.period == rate.period and not remembers):
            return replace(wired, period=rate.period)
        return self._held(atom, wired, rate)

    def _held(self, atom: Atom, wired: Signal, rate: Rate) -> Signal:
        wired = self.at_major(wired)
        hit = self.clock.hit(self.loom, rate)
        if hit is None:
            return replace(wired, period=rate.period)
        if atom.passes:
            self._fail(atom, "it has a sample time of its own in a subsystem that runs several times in a step")
        made = []
        for node in wired.flat:
            before = self.loom.state()
            y = self.loom.call("select", hit, node, before)
            self.loom.close(before, node, y)
            made.append(y)
        nodes = np.array(made, dtype=np.int64).reshape(wired.shape, order="F")
        return Signal(nodes, rate.period)

    def at_major(self, x: Signal) -> Signal:
        """A signal that keeps, within the minor steps of the solver, its value of the major step."""
        if x.period != CONTINUOUS or not self.clock.continuous:
            return x
        made = [self.major(int(node)) for node in x.nodes.ravel()]
        return replace(x, nodes=np.array(made, dtype=np.int64).reshape(x.shape))

    def major(self, node: int) -> int:
        """A node that keeps its value of the major step within the minor steps."""
        if not self.clock.continuous or self.loom.nodes[node].op in ("const", "major"):
            return node
        return self.loom.node("major", (node,))

    # memory

    def _resets(self, atom: Atom) -> bool:
        """Whether the memory of a block begins anew with a subsystem around it."""
        return any(resets(control) or "reset" in control.special for control in controls(atom))

    def active(self, atom: Atom) -> int | None:
        """The node that says whether a block runs; None where it always does."""
        if atom.control is None:
            return None
        found = self.value(Source(atom.control, 0))
        node = int(found.nodes.ravel()[0]) if isinstance(found, Signal) else None
        always = node is not None and self.loom.value(node) == 1 and not atom.repeats
        return None if always else node

    def restart(self, atom: Atom) -> int | None:
        """The node that says whether the memory of a block begins anew; None where it never does."""
        if atom.control is None or not self._resets(atom):
            return None
        if any(number > 1 for number in atom.passes[len(atom.control.passes) :]):
            return None  # only the first pass of a step does
        found = self.value(Source(atom.control, 1))
        return int(found.nodes.ravel()[0]) if isinstance(found, Signal) else None

    def gate(self, atom: Atom, period: float) -> int | None:
        """The node that says whether a block's memory is written; None where it always is."""
        conditions = [self.active(atom)]
        rate = self.rate(atom) or Rate(period)
        if rate.period not in (CONTINUOUS, CONSTANT):
            conditions.append(self.clock.hit(self.loom, rate))
        return self.both(*conditions)

    def both(self, *conditions: int | None) -> int | None:
        """The node that says whether all conditions hold; None where there are none."""
        found: int | None = None
        for condition in conditions:
            if condition is not None:
                found = condition if found is None else self.loom.call("and", found, condition)
        return found

    def signal(self, source: Source) -> Signal:
        """The signal of a block's output, which is no bus."""
        found = self.value(source)
        if isinstance(found, OpenBus):
            return found.signal
        if isinstance(found, Bus):
            raise UnsupportedError(f"the output of {source.atom.path} is a bus")
        return found

    def always(self, site: Site, init: Signal, x: Signal) -> Signal:
        """A signal of the step before, whether or not the subsystem around the block runs."""
        return self.always_later(site, init, lambda: x)

    def always_later(self, site: Site, init: Signal, x: Callable[[], Signal]) -> Signal:
        """As `always`, of a signal that is made later."""
        site.before += 1
        key, first = (site.atom, STATE - site.before), init.nodes
        read = self._read(key, first, 1)
        self._writes[key] = lambda: self.at_major(x()).nodes
        return Signal(read, CONTINUOUS)

    # memory of several passes within a step

    def _read(self, key: tuple[Atom, int], first: Nodes, latency: int) -> Nodes:
        """What a memory holds when its block is built: what the step before has left, or the pass before."""
        atom, number = key
        if atom.earlier is not None:
            found = self._after((atom.earlier, number))
            return resized(found, first.shape)
        if atom.begins:
            return first
        states = self._states(key, first, latency)
        self._pending.append((atom.last, lambda: self._kept((atom.last, number), states, first)))
        return np.array(states, dtype=np.int64).reshape(first.shape)

    def _after(self, key: tuple[Atom, int]) -> Nodes:
        """What a memory holds after its block has run."""
        if key not in self._written:
            if key not in self._writes:
                raise UnsupportedError("its pass before could not be built")
            self._written[key] = self._writes[key]()
        return self._written[key]

    def _kept(self, key: tuple[Atom, int], states: Sequence[int], first: Nodes) -> None:
        """Close a memory with what the last pass leaves in it."""
        new = self._after(key) if key in self._writes else first
        for state, init, node in zip(states, first.ravel(), new.ravel(), strict=True):
            self.loom.close(state, int(init), int(node))

    def stored(self, memory: Atom, init: Signal) -> Signal:
        """What a data store holds at the beginning of the step; its writers are built for the end of it."""
        if memory.passes:
            raise UnsupportedError("its memory is in a subsystem that runs several times in a step")
        if memory not in self._stored:
            key = (memory, 1)
            shape = self.guesses.shapes.get(key, init.shape)
            first = resized(init.nodes, shape) if init.size == 1 else init.nodes
            states = [self.loom.state() for _ in range(first.size)]
            begun = Signal(np.array(states, dtype=np.int64).reshape(first.shape))
            self._stored[memory] = begun

            def complete() -> None:
                end = self.written(begun, self.stores.writers.get(memory, ()))
                if end.size != begun.size:
                    self.guesses.shape(key, end.shape)
                    end = begun
                for state, one, node in zip(states, first.ravel(), end.nodes.ravel(), strict=True):
                    self.loom.close(state, int(one), int(node))

            self._pending.append((memory, complete))
        return self._stored[memory]

    def written(self, content: Signal, writers: Iterable[Atom]) -> Signal:
        """The content of a data store after some of its writers have run."""
        for writer in writers:
            given = self.at_major(self.signal(Source(writer, 0)))
            gate = self.gate(writer, given.period)
            if gate is None:
                content = given
                continue
            old = resized(content.nodes, given.shape) if content.size == 1 else content.nodes
            runs = np.array([gate], dtype=np.int64)
            content = Signal(each(self.loom, "select", runs, given.nodes, old), CONTINUOUS)
        return content

    def is_triggered(self, atom: Atom) -> bool:
        """Whether a block is in a subsystem that runs at triggers."""
        here = atom.control
        while here is not None:
            if "trigger" in here.special:
                return True
            here = here.control
        return False

    def runs_every_step(self, atom: Atom) -> bool:
        """Whether a block's memory is written in every step of the model."""
        rate = self.rate(atom) or Rate(self.guessed_period(atom))
        every = rate.period in (CONTINUOUS, CONSTANT) or self.clock.hit(self.loom, rate) is None
        return atom.control is None and every and not atom.repeats and not atom.begins

    def hits(self, period: float) -> Signal:
        """1 at the hits of a sample time."""
        node = self.clock.hit(self.loom, Rate(period)) if period > 0 else None
        return Signal(np.array([self.loom.const(1.0) if node is None else node], dtype=np.int64), max(period, 0.0))

    def _ahead(self, source: Source) -> bool:
        """Whether a source is the state port of a block whose state is known as the step begins."""
        if source.port != STATE or source.atom.kind not in ("Integrator", "DiscreteIntegrator"):
            return False
        return source.atom.kind == "Integrator" or "Forward" in self.site(source.atom).text("IntegratorMethod")

    def _state_port(self, atom: Atom) -> Signal:
        """The state of a block as the step begins; the block itself, which a reset may change, is built later."""
        if atom.passes:
            self._fail(atom, "its state port is read in a subsystem that runs several times in a step")
            return self._nan()
        if atom not in self._shown:
            if atom not in self._ports:
                shape = self.guesses.shapes.get((atom, STATE), (1,))
                self._ports[atom] = np.array([self.loom.state() for _ in range(int(np.prod(shape)))]).reshape(shape)
            rate = self.rate(atom) or Rate(self.guessed_period(atom))
            port = Signal(self._ports[atom], rate.period)
            slow = atom.kind == "DiscreteIntegrator" and rate.period not in (CONTINUOUS, CONSTANT)
            self._shown[atom] = self._held(atom, port, rate) if slow else port
            self._pending.append((atom, lambda: self._visit(atom)))
        return self._shown[atom]

    def _states(self, key: tuple[Atom, int], first: Nodes, latency: int = 1) -> list[int]:
        """New memories; those of a state port where it has been read before."""
        atom, number = key
        if number == STATE and atom in self._ports:
            if self._ports[atom].size == first.size:
                return [int(node) for node in self._ports[atom].ravel()]
            self.guesses.shape(key, first.shape)
        states = [self.loom.state(latency) for _ in range(first.size)]
        if number == STATE:
            self._ports.setdefault(atom, np.array(states, dtype=np.int64).reshape(first.shape))
        return states

    def wish(self, atom: Atom, shape: tuple[int, ...]) -> None:
        """Note the shape that a block asks of the memory or input before it, in case that no input gives it one."""
        if atom in self._scalars and int(np.prod(shape)) <= _WIDEST_WISH:
            self.wishes.setdefault(self._scalars[atom], shape)

    def open_shape(self, atom: Atom) -> tuple[int, ...]:
        """The shape of an input that states none: a scalar, or what is asked of it."""
        self._scalars.setdefault(atom, (atom, 0))
        return self.guesses.shapes.get((atom, 0), (1,))

    def _shape(self, key: tuple[Atom, int], init: Signal) -> tuple[int, ...]:
        """The shape of a memory: as an earlier pass found it, else that of its initial value."""
        if init.size == 1 and key not in self.guesses.shapes:
            self._scalars.setdefault(key[0], key)
        return self.guesses.shapes.get(key, init.shape)

    def _widened(self, site: Site, key: tuple[Atom, int]) -> None:
        """Tell of a memory that is a vector for the sake of what is behind it, though its input is a scalar."""
        if key in self.guesses.wished:
            self._fail(site.atom, f"its input is a scalar where a vector of {self.guesses.wished[key]} is asked of it")

    def remember(self, site: Site, number: int, init: Signal, then: Callable[[Signal], Signal], latency: int) -> Signal:
        """A memory of a block that is read now and written at the end of the step."""
        atom, key = site.atom, (site.atom.first, number)
        shape = self._shape(key, init)
        try:
            first = resized(init.nodes, shape)
        except ValueError:
            first = init.nodes
        period = site.period()
        read = Signal(self._read((atom, number), first, latency), period if period else CONTINUOUS)
        seen = self._restarted(atom, read, first)
        self._writes[atom, number] = lambda: self._new(site, key, seen, then)
        return replace(seen, period=period or CONTINUOUS)

    def _restarted(self, atom: Atom, read: Signal, first: Nodes) -> Signal:
        """A memory that begins anew when the subsystem around it is enabled again."""
        begins = self.restart(atom)
        if begins is None:
            return read
        runs = np.array([begins], dtype=np.int64)
        return replace(read, nodes=each(self.loom, "select", runs, first, read.nodes))

    def _new(self, site: Site, key: tuple[Atom, int], seen: Signal, then: Callable[[Signal], Signal]) -> Nodes:
        """What a block leaves in its memory, which it has seen as it was."""
        new = seen
        try:
            if all(wired.sound for wired in self._arriving(site.atom)):
                new = self.at_major(then(seen))
        except UnsupportedError as unsupported:
            self._fail(site.atom, *unsupported.parts)
        self.guesses.period(site.atom, self._inherited(site))
        if new.shape != seen.shape:
            if new.size == 1:
                self._widened(site, key)
                new = replace(new, nodes=resized(new.nodes, seen.shape))
            else:
                self.guesses.shape(key, new.shape)
                new = seen
        gate = self.gate(site.atom, site.period())
        if gate is None:
            return new.nodes
        return each(self.loom, "select", np.array([gate], dtype=np.int64), new.nodes, seen.nodes)

    def _inherited(self, site: Site) -> float:
        """The sample time of a block's inputs."""
        found = fastest([wired.period for wired in self._arriving(site.atom)])
        return CONTINUOUS if found == CONSTANT else found

    def integrate(
        self,
        site: Site,
        number: int,
        init: Signal,
        slope: Callable[[Signal], Signal],
        reset: Signal | None,
        limits: tuple[Signal, Signal] | None,
    ) -> Signal:
        """A continuous state as it is now: the solver advances it at the end of the step."""
        if site.atom.passes:
            raise UnsupportedError("it is integrated over time in a subsystem that runs several times in a step")
        key = (site.atom, number)
        shape = self._shape(key, init)
        first = resized(init.nodes, shape) if init.size in (1, int(np.prod(shape))) else init.nodes
        states = self._states(key, first)
        read = Signal(np.array(states, dtype=np.int64).reshape(first.shape), CONTINUOUS)
        seen = self._restarted(site.atom, read, first)
        if reset is not None:
            nodes = each(self.loom, "select", self.at_major(reset).nodes, first, seen.nodes)
            seen = replace(seen, nodes=nodes)

        def complete() -> None:
            self._slopes(site, key, states, first, seen, slope, limits)

        self._pending.append((site.atom, complete))
        return seen

    def _slopes(
        self,
        site: Site,
        key: tuple[Atom, int],
        states: Sequence[int],
        first: Nodes,
        seen: Signal,
        slope: Callable[[Signal], Signal],
        limits: tuple[Signal, Signal] | None,
    ) -> None:
        rates = replace(seen, nodes=np.full(seen.shape, self.loom.const(0.0), dtype=np.int64))
        try:
            if all(wired.sound for wired in self._arriving(site.atom)):
                rates = slope(seen)
        except UnsupportedError as unsupported:
            self._fail(site.atom, *unsupported.parts)
        if rates.size == 1 < seen.size:
            self._widened(site, key)
        if rates.size > 1 and rates.shape != seen.shape:
            self.guesses.shape(key, rates.shape)
            rates = replace(seen, nodes=np.full(seen.shape, rates.nodes.ravel()[0], dtype=np.int64))
        moving = resized(rates.nodes, seen.shape).ravel()
        low, high = (None, None) if limits is None else tuple(resized(x.nodes, seen.shape).ravel() for x in limits)
        active = self.active(site.atom)
        for at, state in enumerate(states):
            bounds = (None, None) if low is None or high is None else (int(low[at]), int(high[at]))
            made = Integrated(
                state, int(first.ravel()[at]), int(seen.nodes.ravel()[at]), int(moving[at]), bounds, active
            )
            self.integrated.append(made)


def unknown(atom: Atom) -> tuple[str, str]:
    """Why a block of a type that is not in the registry cannot be built, and what would help."""
    if atom.why:
        return f"it is {atom.why}", ""
    elsewhere = atom.block.elsewhere
    if elsewhere and atom.block.system is None:
        stem = re.sub(r"\.(slx|mdl)\Z", "", elsewhere)
        what = f"its content is in the file {elsewhere}, which was not found or does not fit"
        return what, f"Put {stem}.slx beside the model, or bind it."
    if atom.block.type == "ModelReference":
        return (
            f"it runs the model {atom.block.model}, which was not found",
            "Put it beside the model, or bind the block.",
        )
    link = atom.block.reference
    if link is not None and not is_of_simulink(link.source):
        library = (split(link.source) or ("",))[0]
        return f"it is a link into the library {library}, which was not found", f"Put {library}.slx beside the model."
    return f"blocks of type {atom.kind} are not supported", ""


def settled(make: Callable[[Guesses], Weaver], goals: Collection[Atom]) -> Weaver:
    """The pass in which every guess was right; where none is, that is what stops the first of the goals."""
    guesses = Guesses()
    weaver = make(guesses)
    stopped: Weaver | None = None
    for _ in range(min(_MOST_PASSES, len(weaver.flat.atoms) + 10)):
        guesses.changed = False
        weaver = make(guesses)
        weaver.demand(goals)
        doubled = guesses.taken | (weaver.inputs.keys() & weaver.declared.parameters.keys())
        guesses.changed |= doubled != guesses.taken
        guesses.taken = doubled
        if guesses.changed:
            continue
        if not weaver.failures or not weaver.wishes or stopped is not None:
            return stopped if stopped is not None and len(stopped.failures) <= len(weaver.failures) else weaver
        stopped, guesses.wished = weaver, weaver.wishes
        guesses.shapes.update(weaver.wishes)
    weaver.unsettled(next(iter(goals)))
    return weaver
