"""From a Simulink file to a model."""

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType

import numpy as np

from kennfeld.errors import ArgumentError, Finding, InputError, nearest
from kennfeld.graph import Builder, Graph
from kennfeld.models.formula.frontend import expression
from kennfeld.models.formula.states import merged
from kennfeld.models.model import Model
from kennfeld.models.simulink import blocktypes
from kennfeld.models.simulink.blocktypes.registry import KINDS, UnsupportedError, opaque
from kennfeld.models.simulink.build import Failure, Guesses, Weaver, settled, unknown
from kennfeld.models.simulink.code.files import FunctionFiles
from kennfeld.models.simulink.configuration import asked, settings_of
from kennfeld.models.simulink.expressions import Expressions, NoValueError
from kennfeld.models.simulink.files import read_document
from kennfeld.models.simulink.flatten import Atom, Flat, flatten
from kennfeld.models.simulink.integration import SOLVERS
from kennfeld.models.simulink.libraries import Libraries
from kennfeld.models.simulink.naming import Names
from kennfeld.models.simulink.report import ImportReport, Unsupported
from kennfeld.models.simulink.schedule import Clock, common_step, stated_rate
from kennfeld.models.simulink.scopes import Scope, Variable
from kennfeld.models.simulink.signals import CONSTANT, Signal, Wired
from kennfeld.models.simulink.single import single
from kennfeld.models.simulink.tree import Block, Document, System, joined, split
from kennfeld.models.simulink.variables import Given, Variables, variables_of
from kennfeld.models.simulink.variants import content

__all__ = ["Imported", "Opened", "Work", "import_simulink", "simulink"]

_STIFF = ("ode15s", "ode23s", "ode23t", "ode23tb", "ode14x", "ode1be", "odeN")
_MOST_ATTEMPTS = 20  # to count passes within passes
_MADE = ("Control", "Held", "Pass", "Part", "Iterated", "Joined")
_CONTINUOUS = {
    "Integrator",
    "PID 1dof",
    "PID Controller",
    "PID Controller (with Approximate Derivative)",
    "PID 2dof",
    "SecondOrderIntegrator",
    "StateSpace",
    "TransferFcn",
    "ZeroPole",
}


@dataclass(frozen=True)
class Imported:
    """What an import made: the model, None where an output could not be built, and the report."""

    model: Model | None
    report: ImportReport


def simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[Given] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> Model:
    """The model in a Simulink file, or in one of its subsystems.

    `parameters` are files (.sldd, .mat, .m, calibration files), parameter sets or mappings that give values to the
    variables of the model; later ones win. `bind` replaces blocks by a channel or a formula over channels, by the path
    of the block, with ":2" for its second output alone. `promote` names fields of blocks whose literals become
    parameters, "Torque/Gain1:Gain"; a value given under such a name goes over the literal. Libraries are looked for
    beside the file and in `folders`. `step` in s takes the place of the model's own step.
    Raises `InputError` with every finding where an output cannot be built.
    """
    found = import_simulink(path, subsystem, parameters, bind, promote, folders, step)
    if found.model is None:
        name = Path(path).name
        raise InputError([Finding(f"{name} {one.place}", one.what, one.mend) for one in found.report.findings])
    return found.model


def import_simulink(
    path: str | Path,
    subsystem: str | None = None,
    parameters: Iterable[Given] = (),
    bind: Mapping[str, str] | None = None,
    promote: Collection[str] = (),
    folders: Iterable[str | Path] = (),
    step: float | None = None,
) -> Imported:
    """As `simulink`, with a report of what became of every block, also where the model is not whole."""
    opened = Opened.of(path, parameters, folders)
    system, scope, prefix = opened.system(subsystem)
    cuts = _cuts(opened.path, bind or {}, prefix)
    return Work(opened, system, scope, cuts, frozenset(promote), step).imported()


