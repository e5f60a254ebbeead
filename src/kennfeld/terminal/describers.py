"""Contents of each kind of file: as tables for a person, and as JSON for a program."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from kennfeld import calfiles, measurement
from kennfeld.errors import InputError
from kennfeld.graph.events import events
from kennfeld.models import Model
from kennfeld.models.simulink.outline import summarize_model
from kennfeld.models.simulink.variables.data_dictionary import read_dictionary
from kennfeld.preprocessing.recipe import DatasetEntry
from kennfeld.project import Project
from kennfeld.project.checks import describe_events
from kennfeld.surrogate.surrogate_file import read_surrogate
from kennfeld.surrogate.surrogate_models import DynamicSurrogate
from kennfeld.terminal.output import aligned, number_text, size_text
from kennfeld.terminal.result_lines import describe_surrogate, quality_table, ranges_table
from kennfeld.terminal.simulink import (
    dictionary_json,
    dictionary_summary,
    dictionary_table,
    import_notes,
    import_tables,
    interface_tables,
    model_notes,
    model_summary,
    model_tables,
)

Table = Sequence[Sequence[str]]  # the heading first

PARAMETER_KINDS = ("scalar", "curve", "map", "cube", "cube")  # by number of axes; more are those of an expansion


@dataclass(frozen=True)
class FileInfo:
    """Contents of a file: a sentence and tables for a person, `as_json` for a program."""

    summary: str
    tables: Sequence[Table]
    notes: Sequence[str]
    as_json: Mapping[str, Any]

    def lines(self) -> list[str]:
        """Return the text for a person."""
        blocks = [[self.summary], *(aligned(table) for table in self.tables if len(table) > 1), list(self.notes)]
        return [line for i, block in enumerate(filter(None, blocks)) for line in (*([""] if i else []), *block)]


class SimulinkSelection(NamedTuple):
    """Part of a Simulink model to import: subsystem, files with values, folders of libraries, replaced blocks."""

    subsystem: str = ""
    parameters: Sequence[str | Path] = ()
    folders: Sequence[str | Path] = ()
    bind: Mapping[str, str] = MappingProxyType({})


WHOLE = SimulinkSelection()


def describe_measurement(description: measurement.Description) -> FileInfo:
    """Describe a recording: its channels, time and skipped columns."""
    several = len(description.tables) > 1
    tables = [_channel_rows(table, several) for table in description.tables]
    notes = [note for table in description.tables for note in _recording_notes(table, description.file, several)]
    size = " and ".join(f"{len(table.channels)} channels over {table.samples} samples" for table in description.tables)
    summary = f"{description.file}: measurement ({description.kind}), {size}"
    return FileInfo(summary, tables, notes, {"content": "measurement", **_plain(description.as_dict())})


def _channel_rows(table: measurement.TableDescription, several: bool) -> Table:
    group = f" in {table.name}" if several and table.name else ""
    rows: list[Sequence[str]] = [(f"channel{group}", "unit", "rate", "samples", "missing", "minimum", "maximum")]
    for c in table.channels:
        extrema = number_text(c.minimum), number_text(c.maximum)
        rows.append((c.name, c.unit, _rate(c.rate), str(c.samples), f"{c.nan_share:.1%}", *extrema))
    if not any(row[2] for row in rows[1:]):  # points without time
        rows = [(*row[:2], *row[3:]) for row in rows]
    return _with_columns(rows, {"description": [c.description for c in table.channels]})


def _with_columns(rows: Sequence[Sequence[str]], columns: Mapping[str, Sequence[str]]) -> list[Sequence[str]]:
    """Append the columns that are not empty throughout, by heading."""
    for heading, cells in columns.items():
        if any(cells):
            rows = [(*row, cell) for row, cell in zip(rows, [heading, *cells], strict=True)]
    return list(rows)


def _recording_notes(table: measurement.TableDescription, file: str, several: bool) -> list[str]:
    notes = []
    if table.details:
        notes.append(f"{table.name or file}: {', '.join(f'{k} {v}' for k, v in table.details.items())}")
    if table.time:
        group = f"{table.name}: " if several and table.name else ""
        step = "" if table.time.step is None else f", a sample every {table.time.step:g} s"
        notes.append(f"{group}time from {table.time.begin:g} s to {table.time.end:g} s{step}")
    notes += [f"{remark.severity}: {remark}" for remark in table.remarks]
    if table.left_out:
        notes.append(f"columns without numbers: {', '.join(table.left_out)}")
    return notes


def describe_calibration(file: calfiles.CalibrationFile) -> FileInfo:
    """Describe a calibration file: its parameters, group axes and texts."""
    rows: list[Sequence[str]] = [("parameter", "kind", "size", "unit", "minimum", "maximum", "description")]
    rows += [
        (*(p.name, p.kind, size_text(p.shape), p.unit), number_text(p.minimum), number_text(p.maximum), p.description)
        for p in file.parameters
    ]
    functions = [", ".join(p.functions) for p in file.parameters]
    variants = [", ".join(variant or "(none)" for variant in p.variants) for p in file.parameters]
    rows = _with_columns(rows, {"functions": functions, "variants": variants})
    axes = [("group axis", "size", "unit", "begin", "end")]
    axes += [
        (a.name, str(len(a)), a.unit, number_text(a.breakpoints[0]), number_text(a.breakpoints[-1])) for a in file.axes
    ]
    texts = [
        ("text", "kind", "unit", "content"),
        *((text.name, text.kind, text.unit, text.text) for text in file.texts),
    ]
    values = sum(math.prod(p.shape) for p in file.parameters)
    remarks = [str(remark) for remark in file.remarks]
    as_json = {
        "content": "calibration",
        "file": file.path.name,
        "kind": file.kind,
        "parameters": [asdict(p) for p in file.parameters],
        "axes": [
            {"name": a.name, "input": a.input, "unit": a.unit, "breakpoints": a.breakpoints.tolist()} for a in file.axes
        ],
        "texts": [asdict(text) for text in file.texts],
        "remarks": remarks,
    }
    summary = f"{file.path.name}: calibration ({file.kind}), {len(file.parameters)} parameters, {values} values"
    return FileInfo(summary, [rows, axes, texts], remarks, _plain(as_json))


def describe_a2l(file: calfiles.A2lFile) -> FileInfo:
    """Describe an A2L file: its labels."""
    a2l, labels = file.a2l, file.labels
    rows = [("label", "kind", "size", "unit", "lower", "upper", "address", "function", "description")]
    for label in labels:
        limits = number_text(label.lower), number_text(label.upper)
        place = f"0x{label.address:X}", ", ".join(label.functions)
        rows.append((label.name, label.kind, size_text(label.shape), label.unit, *limits, *place, label.description))
    counts = {"labels": len(a2l.characteristics), "group axes": len(a2l.axis_pts), "measurements": a2l.measurements}
    counted = ", ".join(f"{count} {thing}" for thing, count in counts.items())
    version = f"ASAP2 {a2l.version}" if a2l.version else "ASAP2"
    remarks = [str(remark) for remark in file.remarks]
    as_json = {
        "content": "a2l",
        "file": file.path.name,
        "version": a2l.version,
        "project": a2l.project,
        "module": a2l.module,
        "program": a2l.epk,
        "measurements": a2l.measurements,
        "functions": [{"name": f.name, "description": f.description} for f in a2l.functions.values()],
        "labels": [asdict(label) for label in labels],
        "remarks": remarks,
    }
    summary = f"{file.path.name}: A2L description ({version}{a2l.project and f', project {a2l.project}'}), {counted}"
    return FileInfo(summary, [rows], remarks, _plain(as_json))


def describe_surrogate_file(path: Path) -> FileInfo:
    """Describe a surrogate: its quality and the ranges of its training data."""
    surrogate = read_surrogate(path)
    ranges = ranges_table(surrogate)
    as_json = {
        "content": "surrogate",
        "file": path.name,
        "name": surrogate.name,
        "inputs": list(surrogate.inputs),
        "output": surrogate.output,
        "centres": surrogate.expansion.size,
        "quality": [asdict(line) for line in surrogate.quality],
    }
    notes = []
    if isinstance(surrogate, DynamicSurrogate):
        as_json |= {name: getattr(surrogate, name) for name in ("step", "lags", "output_lags", "stability")}
        notes = [surrogate.stability] if surrogate.stability else []
    as_json["ranges"] = {name: [float(lowest), float(highest)] for name, _, lowest, highest in ranges[1:]}
    summary = f"{path.name}: a surrogate, {describe_surrogate(surrogate)}"
    return FileInfo(summary, [quality_table(surrogate), ranges], notes, _plain(as_json))


def describe_training(path: Path) -> FileInfo:
    """Describe a training file: its datasets and the surrogate to train."""
    from kennfeld.project.surrogate_training import read_training  # which loads all that training needs

    training = read_training(path)
    settings = training.settings
    as_json = {
        "content": "training file",
        "file": path.name,
        "name": settings.name,
        "kind": settings.kind,
        "inputs": list(settings.inputs),
        "output": settings.output,
        "target": training.target.name,
        "datasets": _dataset_json(training.data.datasets),
    }
    summary = f"{path.name}: training file of the {settings.kind} surrogate {training.formula}"
    return FileInfo(summary, [_dataset_rows(training.data.datasets)], [f"written to {training.target.name}"], as_json)


def _dataset_rows(datasets: Sequence[DatasetEntry]) -> Table:
    return [("dataset", "use", "files"), *((d.name, d.use, ", ".join(d.files)) for d in datasets)]


def _dataset_json(datasets: Sequence[DatasetEntry]) -> list[dict[str, Any]]:
    return [{"name": d.name, "use": d.use, "files": list(d.files)} for d in datasets]


def describe_formula(path: Path, model: Model) -> FileInfo:
    """Describe formula text: its inputs, parameters and nodes."""
    graph = model.graph
    outputs, units = set(graph.outputs), graph.units
    nodes = [("node", "unit", "")]
    nodes += [(name, units.get(name, ""), "output" if name in outputs else "") for name in graph.names]
    inputs = [("input", "unit"), *((name, units.get(name, "")) for name in graph.inputs)]
    kinds = {
        name: PARAMETER_KINDS[axes] if axes < len(PARAMETER_KINDS) else "rbf" for name, axes in graph.parameters.items()
    }
    kinds |= {surrogate.name: "surrogate" for surrogate in model.surrogates}
    jumps = events(graph, tuple(graph.parameters))
    notes = [f"{surrogate.name}.json: {describe_surrogate(surrogate)}" for surrogate in model.surrogates]
    if jumps:
        advice = 'Derivatives do not account for that; method = "global" does.'
        notes.append(f"{describe_events(jumps)} depending on parameters. {advice}")
    as_json = {
        "content": "formula",
        "file": path.name,
        "step": model.step,
        "states": len(graph.states),
        "events": [{"node": event.name, "kind": event.word, "parameters": list(event.parameters)} for event in jumps],
        "inputs": [{"name": name, "unit": units.get(name, "")} for name in graph.inputs],
        "parameters": [{"name": name, "kind": kind} for name, kind in kinds.items()],
        "surrogates": [surrogate.name for surrogate in model.surrogates],
        "nodes": [{"name": name, "unit": units.get(name, ""), "output": name in outputs} for name in graph.names],
    }
    states = f", {len(graph.states)} states" if graph.states else ""
    summary = f"{path.name}: formula, {len(graph.names)} nodes{states}"
    return FileInfo(summary, [inputs, [("parameter", "kind"), *kinds.items()], nodes], notes, as_json)


def describe_simulink(path: Path, part: SimulinkSelection) -> FileInfo:
    """Describe a Simulink model: its interface, and what can be calibrated and what prevents it."""
    outline = summarize_model(path, part.folders)
    as_json = {"content": "Simulink model", **outline.as_dict()}
    tables, notes = model_tables(outline), model_notes(outline)
    if outline.kind != "library":
        from kennfeld.models.simulink.importable_subsystems import inspect_simulink  # all block types

        try:
            report = inspect_simulink(path, part.subsystem or None, part.parameters, part.folders, part.bind)
        except InputError as error:
            if any(part):  # the selection does not fit
                raise
            notes = [*notes, *(str(finding) for finding in error.findings)]
        else:
            interface = [*interface_tables(report), *tables[2:]] if report.whole or part.subsystem else tables
            tables = [*interface, *import_tables(report)]
            notes = list(dict.fromkeys([*notes, *import_notes(report)]))
            as_json |= {"import": asdict(report) | {"whole": report.whole}}
    return FileInfo(model_summary(outline), tables, notes, _plain(as_json))


def describe_dictionary(path: Path) -> FileInfo:
    """Describe a Simulink data dictionary: its variables."""
    dictionary = read_dictionary(path, follow=False)
    notes = [f"{name} is not readable: {why}" for name, why in dictionary.data.unreadable.items()]
    tables = [dictionary_table(dictionary)]
    return FileInfo(dictionary_summary(dictionary), tables, notes, _plain(dictionary_json(dictionary)))


def describe_project(path: Path) -> FileInfo:
    """Describe a project file: its datasets, criteria and parameters with settings."""
    project = Project.read(path)
    file = project.file
    criteria = [("criterion", "target"), *((c.node, c.target.name or f"{c.target.value:g}") for c in file.criteria)]
    parameters = [("parameter with settings",), *((name,) for name in file.parameters)]
    as_json = {
        "content": "project",
        "file": path.name,
        "name": project.name,
        "model": file.model.file,
        "initial": list(file.calibration.initial),
        "surrogates": dict(file.surrogates),
        "output": list(project.formats),
        "datasets": _dataset_json(file.datasets),
        "criteria": [{"node": node, "target": target} for node, target in criteria[1:]],
        "parameters": list(file.parameters),
    }
    notes = [f"start: {', '.join(file.calibration.initial)}"] if file.calibration.initial else []
    notes += [f"surrogate {name}: {surrogate}" for name, surrogate in file.surrogates.items()]
    summary = f"{path.name}: project {project.name}, function {file.model.file}"
    return FileInfo(summary, [_dataset_rows(file.datasets), criteria, parameters], notes, as_json)


def _rate(rate: float | None) -> str:
    """Return a sampling rate as text.

    >>> _rate(100.0), _rate(0.2), _rate(None)
    ('100 Hz', 'every 5 s', '')
    """
    if rate is None:
        return ""
    return f"{rate:.4g} Hz" if rate >= 0.999 else f"every {1 / rate:.4g} s"


def _plain(value: Any) -> Any:
    """Return containers and numbers that JSON can hold; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
