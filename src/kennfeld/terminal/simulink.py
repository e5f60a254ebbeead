"""Sentences and tables on a Simulink model or data dictionary."""

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from kennfeld.base.formatting import count_noun, join_names, number_text, shorten, size_text
from kennfeld.importers.simulink.import_report import ImportReport
from kennfeld.importers.simulink.outline import ModelOutline
from kennfeld.importers.simulink.variables.data_dictionary import Dictionary
from kennfeld.models.quantities import CalibratableParameter

Rows = list[Sequence[str]]


class NamedPort(Protocol):
    """An input or output of a model."""

    @property
    def name(self) -> str: ...
    @property
    def unit(self) -> str: ...


MAX_REMARKS = 20  # on one import
MAX_PATHS = 3  # of blocks in a cell
_SECTIONS = "To define them in a project file, replace nan with values in:"


def model_summary(outline: ModelOutline) -> str:
    """Return a sentence on the kind, release, size and solver of a model."""
    release = outline.version if outline.version.startswith("R") else f"version {outline.version}"
    total = sum(outline.blocks.values())
    solver = f", solver {_solver(outline)}" if outline.kind == "model" else ""
    return f"{outline.file}: Simulink {outline.kind} ({release}), {count_noun(total, 'block')}{solver}"


def _solver(outline: ModelOutline) -> str:
    solver = outline.solver
    if solver.reference:
        return f"of the configuration {solver.reference}, which is stored elsewhere"
    step = f" with step {solver.fixed_step}" if solver.fixed_step else ""
    return f"{solver.name or 'not stated'}{step}, from {solver.start or '0'} to {solver.stop or '?'}"


def model_tables(outline: ModelOutline) -> list[Rows]:
    """Return inputs, outputs, subsystems, block types, charts, functions, links and data sources."""
    subsystems = (
        (s.path, s.kind, ", ".join(s.inputs), ", ".join(s.outputs), str(s.blocks)) for s in outline.subsystems
    )
    return [
        *port_tables(outline),
        [("subsystem", "", "inputs", "outputs", "blocks"), *subsystems],
        [("block type", "count"), *((kind or "?", str(count)) for kind, count in outline.blocks.items())],
        [("chart", "kind", "states", "transitions"), *(tuple(map(str, chart)) for chart in outline.charts)],
        [("MATLAB function", "lines"), *((path, str(lines)) for path, lines in outline.functions)],
        [
            ("refers to", "type", "times", "from"),
            *((c.source, " ".join(c.type.split()), str(c.count), c.found) for c in outline.connections),
        ],
        [("data from", "name", "content"), *((s.kind, s.name, s.content) for s in outline.sources)],
    ]


class Interface(Protocol):
    """The inputs and outputs of a model."""

    @property
    def inputs(self) -> Sequence[NamedPort]: ...
    @property
    def outputs(self) -> Sequence[NamedPort]: ...


def port_tables(interface: Interface) -> list[Rows]:
    """Return inputs and outputs; those of an import have the names that a project uses."""
    return [
        [("input", "unit"), *((port.name, port.unit) for port in interface.inputs)],
        [("output", "unit"), *((port.name, port.unit) for port in interface.outputs)],
    ]


def model_notes(outline: ModelOutline) -> list[str]:
    """Return the problems of files that the model refers to, and what was skipped."""
    return [*map(str, outline.problems), *map(str, outline.warnings)]


def import_tables(report: ImportReport) -> list[Rows]:
    """Return parameters, unsupported blocks, variables without a value, and subsystems that can be imported."""
    undefined = ((name, str(len(paths)), join_names(paths, MAX_PATHS)) for name, paths in report.undefined.items())
    unsupported: Rows = [("not supported", "type", "why", "remedy", "stops an output")]
    for blocks in report.groups:
        first = blocks[0]
        paths = join_names([block.path for block in blocks], 1)
        unsupported.append((paths, first.type, first.why, first.finding.remedy, "yes" if first.stops else "no"))
    subsystems = ((s.path, str(s.blocks), ", ".join(s.inputs), ", ".join(s.outputs)) for s in report.subsystems)
    return [
        parameter_rows(report.parameters),
        unsupported,
        [("variable without a value", "blocks", "needed by"), *undefined],
        [("can be imported by itself", "blocks", "inputs", "outputs"), *subsystems],
    ]


def parameter_rows(parameters: Sequence[CalibratableParameter]) -> Rows:
    """Return a row for each parameter of an imported model."""
    rows: Rows = [("parameter", "kind", "size", "value", "unit", "limits", "value from")]
    for p in parameters:
        value = _range_text(p.smallest, p.largest)
        source = f"{p.source}, locked" if p.locked else p.source
        rows.append((p.name, p.kind, size_text(p.shape), value, p.unit, _limits(p.lower, p.upper), source))
    return rows


def _range_text(smallest: float, largest: float) -> str:
    return f"{smallest:.6g}" + (f" to {largest:.6g}" if largest != smallest else "")


def _limits(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return ""
    if upper is None:
        return f"from {number_text(lower)}"
    return f"up to {number_text(upper)}" if lower is None else f"{number_text(lower)} to {number_text(upper)}"


def import_notes(report: ImportReport) -> list[str]:
    """Return how much of the model can be calibrated, and what behaves differently than in Simulink."""
    coverage = "all outputs can be calibrated" if report.whole else "not all outputs can be calibrated"
    step = "the step of the data" if report.step is None else f"a step of {number_text(report.step)} s"
    unreached = f", {len(report.unreached)} not reached behind others" if report.unreached else ""
    advice = "Define the variables with --parameters: scripts (.m), .mat, .sldd or calibration files."
    return [
        f"{report.supported} of {count_noun(report.total, 'block')} supported{unreached}; {coverage}",
        *map(str, report.stopped),
        *(f"algebraic loop: {' -> '.join(loop[:10])}" for loop in report.loops),
        *([advice] if report.undefined else []),
        f"runs with {step}",
        *report.substitutions,
        *report.fixed,
        *shorten([str(remark) for remark in report.remarks], MAX_REMARKS, " remarks; --json lists them"),
        *([f"{_SECTIONS}\n\n{report.project_sections}"] if report.definitions else []),
    ]


def dictionary_summary(dictionary: Dictionary) -> str:
    """Return a sentence on the size and references of a data dictionary."""
    references = f", refers to {', '.join(dictionary.references)}" if dictionary.references else ""
    size = count_noun(len(dictionary.data.entries), "variable")
    return f"{dictionary.path.name}: Simulink data dictionary, {size}{references}"


def dictionary_table(dictionary: Dictionary) -> Rows:
    """Return a row for each variable."""
    rows: Rows = [("variable", "class", "size", "value", "unit", "limits", "description")]
    for name, e in dictionary.data.entries.items():
        size = size_text(e.value.shape) if isinstance(e.value, np.ndarray) else ""
        rows.append((name, e.kind, size, _value_text(e.value), e.unit, _limits(e.minimum, e.maximum), e.description))
    return rows


def _value_text(value: object) -> str:
    """Return the range of the finite numbers of an array, or a text."""
    if isinstance(value, str):
        return value
    if not isinstance(value, np.ndarray):
        return ""
    finite = value[np.isfinite(value)]
    return _range_text(float(finite.min()), float(finite.max())) if finite.size else ""