@dataclass(frozen=True)
class Opened:
    """A file that has been read, its links followed.

    `models` are the names that referenced models see, `files` the functions beside it that code may call.
    """

    path: Path
    document: Document
    variables: Variables
    models: Mapping[str, Scope]
    remarks: tuple[str, ...]
    files: FunctionFiles

    @staticmethod
    def of(path: str | Path, parameters: Iterable[Given] = (), folders: Iterable[str | Path] = ()) -> "Opened":
        """The file, with values for its variables; raises `InputError` where it cannot be read."""
        parameters, folders = tuple(parameters), tuple(folders)
        resolved = Libraries(folders).resolve(read_document(path))
        document = resolved.document
        variables = variables_of(document, parameters)
        models = {name: Scope(_seen(one, variables)) for name, one in resolved.models.items()}
        remarks = (*document.remarks, *map(str, resolved.problems), *map(str, variables.findings))
        variables.update(asked(document, variables))
        named = [Path(one) for one in parameters if isinstance(one, str | Path)]
        files = FunctionFiles([Path(path).parent, *map(Path, folders)], named)
        return Opened(Path(path), document, variables, models, remarks, files)

    def system(self, subsystem: str | None) -> tuple[System, Scope, str]:
        """The system of a path, the names it sees, and its whole path; raises `InputError` where there is none."""
        document, scope = self.document, Scope(self.variables)
        if not subsystem:
            return document.root, scope, ""
        system, names = document.root, split(subsystem)
        names = names[1:] if names and names[0] == document.name and names[0] not in system.by_name else names
        block: Block | None = None
        for name in names:
            block = system.by_name.get(name)
            if block is None or block.system is None:
                known = [b.path for b in document.root.every() if b.system is not None]
                mend = nearest(subsystem, known) or f"Its subsystems are {', '.join(known[:8])}."
                raise InputError.of(document.path.name, f"it has no subsystem {subsystem}", mend)
            if block.chart is not None:
                return single(block, block.system), scope, joined(*names[:-1])
            scope, system = scope.within(block), block.system
        assert block is not None
        try:
            return content(block, scope)[0], scope, block.path
        except NoValueError as error:
            raise InputError.of(f"{document.path.name} {block.path}", str(error)) from None

    def flat(
        self,
        system: System,
        scope: Scope,
        cuts: Mapping[str, str] = MappingProxyType({}),
        counts: Mapping[str, int] = MappingProxyType({}),
    ) -> Flat:
        """The blocks of one of its systems; raises `InputError` where there are too many."""
        try:
            return flatten(system, scope, cuts, opaque(), self.models, frozenset(KINDS), counts)
        except OverflowError as error:
            raise InputError.of(self.path.name, str(error)) from None


def _seen(document: Document, around: Variables) -> dict[str, Variable]:
    """The names that a referenced model sees: its own, then those of the model around it."""
    own = variables_of(document, ())
    return {**around, **own, **asked(document, own)}


def _cuts(path: Path, bind: Mapping[str, str], prefix: str) -> dict[str, str]:
    """The formulas of cut blocks by their paths within the imported system."""
    for key, text in bind.items():
        if not key.strip() or not text.strip():
            raise InputError.of(
                f"{path.name} bind", f'"{key}" = "{text}" is empty', 'Write "path" = "channel or formula".'
            )
    return {_within(key, prefix): text for key, text in bind.items()}


def _within(key: str, prefix: str) -> str:
    return key[len(prefix) + 1 :] if prefix and key.startswith(prefix + "/") else key


