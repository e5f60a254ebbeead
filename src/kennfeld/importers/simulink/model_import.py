"""Import of one system: flattening, solver and step, lowering, import report and model."""

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from kennfeld.base.errors import ArgumentError, Finding, InputError, Location
from kennfeld.base.formatting import join_names, nearest
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.graph import Graph
from kennfeld.graph.builder import BoundedGraphBuilder, GraphTooLargeError
from kennfeld.graph.integration import apply_solver, is_continuous, without_idle_holds
from kennfeld.importers.simulink.constant_outputs import find_constant_outputs
from kennfeld.importers.simulink.flattening.flat_model import FlatBlock, FlatModel
from kennfeld.importers.simulink.float_types import FloatType
from kennfeld.importers.simulink.import_report import (
    TYPES_IGNORED,
    TYPES_ROUNDED,
    SimulinkReport,
    UnsupportedBlock,
)
from kennfeld.importers.simulink.loaded_model import LoadedModel
from kennfeld.importers.simulink.lowering.compiler import BlockCompiler, compile_to_fixed_point
from kennfeld.importers.simulink.lowering.diagnostics import (
    BUS_REMEDY,
    UnsupportedError,
    placeholder_signal,
    unsupported_reason,
)
from kennfeld.importers.simulink.lowering.lowering_pass import LoweringPass
from kennfeld.importers.simulink.lowering.pass_state import InferredAttributes
from kennfeld.importers.simulink.lowering.registry import BLOCK_TYPES, Outputs
from kennfeld.importers.simulink.lowering.scheduling import ModelClock
from kennfeld.importers.simulink.lowering.single_precision import single_blocks
from kennfeld.importers.simulink.lowering.type_effects import ignored_effects
from kennfeld.importers.simulink.model_assembly import NodeNames
from kennfeld.importers.simulink.physical_networks import with_network_binds
from kennfeld.importers.simulink.reader.dialog_words import match_word
from kennfeld.importers.simulink.reader.model_tree import StoredSolver, System
from kennfeld.importers.simulink.signals import InputWidth, Signal, SignalOrBus, width_note
from kennfeld.importers.simulink.solver_selection import SolverSelection
from kennfeld.importers.simulink.undefined_parameters import undefined_parameters
from kennfeld.importers.simulink.value_proposals import missing_links, propose_files
from kennfeld.importers.simulink.variables.data_types import UndefinedType
from kennfeld.importers.simulink.variables.mask_scope import Scope, signal_unit
from kennfeld.importers.simulink.variables.model_variables import solver_settings
from kennfeld.matlab.errors import failed_assignment
from kennfeld.models.formula.frontend import expression
from kennfeld.models.formula.printer import merge_equal_states
from kennfeld.models.importer import ImportResult
from kennfeld.models.model import Model
from kennfeld.models.quantities import Quantity, calibratable

_MAX_LISTED = 6
_MAX_ATTEMPTS = 20  # to determine nested iteration counts
_SYNTHETIC_TYPES = (
    "ConditionalSubsystem",
    "ConditionalOutput",
    "IterationCondition",
    "ForEachPartition",
    "IterationOutput",
    "ForEachConcatenation",
)


@dataclass(frozen=True)
class SimulinkImport(ImportResult):
    """Result of the import of a Simulink model; `file` is its name."""

    report: SimulinkReport
    file: str = ""

    @property
    def problems(self) -> tuple[Finding, ...]:
        """The parts that are not supported, with the file and the path of the block."""
        return tuple(replace(each, location=_within(self.file, each.location)) for each in self.report.findings)


def _within(file: str, location: object) -> Location:
    """Return a location in a file, which may be the file itself."""
    return Location(file, path="" if str(location) == file else str(location))


