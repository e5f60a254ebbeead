"""Description of a Simulink model, a data dictionary, or an enumeration class."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from kennfeld.base.formatting import count_noun, number_text, size_text
from kennfeld.files.file_info import DescribedFile, FileInfo, Table, json_entry, plain
from kennfeld.importers.simulink.import_report import SimulinkReport
from kennfeld.importers.simulink.importer import IMPORTER
from kennfeld.importers.simulink.outline import ModelOutline, summarize_model
from kennfeld.importers.simulink.variables.data_dictionary import Dictionary, read_dictionary
from kennfeld.importers.simulink.variables.stored_variables import StoredVariable
from kennfeld.matlab.enumerations import Enumeration, enumeration_of
from kennfeld.models.import_report import describe_import, limits_text, port_tables, range_text


def describe_simulink(file: DescribedFile) -> FileInfo:
    """Describe a Simulink model: its interface, and what can be calibrated and what prevents it."""
    options = file.options
    outline = summarize_model(file.path, options.folders)
    as_json = {"content": "Simulink model", **plain(outline.as_dict())}
    info = FileInfo(_summary(outline), _tables(outline), [*map(str, (*outline.problems, *outline.warnings))], as_json)
    if outline.kind == "library":
        return info

    def inspect() -> SimulinkReport:
        from kennfeld.importers.simulink.importable_subsystems import inspect_simulink  # all block types

        part = options.subsystem or None
        found = options.parameters, options.folders
        return inspect_simulink(file.path, part, *found, bind=dict(options.bind), step=options.step)

    return describe_import(info, inspect, chosen=options.chosen(IMPORTER.keys), is_part=bool(options.subsystem))


def _summary(outline: ModelOutline) -> str:
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


def _tables(outline: ModelOutline) -> list[Table]:
    """Return inputs, outputs, subsystems, block types, charts, functions, links and data sources."""
    subsystems = (
        (s.path, s.kind, ", ".join(s.inputs), ", ".join(s.outputs), str(s.blocks)) for s in outline.subsystems
    )
    return [
        *port_tables(outline.inputs, outline.outputs),
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


def describe_dictionary(file: DescribedFile) -> FileInfo:
    """Describe a Simulink data dictionary: its variables."""
    dictionary = read_dictionary(file.path, follow=False)
    notes = [f"{name} is not readable: {why}" for name, why in dictionary.data.unreadable.items()]
    as_json = json_entry(
        "data dictionary",
        dictionary.path,
        references=dictionary.references,
        variables=[_describe_variable(name, entry) for name, entry in dictionary.data.entries.items()],
        unreadable=dictionary.data.unreadable,
        types=list(dictionary.types),
    )
    return FileInfo(_dictionary_summary(dictionary), [_dictionary_table(dictionary)], notes, as_json)


def _describe_variable(name: str, entry: StoredVariable) -> dict[str, Any]:
    attributes = {key: getattr(entry, key) for key in ("unit", "minimum", "maximum", "type", "description")}
    size = entry.value.shape if isinstance(entry.value, np.ndarray) else None
    return {"name": name, "class": entry.kind, "size": size, **attributes}


def _dictionary_summary(dictionary: Dictionary) -> str:
    """Return a sentence on the size and references of a data dictionary."""
    references = f", refers to {', '.join(dictionary.references)}" if dictionary.references else ""
    size = count_noun(len(dictionary.data.entries), "variable")
    return f"{dictionary.path.name}: Simulink data dictionary, {size}{references}"


def _dictionary_table(dictionary: Dictionary) -> Table:
    """Return a row for each variable."""
    rows: list[Sequence[str]] = [("variable", "class", "size", "value", "unit", "limits", "description")]
    for name, e in dictionary.data.entries.items():
        size = size_text(e.value.shape) if isinstance(e.value, np.ndarray) else ""
        rows.append(
            (name, e.kind, size, _value_text(e.value), e.unit, limits_text(e.minimum, e.maximum), e.description)
        )
    return rows


def _value_text(value: object) -> str:
    """Return the range of the finite numbers of an array, or a text."""
    if isinstance(value, str):
        return value
    if not isinstance(value, np.ndarray):
        return ""
    finite = value[np.isfinite(value)]
    return range_text(float(finite.min()), float(finite.max())) if finite.size else ""


def describe_enumeration(file: DescribedFile) -> FileInfo:
    """Describe the class file of an enumeration of MATLAB: its members."""
    path = file.path
    enumeration = enumeration_of(path.read_text(encoding="utf-8", errors="replace")) or Enumeration("", {})
    name, members = enumeration.name, enumeration.members
    rows = [(f"{name}.{member}", number_text(number)) for member, number in members.items()]
    note = "A model finds the class if this file is next to it, in folders or in parameters."
    if name != path.stem:
        note = f"warning: the file must be called {name}.m; models do not find the class by this name"
    as_json = json_entry("enumeration", path, name=name, members=members)
    summary = f"{path.name}: enumeration class of MATLAB, {count_noun(len(rows), 'member')}"
    return FileInfo(summary, [[("member", "value"), *rows]], [note], as_json)