class Work:
    """The import of the blocks of one system."""

    def __init__(
        self,
        opened: Opened,
        system: System,
        scope: Scope,
        cuts: Mapping[str, str] = MappingProxyType({}),
        promote: frozenset[str] = frozenset(),
        step: float | None = None,
    ) -> None:
        self.path, self.document, self.variables = opened.path, opened.document, opened.variables
        self.cuts, self.promote, self.files = cuts, promote, opened.files
        self._opened, self._system, self._scope = opened, system, scope
        self.flat = self._flat({})
        self.remarks = list(opened.remarks)
        self.substitutions: list[str] = []
        self.bound = {key: expression(text, f"{self.path.name} bind {key}") for key, text in cuts.items()}
        self._check_cuts()
        self.settings, lost = settings_of(self.document, self.variables)
        self.substitutions += [lost] if lost else []
        self.solver, self.clock = self._solver()
        if step is not None:
            if not 0 < step < math.inf:
                raise ArgumentError(f"step={step!r} must be a time in s above 0")
            self.substitutions.append(f"the step is {step:g} s, as asked for")
            self.clock.step = step

    def _flat(self, counts: Mapping[str, int]) -> Flat:
        return self._opened.flat(self._system, self._scope, self.cuts, counts)

    def _check_cuts(self) -> None:
        paths = {atom.path for atom in self.flat.atoms}
        unknown = [key for key in self.cuts if _block_of(key) not in paths]
        findings = [
            Finding(f"{self.path.name} bind", f"there is no block {key}", nearest(key, paths)) for key in unknown
        ]
        if findings:
            raise InputError(findings)

    # the solver

    def _solver(self) -> tuple[str, Clock]:
        """The solver, and the steps of the model."""
        given = self.settings
        continuous = any(atom.kind in _CONTINUOUS for atom in self.flat.atoms)
        periods = self._periods()
        name = given.name
        fixed = name in SOLVERS or name.casefold() in ("fixedstepdiscrete", "fixedstepauto")
        solver = name if name in SOLVERS else "ode3" if name.casefold() == "fixedstepauto" else "ode4"
        if continuous and not fixed:
            instead = f"{name or 'an unknown solver'} -> ode4 with a fixed step"
            self.substitutions.append(f"{instead}: the step is that of the data unless sample times ask for another")
            if name in _STIFF:
                self.substitutions.append(f"{name} is for stiff models: watch for steps that are too long for ode4")
        if fixed:
            return solver, Clock(self._fixed_step(periods, continuous), continuous)
        step = common_step(periods)
        if step is not None:
            self.substitutions.append(f"a variable step -> {step:g} s, the longest that hits all sample times")
        return solver, Clock(step, continuous)

    def _fixed_step(self, periods: list[float], continuous: bool) -> float | None:
        text = self.settings.fixed_step.strip()
        stated = self._number(text) if text not in ("", "auto") else None
        if stated is not None and stated > 0:
            return stated
        common = common_step(periods)
        if common is not None or not continuous:
            return common
        start, stop = (self._number(text) for text in (self.settings.start, self.settings.stop))
        return (stop - start) / 50 if start is not None and stop is not None and start < stop < math.inf else None

    def _number(self, text: str) -> float | None:
        try:
            found = self._expressions().numbers(text, Scope(self.variables))
        except NoValueError:
            self.remarks.append(f"the solver's setting {text[:60]} has no value")
            return None
        return float(found.item()) if found.size == 1 else None

    def _expressions(self) -> Expressions:
        return Weaver(self.flat, Clock(None), (), self._give, Guesses()).expressions

    def _periods(self) -> list[float]:
        """All sample times that blocks state, and the times between which pulses change."""
        expressions = self._expressions()
        found: list[float] = []
        for atom in self.flat.atoms:
            try:
                rate = stated_rate(atom, expressions, KINDS.get(atom.kind))
                found += [rate.period, rate.offset] if rate is not None else []
                found += blocktypes.sources.pulse_times(atom, expressions)
            except NoValueError:
                continue
        return [period for period in found if 0 < period < CONSTANT]

    # the graph

    def imported(self) -> Imported:
        """The model and the report."""
        weaver = self.woven()
        report = self.report(weaver)
        return Imported(self._model(weaver) if report.whole else None, report)

    def woven(self) -> Weaver:
        """The blocks as a graph; passes whose number depends on signals are counted in a first attempt."""
        for _ in range(_MOST_ATTEMPTS):
            weaver = self._attempt()
            wrong = {path for path, count in weaver.counts.items() if self.flat.counts.get(path) != count}
            if not wrong:
                break
            built = self.flat.counts
            self.flat = self._flat({**built, **weaver.counts})
            if self.flat.counts == built:
                weaver.uncounted(wrong)
                break
        return weaver

    def _attempt(self) -> Weaver:
        """The blocks as a graph, with what is recorded where that can be built as well."""
        flat = self.flat
        weaver = self._woven(flat.results)
        if not flat.outports and not flat.recorded and self._stops(weaver):
            weaver = self._shown(weaver)
        if flat.outports and flat.recorded and not self._stops(weaver):
            more = self._woven([*flat.outports, *flat.recorded])
            weaver = more if not self._stops(more) else weaver
        return weaver

    def _shown(self, weaver: Weaver) -> Weaver:
        """The model of those scopes and displays whose signals can be built; as it is where there is none."""
        shown = self.flat.results
        made = {atom: weaver.outputs(atom) for atom in shown}
        sound = [atom for atom in shown if made[atom] and all(one.sound for one in made[atom])]
        if weaver.loops or not sound:
            return weaver
        left = self._woven(sound)
        if self._stops(left):
            return weaver
        gone = ", ".join(atom.path for atom in shown if atom not in sound)
        self.substitutions.append(f"what {gone[:200]} shows is left out, as it cannot be built")
        return left

    def _woven(self, goals: Collection[Atom]) -> Weaver:
        if not goals:
            what = "it has no outport, and nothing that records or shows a signal"
            raise InputError.of(self.path.name, what, "Import a subsystem.")

        def make(guesses: Guesses) -> Weaver:
            made = Weaver(self.flat, self.clock, self.promote, self._give, guesses)
            made.files = self.files
            return made

        return settled(make, goals)

    def _stops(self, weaver: Weaver) -> bool:
        return bool(weaver.failures or weaver.loops)

    def _give(self, weaver: Weaver, atom: Atom) -> Wired | tuple[Wired, ...]:
        """The signals that are given instead of a block."""
        whole = self.bound.get(atom.path)
        count = max(atom.block.ports.outputs if atom.block.ports is not None else 1, 1)
        made: list[Wired] = []
        for number in range(1, count + 1):
            graph = self.bound.get(f"{atom.path}:{number}", whole)
            made.append(_taken(weaver, graph) if graph is not None else weaver.missing(atom, number))
        return tuple(made)

    def report(self, weaver: Weaver) -> ImportReport:
        """What became of the blocks."""
        atoms = [atom for atom in self.flat.atoms if atom.kind not in _MADE and not (atom.hidden or atom.made)]
        failures: dict[str, Failure] = {}
        for failure in weaver.failures.values():  # that of one pass stands for those of all
            failures.setdefault(failure.atom.path, failure)
        unsupported = [
            Unsupported(f.atom.path, f.atom.block.type, f.why, f.mend, True, f.undefined) for f in failures.values()
        ]
        seen = {one.path for one in unsupported}
        unsupported += [
            Unsupported(atom.path, atom.block.type, *_refusal(weaver, atom), False)
            for atom in atoms
            if (atom.kind not in KINDS or KINDS[atom.kind].refused) and atom.path not in seen
        ]
        order = "reads the data store as the step before left it: no priority puts it behind"
        undecided = dict.fromkeys(f"{reader.path} {order} {writer.path}" for writer, reader in weaver.stores.undecided)
        loops = tuple(tuple(atom.path for atom in loop) for loop in weaver.loops)
        conversions = any(atom.kind == "DataTypeConversion" for atom in self.flat.atoms)
        note = ["number types are left aside: all values are physical, in double precision"] if conversions else []
        return ImportReport(
            len(atoms), len(atoms) - len(unsupported), tuple(unsupported), loops,
            (*self.flat.chosen, *self.substitutions, *undecided, *note), tuple(self.remarks),
            dict(weaver.declared.sources), dict(weaver.expressions.frozen), self.solver, self.clock.step,
        )  # fmt: skip

    def _model(self, weaver: Weaver) -> Model:
        weaver.finish(self.solver)
        names = Names(weaver, self.flat)
        builder, number = _plain(weaver)
        visible = {name: number[at] for name, at in names.visible.items()}
        graph = merged(builder.finish(visible, {}, names.outputs))
        values = weaver.declared.values(graph.parameters)
        units = {name: one.unit for name, one in values.items() if one.unit} | names.units
        present = {*graph.names, *graph.inputs, *graph.parameters}
        graph = Graph(
            graph.nodes, graph.names, graph.states,
            MappingProxyType({name: unit for name, unit in units.items() if name in present}), graph.outputs,
        )  # fmt: skip
        return Model(
            graph=graph,
            name=self.document.name,
            step=self.clock.step,
            declared=MappingProxyType({name: one.coordinates for name, one in values.items()}),
            source=str(self.path),
            places=MappingProxyType({**names.places, **weaver.declared.sources}),
            values=values,
        )