class ModelImport:
    """Import of one system of a loaded model."""

    def __init__(
        self,
        loaded: LoadedModel,
        system: System,
        scope: Scope,
        cuts: Mapping[str, str] = MappingProxyType({}),
        promote: frozenset[str] = frozenset(),
        step: float | None = None,
        float32: bool = False,
    ) -> None:
        self.path, self.document, self.variables = loaded.path, loaded.document, loaded.variables
        self.cuts, self.promote, self.files = cuts, promote, loaded.files
        self.most_asked: int | None = None  # limit on operations, below that of the builder
        self._asked_before = 0
        self._loaded, self._system, self._scope = loaded, system, scope
        self._inherited: FloatType | None = None
        self.flat = self._flatten({})
        self.remarks = list(loaded.remarks)
        self.substitutions: list[str] = []
        self.bound = {key: expression(text, Location(self.path.name, path=f"bind {key}")) for key, text in cuts.items()}
        paths = {flat.path for flat in self.flat.blocks}
        if unknown := [key for key in cuts if _block_of(key) not in paths]:
            place = Location(self.path.name, path="bind")
            raise InputError(Finding(place, f"unknown block {key}", nearest(key, paths)) for key in unknown)
        self._last = BlockCompiler(self.flat, ModelClock(None), (), self._bound_signals, InferredAttributes())
        settings, lost = solver_settings(self.document, self.variables)
        self.stepping = self._select_solver(step, settings, lost)
        if float32:
            self._inherited = self._inherited_type(settings)
        self.solver, self.clock = self.stepping.solver, self.stepping.clock

    def _inherited_type(self, settings: StoredSolver) -> FloatType:
        """Return the type of ports that specify none: what surrounds a subsystem is not imported with it."""
        if self._system is not self.document.root:
            return FloatType.UNKNOWN
        is_single = match_word(settings.default_type, ["single"]) is not None
        return FloatType.SINGLE if is_single else FloatType.DOUBLE

    def _select_solver(self, asked: float | None, settings: StoredSolver, lost: str) -> SolverSelection:
        """Select the solver and the clock, with the requested step or that of the model."""
        stepping = SolverSelection(settings, self.flat.blocks, self._last.expressions, Scope(self.variables))
        self.remarks += stepping.warnings
        sentences = stepping.substitutions
        if asked is not None:
            if not 0 < asked < math.inf:
                raise ArgumentError(f"step must be a finite time in s > 0, got {asked!r}")
            sentences = [text for text in sentences if text not in stepping.step_substitutions]
            stepping.clock.step = asked
        self.substitutions += [*([lost] if lost else []), *sentences]
        return stepping

    def _flatten(self, counts: Mapping[str, int]) -> FlatModel:
        return self._loaded.flat(self._system, self._scope, self.cuts, counts)

    def run(self) -> SimulinkImport:
        """Return the model and the report."""
        compiler = self.compile()
        report = self.report(compiler)
        if not report.whole:
            return SimulinkImport(None, self._with_definitions(report, compiler), self.path.name)
        model = self._model(compiler, report)
        graph, units = model.graph, model.graph.units
        inputs, outputs = (
            tuple(Quantity(name, units.get(name, "")) for name in names) for names in (graph.inputs, graph.outputs)
        )
        used = tuple(parameter for parameter in report.parameters if parameter.name in model.values)
        return SimulinkImport(model, replace(report, inputs=inputs, outputs=outputs, parameters=used), self.path.name)

    def _with_definitions(self, report: SimulinkReport, compiler: BlockCompiler) -> SimulinkReport:
        """Return a report with the undefined variables as parameters to define."""
        failed, places = tuple(compiler.failures), self.variables.undefined
        definitions = undefined_parameters(failed, compiler.expressions, report.undefined, report.reasons)
        missing = dict(self.variables.missing_files) if report.undefined else {}
        needed = missing | missing_links(failed)
        # a signal object in a file may declare a data store as well
        stores = [(flat.block.value("DataStoreName") or "").strip() for flat in failed if _lacks_store(flat)]
        undefined = tuple(dict.fromkeys((*report.undefined, *stores, *self._undefined_buses())))
        proposals = propose_files(self.path, self._loaded.search, undefined, places, needed)
        return replace(report, definitions=definitions, missing_files=missing, proposals=proposals)

    def _undefined_buses(self) -> list[str]:
        kinds = [flat.output_type for flat in self.flat.blocks]
        return [kind.name for kind in kinds if isinstance(kind, UndefinedType) and kind.is_bus]

    @property
    def asked(self) -> int:
        """Number of graph operations requested so far, over all attempts."""
        return self._asked_before + self._last.builder.asked

    def inspect(self) -> SimulinkImport:
        """Return model and report; the report alone if the model is too large or has no outputs."""
        try:
            return self.run()
        except InputError as error:
            return SimulinkImport(None, self._stopped(error), self.path.name)

    def survey(self) -> SimulinkReport:
        """Return the report alone: no model is built, and no file is looked for that supplies what is missing."""
        try:
            return self.report(self.compile())
        except InputError as error:
            return self._stopped(error)

    def _stopped(self, error: InputError) -> SimulinkReport:
        return replace(self.report(self._last), stopped=error.findings)

    def compile(self) -> BlockCompiler:
        """Lower the blocks; iteration counts that depend on signals are determined in earlier attempts."""
        for _ in range(_MAX_ATTEMPTS):
            # counts that depend on signals are known once these are lowered, one level of nesting in each attempt
            compiler = self._attempt()
            wrong = {path for path, count in compiler.counts.items() if self.flat.counts.get(path) != count}
            if not wrong:
                break
            built = self.flat.counts
            self.flat = self._flatten({**built, **compiler.counts})
            if self.flat.counts == built:
                compiler.note_conflicting_counts(wrong)
                break
        return compiler

    def _attempt(self) -> BlockCompiler:
        """Lower the outputs, and recorded signals too if they are supported."""
        flat = self.flat
        # recorded signals are a bonus: one that is not supported must not stop the outputs
        compiler = self._compile(flat.results)
        if not flat.outports and not flat.recorded and self._has_failures(compiler):
            compiler = self._compile_displays(compiler)
        if flat.outports and flat.recorded and not self._has_failures(compiler):
            more = self._compile([*flat.outports, *flat.recorded])
            return compiler if self._has_failures(more) else more
        return compiler

    def _compile_displays(self, compiler: BlockCompiler) -> BlockCompiler:
        """Lower those displays whose signals are supported; return `compiler` unchanged if there are none."""
        shown = self.flat.results
        sound = [flat for flat in shown if (signals := compiler.outputs(flat)) and all(s.sound for s in signals)]
        if compiler.visits.loops or not sound:
            return compiler
        partial = self._compile(sound)
        if self._has_failures(partial):
            return compiler
        skipped = ", ".join(flat.path for flat in shown if flat not in sound)
        kind = "signal" if self.flat.ends else "displayed signal"
        self.substitutions.append(f"skipped {skipped[:200]}: the {kind} is not supported")
        return partial

    def _compile(self, goals: Collection[FlatBlock]) -> BlockCompiler:
        if not goals:
            is_library = self._system is self.document.root and self.document.kind == "library"
            message = "it is a library" if is_library else "it has no outport and no signal that could be an output"
            otherwise = "Import a model that uses it." if is_library else "Add an outport."
            raise InputError.of(Location(self.path.name), message, _output_remedy(self._system, otherwise))
        try:
            return compile_to_fixed_point(self._make_compiler, goals)
        except GraphTooLargeError as error:
            raise InputError.of(Location(self.path.name, path=error.place), error.message, error.remedy) from None

    def _make_compiler(self, guesses: InferredAttributes) -> BlockCompiler:
        # the limit on operations counts all passes, of which each begins a graph of its own
        self._asked_before = self.asked
        compiler = self._last = BlockCompiler(
            self.flat, self.clock, self.promote, self._bound_signals, guesses, self._inherited
        )
        compiler.files = self.files
        compiler.declared.whole = self.variables
        if self.most_asked is not None:
            compiler.builder.most = max(self.most_asked - self.asked, 0)
        return compiler

    def _has_failures(self, compiler: BlockCompiler) -> bool:
        return bool(compiler.failures or compiler.visits.loops)

    def _bound_signals(self, compiler: LoweringPass, flat: FlatBlock) -> Outputs:
        whole = self.bound.get(flat.path)
        count = max(flat.block.ports.outputs if flat.block.ports is not None else 1, 1)
        signals: list[SignalOrBus] = []
        for number in range(1, count + 1):
            graph = self.bound.get(f"{flat.path}:{number}", whole)
            if graph is None:
                remedy = f'Bind it too: "{flat.path}:{number}".'
                compiler.failures.note(flat, f"its output {number} is not bound", remedy)
            signals.append(placeholder_signal(compiler.builder) if graph is None else _insert_formula(compiler, graph))
        return tuple(signals)

    def report(self, compiler: BlockCompiler) -> SimulinkReport:
        """Return the import report."""
        named = [flat for flat in self.flat.blocks if not (flat.hidden or flat.synthetic)]
        blocks = [flat for flat in named if flat.type not in _SYNTHETIC_TYPES]
        unsupported: dict[str, UnsupportedBlock] = {}
        for flat, why, remedy, undefined in compiler.failures.values():  # one failure represents all iterations
            block = UnsupportedBlock(flat.path, flat.block.type, why, remedy, True, undefined)
            unsupported.setdefault(flat.path, block)
        for flat in blocks:
            # unsupported blocks that no output needs are listed too
            refused = flat.type not in BLOCK_TYPES or BLOCK_TYPES[flat.type].refused
            if refused and flat.path not in unsupported:
                why, remedy = _refusal(compiler, flat)
                unsupported[flat.path] = UnsupportedBlock(flat.path, flat.block.type, why, remedy, False)
        # blocks behind unsupported ones are never lowered
        behind = [flat for flat in blocks if flat.path not in unsupported and not compiler.is_reached(flat)]
        unreached = tuple(dict.fromkeys(flat.path for flat in behind))
        undecided = dict.fromkeys(
            f"{reader.path} reads the data store before it is written in the step: no priority orders it after "
            f"{writer.path}. Assign a Priority to both, because generated code may run them in another order"
            for writer, reader in compiler.stores.undecided
        )
        undecided |= dict.fromkeys(
            f"{later.path} writes the data store after {first.path}, as in the file: no priority orders them. "
            "Assign a Priority to both, because generated code may run them in another order"
            for first, later in compiler.stores.undecided_writers
        )
        loops = tuple(tuple(flat.path for flat in loop) for loop in compiler.visits.loops)
        effects = ignored_effects(self.flat.blocks, compiler.readers)
        sentences = (*compiler.warnings, *effects, *self._precision(compiler))
        constant = () if unsupported or loops else find_constant_outputs(compiler, self.flat)
        warnings = (
            *constant,
            *_unknown_widths(compiler),
            *(Finding(Location(), sentence, severity="warning") for sentence in sentences),
        )
        ignored = TYPES_IGNORED if self._inherited is None else TYPES_ROUNDED
        ends = join_names([flat.path for flat in self.flat.ends], _MAX_LISTED)
        of_ends = [f"no block is an outport or shows a signal: the outputs are the open ends of {ends}"] if ends else []
        note = [ignored] if any(flat.type == "DataTypeConversion" for flat in self.flat.blocks) else []
        sources = compiler.declared.sources
        return SimulinkReport(
            len(blocks), len(blocks) - len(unsupported) - len(unreached),
            with_network_binds(unsupported.values()), loops,
            (*of_ends, *self.flat.variant_choices, *self.substitutions, *undecided, *note),
            tuple(sorted((*warnings, *self.remarks), key=lambda finding: finding.severity == "remark")),
            dict(sources), dict(compiler.expressions.frozen), self.solver, self.clock.step,
            tuple(calibratable(p, sources.get(p.name, "")) for p in compiler.declared.parameters.values()),
            reasons={name: failed_assignment(place) for name, place in self.variables.undefined.items()},
            unreached=unreached,
            results=tuple(flat.path for flat in self.flat.results),
            has_outports=bool(self.flat.outports or self.flat.ends),
        )  # fmt: skip

    def _precision(self, compiler: BlockCompiler) -> Iterator[str]:
        """Yield remarks on signals of type single."""
        if self._inherited is None:
            if names := single_blocks(self.flat.blocks, compiler.readers):
                yield f"single precision is ignored in {names}: generated code rounds there, as float32 = true does"
        elif unknown := join_names(list(compiler.floats.unknown), _MAX_LISTED):
            yield f"the results of {unknown} are not rounded to single precision: their data types are not known"

    def _model(self, compiler: BlockCompiler, report: SimulinkReport) -> Model:
        names = NodeNames(compiler, self.flat)
        equations = without_idle_holds(compiler.builder.finish(names.visible, {}, names.outputs))
        graph = self._solve(equations)
        values, sources = compiler.declared.values(graph.parameters), compiler.declared.sources
        present = {*graph.names, *graph.inputs, *graph.parameters}
        units = {name: parameter.unit for name, parameter in values.items() if parameter.unit}
        # a port states its own unit, a signal that of the object of its name
        units = self._units_of_signals(present) | units | names.units
        present_units = MappingProxyType({name: unit for name, unit in units.items() if name in present})
        return Model(
            graph=replace(graph, units=present_units),
            name=self.document.name,
            step=self.clock.step,
            declared=MappingProxyType({name: parameter.coordinates for name, parameter in values.items()}),
            source=str(self.path),
            locations=MappingProxyType(names.locations | {name: Location(text) for name, text in sources.items()}),
            values=values,
            remarks=report.notes,
            stepped=self.stepping.replaced,
            equations=replace(equations, units=present_units) if is_continuous(equations) else None,
            solver=self.solver,
        )

    def _units_of_signals(self, names: Collection[str]) -> dict[str, str]:
        """Return the units of signals, or elements of them, that objects of their names describe."""
        units = {name: signal_unit(self.variables.get(name.partition("[")[0])) for name in names}
        return {name: unit for name, unit in units.items() if unit and not any(sign in unit for sign in "]\n\r")}

    def _solve(self, equations: Graph) -> Graph:
        try:
            return merge_equal_states(apply_solver(equations, self.solver, BoundedGraphBuilder))
        except GraphTooLargeError as error:
            raise InputError.of(Location(self.path.name, path=self.solver), error.message, error.remedy) from None


