"""Contents of each kind of file: as tables for a person, and as JSON for a program.

What only one kind needs is imported inside its function.
"""

from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

from kennfeld import measurement
from kennfeld.base.formatting import count_noun, join_names, number_text
from kennfeld.files.file_info import DescribedFile, FileInfo, Table, json_entry, plain, without_empty
from kennfeld.graph.events import events
from kennfeld.models import Model
from kennfeld.models.quantities import PARAMETER_KINDS

if TYPE_CHECKING:
    from kennfeld.preprocessing.recipe import DatasetEntry

_MOST_GROUPS = 6  # of a recording that its summary counts


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
        {"content": "measurement", **plain(description.as_dict())},
    )


def _channel_rows(table: measurement.TableDescription, several: bool) -> Table:
    group = f" in {table.name}" if several and table.name else ""
    rows = [(f"channel{group}", "unit", "rate", "samples", "missing", "minimum", "maximum", "description")]
    for c in table.channels:
        extrema = number_text(c.minimum), number_text(c.maximum)
        rows.append((c.name, c.unit, _rate(c.rate), str(c.samples), f"{c.nan_share:.1%}", *extrema, c.description))
    return without_empty(rows, "rate", "description")  # points without time have no rate


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
    as_json = json_entry(
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
    as_json = json_entry(
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
    # formula text with another ending is recognised by its content, which `read` refuses
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
    # in a graph, surrogates and layers are lookups of parameters as well
    kinds |= {surrogate.name: "surrogate" for surrogate in model.surrogates} | dict.fromkeys(graph.layers, "layer")
    jumps = events(graph, tuple(graph.parameters))
    notes = _surrogate_notes(model)
    if jumps:
        from kennfeld.optimize.strategies.jumps import describe_events

        advice = 'Derivatives do not account for that; method = "global" does.'
        notes.append(f"{describe_events(jumps)} depending on parameters. {advice}")
    as_json = json_entry(
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
    states = f", {count_noun(len(graph.states), 'state')}" if graph.states else ""
    tables: list[Table] = [
        [("input", "unit"), *inputs],
        [("parameter", "kind"), *kinds.items()],
        [("node", "unit", ""), *nodes],
    ]
    summary = f"{path.name}: formula, {count_noun(len(nodes), 'node')}{states}"
    return FileInfo(summary, tables, notes, as_json)


def _surrogate_notes(model: Model) -> list[str]:
    if not model.surrogates:
        return []
    from kennfeld.terminal.surrogate_lines import describe_surrogate

    return [f"{surrogate.name}.json: {describe_surrogate(surrogate)}" for surrogate in model.surrogates]


def _describe_project(path: Path) -> FileInfo:
    """Describe a project file: its datasets, criteria and parameters with settings."""
    from kennfeld.project import Project

    project = Project.read(path)
    file = project.file
    criteria = [(c.node, c.target.name or f"{c.target.value:g}") for c in file.criteria]
    as_json = json_entry(
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
    # 1 Hz in spite of rounded time stamps
    return f"{rate:.4g} Hz" if rate >= 0.999 else f"every {1 / rate:.4g} s"


def _select(item: object, *names: str) -> dict[str, Any]:
    return {name: getattr(item, name) for name in names}