def _refusal(weaver: Weaver, atom: Atom) -> tuple[str, str]:
    """Why a block of a type that is not built cannot be, and what would help."""
    kind = KINDS.get(atom.kind)
    if kind is None:
        return unknown(atom)
    try:
        kind.rule(weaver.site(atom))
    except UnsupportedError as unsupported:
        return unsupported.what, unsupported.mend
    return unknown(atom)


def _block_of(key: str) -> str:
    """The path of a block that is bound, without the number of its output."""
    path, colon, number = key.rpartition(":")
    return path if colon and number.isdecimal() else key


def _taken(weaver: Weaver, graph: Graph) -> Signal:
    """A formula's graph within the model's."""
    loom, made = weaver.loom, list[int]()
    states = {which: loom.state(state.latency) for which, state in enumerate(graph.states)}
    for op, args, payload in graph.nodes:
        made.append(states[payload] if op == "state" else loom.node(op, tuple(made[a] for a in args), payload))
    for which, state in enumerate(graph.states):
        loom.close(states[which], made[state.init], made[state.next])
    for name in graph.inputs:
        weaver.inputs.setdefault(name, None)
    return Signal(np.array([made[graph.names["value"]]], dtype=np.int64))


def _plain(weaver: Weaver) -> tuple[Builder, list[int]]:
    """The graph without the marks of major steps, and the new numbers of its nodes."""
    builder, number = Builder(), list[int]()
    for op, args, payload in weaver.loom.nodes:
        new = tuple(number[a] for a in args)
        if op == "major":
            number.append(new[0])
        elif op in ("const", "input", "lookup", "state"):
            number.append(builder.node(op, new, payload))
        else:
            number.append(builder.call(op, *new))
    builder.states = [state._replace(init=number[state.init], next=number[state.next]) for state in weaver.loom.states]
    return builder, number