def _unknown_widths(compiler: BlockCompiler) -> Iterator[Finding]:
    """Yield a finding for the signals of buses whose width is unknown for the same reason."""
    # one missing object may leave the widths of hundreds of signals open
    groups: dict[tuple[int, str, str], list[InputWidth]] = {}
    for width in compiler.inputs.widths.values():
        groups.setdefault((width.size, width.why, width.required_by), []).append(width)
    for widths in groups.values():
        message = width_note([width.name for width in widths], widths[0])
        yield Finding(Location(), message, BUS_REMEDY, severity="warning")


def _lacks_store(flat: FlatBlock) -> bool:
    """Return True for an access to a data store that is not found."""
    return flat.type in ("DataStoreRead", "DataStoreWrite") and flat.data_store is None


def _output_remedy(system: System, otherwise: str) -> str:
    inner = [block.path for block in system.every() if block.system is not None]
    return f"Import a subsystem: {join_names(inner, _MAX_LISTED)}." if inner else otherwise


def _refusal(compiler: BlockCompiler, flat: FlatBlock) -> tuple[str, str]:
    """Return reason and remedy for a block of an unsupported type."""
    kind = BLOCK_TYPES.get(flat.type)
    if kind is None:
        return unsupported_reason(flat)
    try:
        kind.rule(compiler.block_context(flat))
    except UnsupportedError as unsupported:
        return unsupported.message, unsupported.remedy
    return unsupported_reason(flat)


def _block_of(key: str) -> str:
    """Return the block path of a bind key, without the output number."""
    path, colon, number = key.rpartition(":")
    return path if colon and number.isdecimal() else key


def _insert_formula(compiler: LoweringPass, graph: Graph) -> Signal:
    """Insert the graph of a bound formula into the model's graph."""
    builder, nodes = compiler.builder, list[int]()
    # states first: nodes read them, and their next values are nodes
    states = {which: builder.state(state.latency) for which, state in enumerate(graph.states)}
    for op, args, payload in graph.nodes:
        nodes.append(states[payload] if op == "state" else builder.node(op, tuple(nodes[a] for a in args), payload))
    for which, state in enumerate(graph.states):
        builder.close(states[which], nodes[state.init], nodes[state.next])
    for name in graph.inputs:
        compiler.inputs.setdefault(name, None)
    return Signal(np.array([nodes[graph.names["value"]]], dtype=np.int64))
