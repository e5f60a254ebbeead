"""Contents of each kind of file: as tables for a person, and as JSON for a program.

What only one kind needs is imported inside its function.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from kennfeld import calfiles, measurement
from kennfeld.base.errors import InputError
from kennfeld.base.formatting import count_noun, join_names, number_text, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.files.calibrations import AMD
from kennfeld.files.identification import identify
from kennfeld.graph.events import events
from kennfeld.models import Model
from kennfeld.terminal.model_selection import WHOLE, ModelSelection
from kennfeld.terminal.output import align, separate

if TYPE_CHECKING:
    from kennfeld.importers.simulink.variables.stored_variables import StoredVariable
    from kennfeld.preprocessing.recipe import DatasetEntry

Table = Sequence[Sequence[str]]  # the heading first

_MOST_GROUPS = 6  # of a recording that its summary counts
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
        blocks = [[self.summary], *(align(table) for table in self.tables if len(table) > 1), self.notes]
        return separate(filter(None, blocks))


@dataclass(frozen=True)
class DescribedFile:
    """A file to describe, and what the command line says about it."""

    path: Path
    a2l: str | Path | None = None
    selection: ModelSelection = WHOLE
    dbc: Sequence[str] = ()


def describe_recording(described: DescribedFile) -> FileInfo:
    """Describe a recording: its channels, time and skipped columns."""
    description = measurement.describe(described.path, described.dbc)
    groups, file = description.tables, description.file
    several = len(groups) > 1
    notes = [note for group in groups for note in _time_notes(group, file, several)]
    notes += [note for group in groups for note in _content_notes(group)]
    sizes = [
        f"{count_noun(len(group.channels), 'channel')} over {count_noun(group.samples, 'sample')}" for group in groups
    ]
    size = join_names(sizes, _MOST_GROUPS, " and ")
    return FileInfo(
        f"{file}: measurement ({description.kind}), {size}",
        [_channel_rows(group, several) for group in groups],
        notes,
        {"content": "measurement", **_plain(description.as_dict())},
    )


def _channel_rows(table: measurement.TableDescription, several: bool) -> Table:
    group = f" in {table.name}" if several and table.name else ""
    rows = [(f"channel{group}", "unit", "rate", "samples", "missing", "minimum", "maximum", "description")]
    for c in table.channels:
        extrema = number_text(c.minimum), number_text(c.maximum)
        rows.append((c.name, c.unit, _rate(c.rate), str(c.samples), f"{c.nan_share:.1%}", *extrema, c.description))
    return _without_empty(rows, "rate", "description")  # points without time have no rate


def _without_empty(rows: Sequence[Sequence[str]], *optional: str) -> Table:
    """Leave out the optional columns that are empty throughout."""
    used = [i for i, heading in enumerate(rows[0]) if heading not in optional or any(row[i] for row in rows[1:])]
    return [[row[i] for i in used] for row in rows]


def _time_notes(table: measurement.TableDescription, file: str, several: bool) -> list[str]:
    notes = []
    if table.details:
        notes.append(f"{table.name or file}: {', '.join(f'{k} {v}' for k, v in table.details.items())}")
    if table.time:
        group = f"{table.name}: " if several and table.name else ""
        step = "" if table.time.step is None else f", a sample every {table.time.step:g} s"
        notes.append(f"{group}time from {table.time.begin:g} s to {table.time.end:g} s{step}")
    return notes


def _content_notes(table: measurement.TableDescription) -> list[str]:
    notes = [f"{finding.severity}: {finding}" for finding in table.findings]
    if table.left_out:
        notes.append(f"columns without numbers: {', '.join(table.left_out)}")
    return notes


def describe_calibration(described: DescribedFile) -> FileInfo:
    """Describe a calibration file: its parameters, group axes and texts."""
    file = calfiles.describe(described.path, described.a2l)
    head = ("parameter", "kind", "size", "unit", "minimum", "maximum", "description", "functions", "variants")
    rows = [
        (
            *(p.name, p.kind, size_text(p.shape), p.unit, number_text(p.minimum), number_text(p.maximum)),
            *(p.description, ", ".join(p.functions), ", ".join(variant or "(none)" for variant in p.variants)),
        )
        for p in file.parameters
    ]
    axes = [
        (a.name, str(len(a)), a.unit, *map(number_text, a.breakpoints[[0, -1]]), "falling" if a.falling else "")
        for a in file.axes
    ]
    tables = [
        _without_empty([head, *rows], "functions", "variants"),
        _without_empty([("group axis", "size", "unit", "begin", "end", "order"), *axes], "order"),
        [("text", "kind", "unit", "content"), *((t.name, t.kind, t.unit, t.text) for t in file.texts)],
    ]
    values = sum(math.prod(p.shape) for p in file.parameters)
    remarks = list(map(str, file.findings))
    as_json = _json(
        "calibration",
        file.path,
        kind=file.kind,
        parameters=list(map(asdict, file.parameters)),
        axes=[_select(axis, "name", "input", "unit", "breakpoints", "falling") for axis in file.axes],
        texts=list(map(asdict, file.texts)),
        remarks=remarks,
    )
    summary = f"{file.path.name}: calibration ({file.kind}), {len(file.parameters)} parameters, {values} values"
    return FileInfo(summary, tables, remarks, as_json)


def describe_a2l_file(described: DescribedFile) -> FileInfo:
    """Describe an A2L file: its labels."""
    file = calfiles.describe_a2l(described.path)
    a2l, labels = file.a2l, file.labels
    rows = [("label", "kind", "size", "unit", "lower", "upper", "address", "function", "description")]
    rows += [
        (
            *(label.name, label.kind, size_text(label.shape), label.unit, number_text(label.lower)),
            *(number_text(label.upper), f"0x{label.address:X}", ", ".join(label.functions), label.description),
        )
        for label in labels
    ]
    counts = f"{len(a2l.characteristics)} labels, {len(a2l.axis_pts)} group axes, {a2l.measurements} measurements"
    version = f"ASAP2 {a2l.version}".strip()
    remarks = list(map(str, file.findings))
    as_json = _json(
        "a2l",
        file.path,
        **_select(a2l, "version", "project", "module"),
        program=a2l.epk,
        measurements=a2l.measurements,
        functions=[_select(function, "name", "description") for function in a2l.functions.values()],
        labels=list(map(asdict, labels)),
        remarks=remarks,
    )
    summary = f"{file.path.name}: A2L description ({version}{a2l.project and f', project {a2l.project}'}), {counts}"
    return FileInfo(summary, [rows], remarks, as_json)


def describe_surrogate_file(file: DescribedFile) -> FileInfo:
    """Describe a surrogate: its quality and the ranges of its training data."""
    path = file.path
    from kennfeld.surrogate.filtered_surrogate import FilteredSurrogate
    from kennfeld.surrogate.surrogate_file import least_deviation, read_surrogate, surrogate_notes
    from kennfeld.surrogate.surrogate_models import DynamicSurrogate
    from kennfeld.terminal.surrogate_lines import describe_surrogate, quality_table, ranges_table

    surrogate = read_surrogate(path)
    ranges = ranges_table(surrogate)
    further: tuple[str, ...] = ()
    if isinstance(surrogate, DynamicSurrogate):
        further = "step", "lags", "output_lags", "stability", "limits"
    elif isinstance(surrogate, FilteredSurrogate):
        further = "step", "delay", "time_constants", "stability", "limits"
    as_json = _json(
        "surrogate",
        path,
        **_select(surrogate, "name", "inputs", "output"),
        centres=surrogate.expansion.size,
        quality=list(map(asdict, surrogate.quality)),
        **_select(surrogate, *further),
        noise=least_deviation(surrogate),
        kernel=surrogate.expansion.kernel,
        kinks=len(surrogate.expansion.hinges),
        remarks=list(surrogate.remarks),
        ranges={name: [float(lowest), float(highest)] for name, _, lowest, highest in ranges[1:]},
    )
    summary = f"{path.name}: a surrogate, {describe_surrogate(surrogate)}"
    return FileInfo(summary, [quality_table(surrogate), ranges], surrogate_notes(surrogate), as_json)


def describe_toml(file: DescribedFile) -> FileInfo:
    """Describe a project file or a training file."""
    from kennfeld.project.toml_file import is_training, read_toml

    return (_describe_training if is_training(read_toml(file.path)) else _describe_project)(file.path)


def _describe_training(path: Path) -> FileInfo:
    """Describe a training file: its datasets and the surrogate to train."""
    from kennfeld.project.surrogate_training import read_training  # which loads all that training needs

    training = read_training(path)
    settings = training.settings
    as_json = _json(
        "training file",
        path,
        **_select(settings, "name", "kind", "inputs", "output"),
        target=training.target.name,
        datasets=[_select(entry, "name", "use", "files") for entry in training.data.datasets],
    )
    summary = f"{path.name}: training file of the {settings.kind} surrogate {training.formula}"
    return FileInfo(summary, [_dataset_rows(training.data.datasets)], [f"written to {training.target.name}"], as_json)


def _dataset_rows(datasets: Sequence["DatasetEntry"]) -> Table:
    return [("dataset", "use", "files"), *((d.name, d.use, ", ".join(d.files)) for d in datasets)]


def describe_formula_file(file: DescribedFile) -> FileInfo:
    """Describe formula text: its inputs, parameters and nodes."""
    from kennfeld.models import formula as formulas

    path, surrogates = file.path, formulas.surrogates_beside(file.path)
    if path.suffix.lower() == ".kf":
        return _describe_formula(path, formulas.read(path, surrogates=surrogates))
    return _describe_formula(path, formulas.formula(formulas.text_of(path), path.name, surrogates=surrogates))


def _describe_formula(path: Path, model: Model) -> FileInfo:
    graph = model.graph
    outputs, units = set(graph.outputs), graph.units
    nodes = [(name, units.get(name, ""), "output" if name in outputs else "") for name in graph.names]
    inputs = [(name, units.get(name, "")) for name in graph.inputs]
    kinds = {
        name: PARAMETER_KINDS[axes] if axes < len(PARAMETER_KINDS) else "rbf" for name, axes in graph.parameters.items()
    }
    kinds |= {surrogate.name: "surrogate" for surrogate in model.surrogates} | dict.fromkeys(graph.layers, "layer")
    jumps = events(graph, tuple(graph.parameters))
    notes = _surrogate_notes(model)
    if jumps:
        from kennfeld.optimize.strategies.jumps import describe_events

        advice = 'Derivatives do not account for that; method = "global" does.'
        notes.append(f"{describe_events(jumps)} depending on parameters. {advice}")
    as_json = _json(
        "formula",
        path,
        step=model.step,
        solver=model.solver,
        states=len(graph.states),
        events=[{"node": event.name, "kind": event.word, "parameters": event.parameters} for event in jumps],
        inputs=[{"name": name, "unit": unit} for name, unit in inputs],
        parameters=[{"name": name, "kind": kind} for name, kind in kinds.items()],
        surrogates=[surrogate.name for surrogate in model.surrogates],
        nodes=[{"name": name, "unit": unit, "output": output != ""} for name, unit, output in nodes],
    )
    states = f", {len(graph.states)} states" if graph.states else ""
    tables: list[Table] = [
        [("input", "unit"), *inputs],
        [("parameter", "kind"), *kinds.items()],
        [("node", "unit", ""), *nodes],
    ]
    return FileInfo(f"{path.name}: formula, {len(nodes)} nodes{states}", tables, notes, as_json)


def _surrogate_notes(model: Model) -> list[str]:
    if not model.surrogates:
        return []
    from kennfeld.terminal.surrogate_lines import describe_surrogate

    return [f"{surrogate.name}.json: {describe_surrogate(surrogate)}" for surrogate in model.surrogates]


def describe_simulink(file: DescribedFile) -> FileInfo:
    """Describe a Simulink model: its interface, and what can be calibrated and what prevents it."""
    path, part = file.path, file.selection.simulink
    from kennfeld.importers.simulink.outline import summarize_model
    from kennfeld.terminal import simulink

    outline = summarize_model(path, part.folders)
    as_json = {"content": "Simulink model", **outline.as_dict()}
    tables, notes = simulink.model_tables(outline), simulink.model_notes(outline)
    if outline.kind != "library":
        from kennfeld.importers.simulink.importable_subsystems import inspect_simulink  # all block types

        try:
            report = inspect_simulink(path, part.subsystem or None, *part[1:])
        except InputError as error:
            if any(part):  # the selection does not fit
                raise
            notes += map(str, error.findings)
        else:
            if report.whole or part.subsystem:
                tables[:2] = simulink.port_tables(report)
            tables += simulink.import_tables(report)
            notes = list(dict.fromkeys([*simulink.import_notes(report), *notes]))
            as_json |= {"import": report.as_dict()}
    return FileInfo(simulink.model_summary(outline), tables, notes, _plain(as_json))


def describe_esdl(file: DescribedFile) -> FileInfo:
    """Describe a class or an application of an ASCET project: what can be calibrated and what prevents it."""
    path, part = file.path, file.selection.esdl
    from kennfeld.importers.ascet.importing import classes_of, import_esdl
    from kennfeld.terminal import esdl

    is_application = path.suffix.lower() == ".app"
    classes = () if is_application else classes_of(path)
    tables = [] if is_application else [esdl.class_table(classes)]
    plural = "" if len(classes) == 1 else "es"
    language = "6 components" if identify(path).format is AMD else "ESDL"
    kind = "application" if is_application else f"{language}, {len(classes)} class{plural}"
    as_json: dict[str, Any] = {"content": "ASCET model", "classes": [item.name for item in classes]}
    notes: list[str] = []
    if classes or is_application:
        try:
            result = import_esdl(
                path, part.class_name, part.methods, task=part.tasks, folders=part.folders, step=part.step
            )
            report = result.report
        except InputError as error:
            if any(part):  # the selection does not fit
                raise
            notes += map(str, error.findings)
        else:
            tables += esdl.import_tables(report)
            notes += esdl.import_notes(report)
            as_json |= {"import": report.as_dict()}
    return FileInfo(f"{path.name}: ASCET {kind}", tables, notes, _plain(as_json))


def describe_components(file: DescribedFile) -> FileInfo:
    """Describe ASCET 5 or 6 components: their methods, their values, and one of them as a model if it is selected."""
    if file.path.name.lower().endswith(".data.amd") and not any(file.selection.esdl):
        return describe_calibration(file)
    from kennfeld.importers.ascet.component_tree import is_archive

    model = describe_esdl(file)
    if not is_archive(file.path) or "import" in model.as_json:
        return model
    values = describe_calibration(file)
    remedy = "name one by --class, and its methods by --method, to see it as a model"
    return FileInfo(values.summary, [*model.tables, *values.tables], [*values.notes, remedy], values.as_json)


def describe_dictionary(file: DescribedFile) -> FileInfo:
    """Describe a Simulink data dictionary: its variables."""
    from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
    from kennfeld.terminal import simulink

    dictionary = read_dictionary(file.path, follow=False)
    notes = [f"{name} is not readable: {why}" for name, why in dictionary.data.unreadable.items()]
    as_json = _json(
        "data dictionary",
        dictionary.path,
        references=dictionary.references,
        variables=[_describe_variable(name, entry) for name, entry in dictionary.data.entries.items()],
        unreadable=dictionary.data.unreadable,
        types=list(dictionary.types),
    )
    return FileInfo(simulink.dictionary_summary(dictionary), [simulink.dictionary_table(dictionary)], notes, as_json)


def describe_enumeration(file: DescribedFile) -> FileInfo:
    """Describe the class file of an enumeration of MATLAB: its members."""
    path = file.path
    from kennfeld.importers.simulink.variables.enumerations import enumeration_of

    name, members = enumeration_of(path.read_text(encoding="utf-8", errors="replace")) or ("", {})
    rows = [(f"{name}.{member}", number_text(number)) for member, number in members.items()]
    note = "A model finds the class if this file is next to it, in folders or in parameters."
    if name != path.stem:
        note = f"warning: the file must be called {name}.m; models do not find the class by this name"
    as_json = _json("enumeration", path, name=name, members=members)
    summary = f"{path.name}: enumeration class of MATLAB, {count_noun(len(rows), 'member')}"
    return FileInfo(summary, [[("member", "value"), *rows]], [note], as_json)


def _describe_variable(name: str, entry: "StoredVariable") -> dict[str, Any]:
    size = entry.value.shape if isinstance(entry.value, np.ndarray) else None
    attributes = _select(entry, "unit", "minimum", "maximum", "type", "description")
    return {"name": name, "class": entry.kind, "size": size, **attributes}


def _describe_project(path: Path) -> FileInfo:
    """Describe a project file: its datasets, criteria and parameters with settings."""
    from kennfeld.project import Project

    project = Project.read(path)
    file = project.file
    criteria = [(c.node, c.target.name or f"{c.target.value:g}") for c in file.criteria]
    as_json = _json(
        "project",
        path,
        name=project.name,
        model=file.model.file,
        initial=file.calibration.files,
        surrogates=file.surrogates,
        output=project.formats,
        datasets=[_select(entry, "name", "use", "files") for entry in file.datasets],
        criteria=[{"node": node, "target": target} for node, target in criteria],
        parameters=list(file.parameters),
    )
    notes = [f"start: {', '.join(file.calibration.files)}"] if file.calibration.files else []
    notes += [f"surrogate {name}: {surrogate}" for name, surrogate in file.surrogates.items()]
    tables: list[Table] = [
        _dataset_rows(file.datasets),
        [("criterion", "target"), *criteria],
        [("parameter with settings",), *((name,) for name in file.parameters)],
    ]
    return FileInfo(f"{path.name}: project {project.name}, function {file.model.file}", tables, notes, as_json)


def _rate(rate: float | None) -> str:
    """Return a sampling rate as text.

    >>> _rate(100.0), _rate(0.2), _rate(None)
    ('100 Hz', 'every 5 s', '')
    """
    if rate is None:
        return ""
    return f"{rate:.4g} Hz" if rate >= 0.999 else f"every {1 / rate:.4g} s"


def _json(content: str, path: Path, **entries: Any) -> dict[str, Any]:
    return {"content": content, "file": path.name, **_plain(entries)}


def _select(item: object, *names: str) -> dict[str, Any]:
    return {name: getattr(item, name) for name in names}


def _plain(value: Any) -> Any:
    """Return containers and numbers that JSON can hold; NaN and infinity become null."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    if isinstance(value, np.ndarray):
        return _plain(value.tolist())
    return None if isinstance(value, float) and not math.isfinite(value) else value
