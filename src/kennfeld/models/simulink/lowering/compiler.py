"""Passes over the blocks until every guess is right.

Sizes and sample times of memories that are fed back are not known when they are first read: they are guessed, and the
graph is built again with what was found until nothing changes.

Blocks to graph: one pass over the blocks, which puts its parts to work and keeps the outputs of every block.
"""

from collections.abc import Callable, Collection, Iterable

from kennfeld.graph.bounded_builder import BoundedGraphBuilder
from kennfeld.models.imperative.node_arrays import Nodes
from kennfeld.models.simulink.calibration_parameters import Declared
from kennfeld.models.simulink.expressions.parameter_expressions import Expressions
from kennfeld.models.simulink.flattening.flat_model import STATE, Atom, Flat, Source, Stores
from kennfeld.models.simulink.flattening.iterated_subsystems import LOOPS
from kennfeld.models.simulink.lowering.block_context import Site
from kennfeld.models.simulink.lowering.block_order import Needs, Visits
from kennfeld.models.simulink.lowering.continuous_states import ContinuousStates
from kennfeld.models.simulink.lowering.diagnostics import (
    UNFIT,
    Failures,
    UnsupportedError,
    stand_in,
    stand_ins,
    unknown,
)
from kennfeld.models.simulink.lowering.discrete_states import Contents, Memories
from kennfeld.models.simulink.lowering.pass_state import Agenda, Guesses, Inputs, Shapes
from kennfeld.models.simulink.lowering.registry import KINDS, Kind
from kennfeld.models.simulink.lowering.scheduling import Clock, Gates, Timing
from kennfeld.models.simulink.lowering.state_ports import StatePorts, is_ahead
from kennfeld.models.simulink.reader.model_tree import joined, split
from kennfeld.models.simulink.signals import Bus, OpenBus, Signal, Wired
from kennfeld.models.simulink.variables.m_files import FunctionFiles
from kennfeld.models.simulink.variables.mask_scope import Scope, Variable

__all__ = ["Weaver", "settled"]

_MOST_PASSES = 500
_MOST_ASKED = 20_000_000  # operations of all passes
_UNSETTLED = "the sizes or sample times of the signals that are fed back before it do not settle"
_MEND = "Give the delays and integrators before it initial values of the size of their signals."


