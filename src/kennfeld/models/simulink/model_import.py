"""The import of one system: its blocks, the solver and the step, the graph, the report, and the model."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from kennfeld.errors import ArgumentError, Finding, InputError
from kennfeld.formatting import nearest
from kennfeld.graph import Graph, GraphBuilder
from kennfeld.graph.bounded_builder import GraphTooLargeError
from kennfeld.models.formula.frontend import expression
from kennfeld.models.formula.printer import merged
from kennfeld.models.model import Model
from kennfeld.models.simulink.flattening.flat_model import FlatBlock, FlatModel
from kennfeld.models.simulink.flattening.integer_signals import converting
from kennfeld.models.simulink.import_report import (
    TYPES_IGNORED,
    CalibratableParameter,
    ImportReport,
    Quantity,
    UnsupportedBlock,
)
from kennfeld.models.simulink.loaded_model import LoadedModel
from kennfeld.models.simulink.lowering.compiler import BlockCompiler, compile_to_fixed_point
from kennfeld.models.simulink.lowering.diagnostics import BlockFailure, UnsupportedError, unsupported_reason
from kennfeld.models.simulink.lowering.pass_state import InferredAttributes
from kennfeld.models.simulink.lowering.registry import BLOCK_TYPES
from kennfeld.models.simulink.lowering.scheduling import ModelClock
from kennfeld.models.simulink.model_assembly import NodeNames
from kennfeld.models.simulink.reader.model_tree import System
from kennfeld.models.simulink.signals import Signal, SignalOrBus
from kennfeld.models.simulink.solver_selection import SolverSelection
from kennfeld.models.simulink.variables.mask_scope import Scope
from kennfeld.models.simulink.variables.model_variables import settings_of
from kennfeld.parameters import Parameter

__all__ = ["ImportResult", "ModelImport"]

_SHOWN = 6
_NAMED = 3  # blocks that a sentence names, of several
_MOST_ATTEMPTS = 20  # to count passes within passes
_MADE = ("Control", "Held", "Pass", "Part", "Iterated", "Joined")


@dataclass(frozen=True)
class ImportResult:
    """What an import made: the model, None where an output could not be built, and the report."""

    model: Model | None
    report: ImportReport


class ModelImport:
    """The import of the blocks of one system."""

    def __init__(
        self,
        opened: LoadedModel,
        system: System,
        scope: Scope,
        cuts: Mapping[str, str] = MappingProxyType({}),
        promote: frozenset[str] = frozenset(),
        step: float | None = None,
    ) -> None:
        self.path, self.document, self.variables = opened.path, opened.document, opened.variables
        self.cuts, self.promote, self.files = cuts, promote, opened.files
        self.most_asked: int | None = None  # operations, where fewer shall be asked for than are possible
        self._asked_before = 0
        self._opened, self._system, self._scope = opened, system, scope
        self.flat = self._flat({})
        self.remarks = list(opened.remarks)
        self.substitutions: list[str] = []
        self.bound = {key: expression(text, f"{self.path.name} bind {key}") for key, text in cuts.items()}
        self._check_cuts()
        self._last = BlockCompiler(self.flat, ModelClock(None), (), self._give, InferredAttributes())
        self.stepping = self._stepped(step)
        self.solver, self.clock = self.stepping.solver, self.stepping.clock

    def _stepped(self, asked: float | None) -> SolverSelection:
        """The solver, and the clock with the step that is asked for, else with that of the model."""
        settings, lost = settings_of(self.document, self.variables)
        stepping = SolverSelection(settings, self.flat.atoms, self._last.expressions, Scope(self.variables))
        self.remarks += stepping.remarks
        told = stepping.substitutions
        if asked is not None:
            if not 0 < asked < math.inf:
                raise ArgumentError(f"step={asked!r} must be a time in s above 0")
            told = [one for one in told if one not in stepping.found]
            stepping.clock.step = asked
        self.substitutions += [*([lost] if lost else []), *told]
        return stepping

    def _flat(self, counts: Mapping[str, int]) -> FlatModel:
        return self._opened.flat(self._system, self._scope, self.cuts, counts)

    def _check_cuts(self) -> None:
        paths = {atom.path for atom in self.flat.atoms}
        unknown = [key for key in self.cuts if _block_of(key) not in paths]
        findings = [
            Finding(f"{self.path.name} bind", f"there is no block {key}", nearest(key, paths)) for key in unknown
        ]
        if findings:
            raise InputError(findings)

    # the graph

    def imported(self) -> ImportResult:
        """The model and the report."""
        compiler = self.woven()
        report = self.report(compiler)
        if not report.whole:
            return ImportResult(None, report)
        model = self._model(compiler, report)
        return ImportResult(model, _faced(report, model))

    @property
    def asked(self) -> int:
        """How many operations the blocks have asked for, in all attempts to build them."""
        return self._asked_before + self._last.builder.asked

    def inspected(self) -> ImportReport:
        """The report alone, also where the blocks ask for too much, or nothing asks for them."""
        try:
            return self.imported().report
        except InputError as error:
            return replace(self.report(self._last), stopped=error.findings)

    def woven(self) -> BlockCompiler:
        """The blocks as a graph; passes whose number depends on signals are counted in a first attempt."""
        for _ in range(_MOST_ATTEMPTS):
            compiler = self._attempt()
            wrong = {path for path, count in compiler.counts.items() if self.flat.counts.get(path) != count}
            if not wrong:
                break
            built = self.flat.counts
            self.flat = self._flat({**built, **compiler.counts})
            if self.flat.counts == built:
                compiler.uncounted(wrong)
                break
        return compiler

    def _attempt(self) -> BlockCompiler:
        """The blocks as a graph, with what is recorded where that can be built as well."""
        flat = self.flat
        compiler = self._woven(flat.results)
        if not flat.outports and not flat.recorded and self._stops(compiler):
            compiler = self._shown(compiler)
        if flat.outports and flat.recorded and not self._stops(compiler):
            more = self._woven([*flat.outports, *flat.recorded])
            compiler = more if not self._stops(more) else compiler
        return compiler

    def _shown(self, compiler: BlockCompiler) -> BlockCompiler:
        """The model of those scopes and displays whose signals can be built; as it is where there is none."""
        shown = self.flat.results
        made = {atom: compiler.outputs(atom) for atom in shown}
        sound = [atom for atom in shown if made[atom] and all(one.sound for one in made[atom])]
        if compiler.visits.loops or not sound:
            return compiler
        left = self._woven(sound)
        if self._stops(left):
            return compiler
        gone = ", ".join(atom.path for atom in shown if atom not in sound)
        self.substitutions.append(f"what {gone[:200]} shows is left out, as it cannot be built")
        return left

    def _woven(self, goals: Collection[FlatBlock]) -> BlockCompiler:
        if not goals:
            message = "it has no outport, and nothing that records or shows a signal"
            raise InputError.of(self.path.name, message, _instead(self._system))

        try:
            return compile_to_fixed_point(self._weaver, goals)
        except GraphTooLargeError as error:
            raise InputError.of(f"{self.path.name} {error.place}".rstrip(), error.message, error.remedy) from None

    def _weaver(self, guesses: InferredAttributes) -> BlockCompiler:
        self._asked_before = self.asked
        made = self._last = BlockCompiler(self.flat, self.clock, self.promote, self._give, guesses)
        made.files = self.files
        made.declared.whole = self.variables
        if self.most_asked is not None:
            made.builder.most = max(self.most_asked - self.asked, 0)
        return made

    def _stops(self, compiler: BlockCompiler) -> bool:
        return bool(compiler.failures or compiler.visits.loops)

    def _give(self, compiler: BlockCompiler, atom: FlatBlock) -> SignalOrBus | tuple[SignalOrBus, ...]:
        """The signals that are given instead of a block."""
        whole = self.bound.get(atom.path)
        count = max(atom.block.ports.outputs if atom.block.ports is not None else 1, 1)
        made: list[SignalOrBus] = []
        for number in range(1, count + 1):
            graph = self.bound.get(f"{atom.path}:{number}", whole)
            made.append(_taken(compiler, graph) if graph is not None else compiler.missing(atom, number))
        return tuple(made)

    def report(self, compiler: BlockCompiler) -> ImportReport:
        """What became of the blocks."""
        atoms = [atom for atom in self.flat.atoms if atom.kind not in _MADE and not (atom.hidden or atom.made)]
        failures: dict[str, BlockFailure] = {}
        for failure in compiler.failures.values():  # that of one pass stands for those of all
            failures.setdefault(failure.atom.path, failure)
        unsupported = [
            UnsupportedBlock(f.atom.path, f.atom.block.type, f.why, f.remedy, True, f.undefined)
            for f in failures.values()
        ]
        seen = {one.path for one in unsupported}
        unsupported += [
            UnsupportedBlock(atom.path, atom.block.type, *_refusal(compiler, atom), False)
            for atom in atoms
            if (atom.kind not in BLOCK_TYPES or BLOCK_TYPES[atom.kind].refused) and atom.path not in seen
        ]
        order = "reads the data store as the step before left it: no priority puts it behind"
        undecided = dict.fromkeys(
            f"{reader.path} {order} {writer.path}. Give both a Priority, since generated code may run them in another "
            "order"
            for writer, reader in compiler.stores.undecided
        )
        loops = tuple(tuple(atom.path for atom in loop) for loop in compiler.visits.loops)
        conversions = any(atom.kind == "DataTypeConversion" for atom in self.flat.atoms)
        note = [TYPES_IGNORED] if conversions else []
        return ImportReport(
            len(atoms), len(atoms) - len(unsupported), tuple(unsupported), loops,
            (*self.flat.chosen, *self.substitutions, *undecided, *note),
            (*compiler.remarks, *_types_left(self.flat.atoms), *self.remarks),
            dict(compiler.declared.sources), dict(compiler.expressions.frozen), self.solver, self.clock.step,
            tuple(_calibratable(one, compiler.declared.sources) for one in compiler.declared.parameters.values()),
            reasons=dict(self.variables.undefined),
        )  # fmt: skip

    def _model(self, compiler: BlockCompiler, report: ImportReport) -> Model:
        try:
            compiler.finish(self.solver)
        except GraphTooLargeError as error:
            raise InputError.of(f"{self.path.name} {self.solver}", error.message, error.remedy) from None
        names = NodeNames(compiler, self.flat)
        builder, number = _plain(compiler)
        visible = {name: number[at] for name, at in names.visible.items()}
        graph = merged(builder.finish(visible, {}, names.outputs))
        values = compiler.declared.values(graph.parameters)
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
            places=MappingProxyType({**names.places, **compiler.declared.sources}),
            values=values,
            remarks=report.told,
            stepped=self.stepping.replaced,
        )


def _faced(report: ImportReport, model: Model) -> ImportReport:
    """The report with what a project meets of the model."""
    units = model.graph.units
    inputs = tuple(Quantity(name, units.get(name, "")) for name in model.graph.inputs)
    outputs = tuple(Quantity(name, units.get(name, "")) for name in model.graph.outputs)
    used = tuple(one for one in report.parameters if one.name in model.values)
    return replace(report, inputs=inputs, outputs=outputs, parameters=used)


def _types_left(atoms: Sequence[FlatBlock]) -> tuple[str, ...]:
    """A sentence on the blocks that make integers of other numbers; none where there are none."""
    paths = converting(atoms)
    if not paths:
        return ()
    names = ", ".join(paths[:_NAMED]) + (f" and {len(paths) - _NAMED} more" if len(paths) > _NAMED else "")
    return (f"integer types are not applied by {names}: in Simulink they round, and wrap or saturate",)


def _calibratable(one: Parameter, sources: Mapping[str, str]) -> CalibratableParameter:
    lower, upper = float(np.max(one.lower)), float(np.min(one.upper))
    return CalibratableParameter(
        one.name, one.kind, one.values.shape, float(np.min(one.values)), float(np.max(one.values)), one.unit,
        lower if math.isfinite(lower) else None, upper if math.isfinite(upper) else None,
        bool(np.all(one.locked)), sources.get(one.name, ""),
    )  # fmt: skip


def _instead(system: System) -> str:
    """What can be done where nothing leaves a system."""
    inner = [block.path for block in system.every() if block.system is not None]
    more = f" and {len(inner) - _SHOWN} more" if len(inner) > _SHOWN else ""
    return f"Import a subsystem: {', '.join(inner[:_SHOWN])}{more}." if inner else "Draw an outport."


def _refusal(compiler: BlockCompiler, atom: FlatBlock) -> tuple[str, str]:
    """Why a block of a type that is not built cannot be, and what would help."""
    kind = BLOCK_TYPES.get(atom.kind)
    if kind is None:
        return unsupported_reason(atom)
    try:
        kind.rule(compiler.site(atom))
    except UnsupportedError as unsupported:
        return unsupported.message, unsupported.remedy
    return unsupported_reason(atom)


def _block_of(key: str) -> str:
    """The path of a block that is bound, without the number of its output."""
    path, colon, number = key.rpartition(":")
    return path if colon and number.isdecimal() else key


def _taken(compiler: BlockCompiler, graph: Graph) -> Signal:
    """A formula's graph within the model's."""
    builder, made = compiler.builder, list[int]()
    states = {which: builder.state(state.latency) for which, state in enumerate(graph.states)}
    for op, args, payload in graph.nodes:
        made.append(states[payload] if op == "state" else builder.node(op, tuple(made[a] for a in args), payload))
    for which, state in enumerate(graph.states):
        builder.close(states[which], made[state.init], made[state.next])
    for name in graph.inputs:
        compiler.inputs.setdefault(name, None)
    return Signal(np.array([made[graph.names["value"]]], dtype=np.int64))


def _plain(compiler: BlockCompiler) -> tuple[GraphBuilder, list[int]]:
    """The graph without the marks of major steps, and the new numbers of its nodes."""
    builder, number = GraphBuilder(), list[int]()
    for op, args, payload in compiler.builder.nodes:
        new = tuple(number[a] for a in args)
        if op == "major":
            number.append(new[0])
        elif op in ("const", "input", "lookup", "state"):
            number.append(builder.node(op, new, payload))
        else:
            number.append(builder.call(op, *new))
    builder.states = [
        state._replace(init=number[state.init], next=number[state.next]) for state in compiler.builder.states
    ]
    return builder, number