class Weaver:
    """One pass over the blocks. `bound` gives the nodes of blocks that are cut, `clock` the steps of the model.

    `timing` knows sample times, `gates` conditional subsystems, `memories`, `continuous` and `contents` what lasts
    until the next step, `visits` the order of the blocks, `failures` what could not be built, and `remarks` what
    blocks tell of themselves.
    """

    def __init__(
        self,
        flat: Flat,
        clock: Clock,
        promoted: Iterable[str],
        bound: Callable[["Weaver", Atom], Wired | tuple[Wired, ...]],
        guesses: Guesses,
    ) -> None:
        self.flat, self.clock, self.bound = flat, clock, bound
        self.builder = BoundedGraphBuilder()
        self.declared = Declared(frozenset(promoted))
        self.expressions = Expressions(self.builder, self.declared)
        self.failures = Failures()
        self.inputs = Inputs(self.builder, guesses)
        self.shapes = Shapes(guesses)
        self.timing = Timing(clock, self.expressions, guesses, self.failures)
        self.stores = Stores(flat.atoms, self.timing.task_order)
        self.gates = Gates(self.timing, self.value)
        agenda = Agenda()
        self.ports = StatePorts(self.timing, self.shapes, agenda)
        self.memories = Memories(self.gates, self.ports, self._arriving)
        self.continuous = ContinuousStates(self.memories)
        self.contents = Contents(self.memories, self.stores, self.signal)
        self.needs = Needs(self.site, self.stores, self._ahead, self.failures)
        self.visits = Visits(self.builder, self.needs, agenda, self.failures, self._built)
        self.counts: dict[str, int] = {}
        self.remarks: dict[str, None] = {}
        self.files = FunctionFiles(())
        self._sites: dict[Atom, Site] = {}

    def demand(self, atoms: Iterable[Atom]) -> None:
        """Build blocks and all that they need, memories included."""
        self.visits.demand(atoms)
        self.continuous.settle()

    def finish(self, solver: str) -> None:
        """Advance the continuous states, now that everything they depend on is there."""
        self.continuous.advance(solver)

    # blocks

    def kind(self, atom: Atom) -> Kind | None:
        """What the registry knows of a block's type."""
        return KINDS.get(atom.kind)

    def site(self, atom: Atom) -> Site:
        """The site of a block."""
        if atom not in self._sites:
            self._sites[atom] = Site(self, atom)
        return self._sites[atom]

    def _built(self, atom: Atom) -> tuple[Wired, ...]:
        """The outputs of a block whose inputs are there."""
        kind = self.kind(atom)
        self.builder.place = atom.path
        if atom in self.failures:
            return stand_ins(self.builder, atom)
        if kind is None:
            self.failures.note(atom, *unknown(atom), atom.undefined)
            self.visits.agenda.add(atom)  # what stands before it is looked at all the same
            return stand_ins(self.builder, atom)
        if any(not wired.sound for wired in self._arriving(atom)):
            self._look_for_values(atom, kind)
            return stand_ins(self.builder, atom)
        made: Wired | tuple[Wired, ...] | None = None
        with self.failures.noting(atom):
            made = self._ruled(atom, kind)
        if made is None:
            return stand_ins(self.builder, atom)
        outputs = made if isinstance(made, tuple) else (made,)
        return tuple(self._sampled(atom, wired) for wired in outputs) if kind.held else outputs

    def _sampled(self, atom: Atom, wired: Wired) -> Wired:
        return self.timing.sampled(atom, wired, self.site(atom).memories > 0)

    def _look_for_values(self, atom: Atom, kind: Kind) -> None:
        """Note a variable without a value behind a block that stops: all of them are told at once."""
        try:
            self._ruled(atom, kind)
        except UnsupportedError as unsupported:
            if unsupported.undefined:
                self.failures.note(atom, *unsupported.parts)
        except UNFIT:
            return

    def _ruled(self, atom: Atom, kind: Kind) -> Wired | tuple[Wired, ...]:
        """What a block's rule makes; where it stops half-way, the memories it has begun are not completed."""
        begun = len(self.visits.agenda)
        try:
            return kind.rule(self.site(atom))
        except (UnsupportedError, *UNFIT):
            self.visits.agenda.leave((atom, atom.last), since=begun)
            raise

    # signals

    def value(self, source: Source) -> Wired:
        """The signal of a block's output; the block has been built already, unless it is its state port."""
        if self._ahead(source):
            return self.ports.signal(source.atom)
        if source.atom not in self.visits.values:
            raise UnsupportedError(f"its input from {source.atom.path} comes too late")
        outputs = self.visits.values[source.atom]
        if source.port == STATE and source.atom.kind != "DiscreteIntegrator" and outputs[-1].sound:
            self.failures.note(source.atom, "its state port is read, which is not supported")
            return stand_in(self.builder)
        port = len(outputs) - 1 if source.port == STATE else source.port  # a state port is the last output
        return outputs[port] if port < len(outputs) else stand_in(self.builder)

    def signal(self, source: Source) -> Signal:
        """The signal of a block's output, which is no bus."""
        found = self.value(source)
        if isinstance(found, OpenBus):
            return found.signal
        if isinstance(found, Bus):
            raise UnsupportedError(f"the output of {source.atom.path} is a bus")
        return found

    def outputs(self, atom: Atom) -> tuple[Wired, ...]:
        """The outputs of a block that has been built; none of others."""
        return self.visits.values.get(atom, ())

    def missing(self, atom: Atom, number: int) -> Signal:
        """The signal of an output that is not bound though another of the block is."""
        self.failures.note(atom, f"its output {number} is not bound", f'Bind it as well: "{atom.path}:{number}".')
        return stand_in(self.builder)

    def _ahead(self, source: Source) -> bool:
        return is_ahead(source, self.site)

    def _arriving(self, atom: Atom) -> list[Wired]:
        """The signals at the inputs of a block as far as they are there."""
        there = self.visits.values
        return [self.value(s) for s in atom.inputs if s is not None and (s.atom in there or self._ahead(s))]

    # parameters

    def promoted(self, name: str, text: str, scope: Scope, given: Variable | None) -> Nodes:
        """The nodes of a literal that is a parameter by its block and field; `given` has another value for it."""
        literal = Variable(self.expressions.numbers(text, scope), source="a literal of the block")
        return self.declared.array(self.builder, name, given or literal)

    # passes of subsystems

    def counted(self, path: str, count: int) -> None:
        """Note how many passes a subsystem needs, as one of its inputs says."""
        if self.counts.setdefault(path, count) != count:
            raise UnsupportedError(f"its inputs ask for {self.counts[path]} and for {count} passes")

    def uncounted(self, paths: Collection[str]) -> None:
        """Note that subsystems have another number of passes than their inputs ask for."""
        for atom in self.flat.atoms:
            if atom.kind in LOOPS and joined(*split(atom.path)[:-1]) in paths:
                self.failures.note(atom, "its inputs and its parameters ask for different numbers of passes")


def settled(make: Callable[[Guesses], Weaver], goals: Collection[Atom]) -> Weaver:
    """The pass in which every guess was right; where none is, that is what stops the first of the goals."""
    guesses = Guesses()
    weaver = make(guesses)
    stopped: Weaver | None = None
    asked = 0
    for _ in range(min(_MOST_PASSES, len(weaver.flat.atoms) + 10)):
        if asked > _MOST_ASKED:
            break
        guesses.changed = False
        weaver = make(guesses)
        weaver.demand(goals)
        asked += weaver.builder.asked
        doubled = guesses.taken | (weaver.inputs.keys() & weaver.declared.parameters.keys())
        guesses.changed |= doubled != guesses.taken
        guesses.taken = doubled
        if guesses.changed:
            continue
        wishes = weaver.shapes.wishes
        if not weaver.failures or not wishes or stopped is not None:
            return stopped if stopped is not None and len(stopped.failures) <= len(weaver.failures) else weaver
        stopped, guesses.wished = weaver, wishes
        guesses.shapes.update(wishes)
    weaver.failures.note(next(iter(goals)), _UNSETTLED, _MEND)
    return weaver
