"""What is in a file of any kind: as tables for a person, and as JSON for a program."""

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Any, NamedTuple

from kennfeld import calfiles, measurement
from kennfeld.calfiles.cdfx.reader import recognises_cdfx
from kennfeld.calfiles.dcm.lines import recognises_dcm
from kennfeld.calfiles.excel.layout import is_calibration_workbook
from kennfeld.calfiles.flash.description import recognises_a2l, recognises_flash
from kennfeld.calfiles.format import CalibrationSource
from kennfeld.calfiles.matlab_reader import is_calibration_mat, recognises_mat, recognises_script
from kennfeld.calfiles.msq.reader import recognises_msq
from kennfeld.calfiles.unsupported_files import foreign_calibration
from kennfeld.errors import InputError
from kennfeld.graph.events import events
from kennfeld.measurement.file_kind import FileKind, kind_of
from kennfeld.models import Model
from kennfeld.models import formula as formulas
from kennfeld.models.simulink.outline import summarize_model
from kennfeld.models.simulink.reader.document import recognises_simulink
from kennfeld.models.simulink.variables.data_dictionary import read_dictionary
from kennfeld.project import Project
from kennfeld.project.checks import listed
from kennfeld.project.toml_file import is_training, read_toml
from kennfeld.surrogate import DynamicSurrogate, read_surrogate, recognises_surrogate
from kennfeld.terminal.output import aligned
from kennfeld.terminal.result_lines import described, quality_table, ranges_table
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

__all__ = ["FileInfo", "SimulinkSelection", "Table", "contents"]

Table = Sequence[Sequence[str]]  # the heading first

_SECTION = re.compile(
    r"^[ \t]*\[{1,2}(model|surrogate|dataset|calibration|criterion|optimizer|parameters\.\S+)\]", re.MULTILINE
)
_LINE_OF_FORMULA = re.compile(
    r"\s*(?:(?:\d+\s+)?(?:[A-Za-z_]\w*|%[^%]+%)\s*(?:\[[^\]]*\])?\s*=[^=]"
    r"|(?:input|output|scalar|curve|map|cube|rbf|step|def)\s+\S)"
)
_CALIBRATIONS = (FileKind.DCM, FileKind.CVX, FileKind.JSON)
_HEAD = 65536
_LARGEST_CALIBRATION = 100_000_000  # bytes of a data file of MATLAB that is looked into


@dataclass(frozen=True)
class FileInfo:
    """A file: what it is, in a sentence and in tables; `as_json` says the same to programs."""

    summary: str
    tables: Sequence[Table]
    notes: Sequence[str]
    as_json: Mapping[str, Any]

    def lines(self) -> list[str]:
        """The text that a person reads."""
        blocks = [[self.summary], *(aligned(table) for table in self.tables if len(table) > 1), list(self.notes)]
        return [line for i, block in enumerate(filter(None, blocks)) for line in (*([""] if i else []), *block)]


class SimulinkSelection(NamedTuple):
    """What to look at of a Simulink model: a subsystem, with values for variables, folders of libraries, cut blocks."""

    subsystem: str = ""
    parameters: Sequence[str | Path] = ()
    folders: Sequence[str | Path] = ()
    bind: Mapping[str, str] = MappingProxyType({})


WHOLE = SimulinkSelection()


def contents(path: str | Path, a2l: str | Path | None = None, part: SimulinkSelection = WHOLE) -> FileInfo:
    """What is in a measurement, calibration, A2L, formula, Simulink, project or training file, told by its content.

    `a2l` describes the labels of an image; by default the A2L file beside it. `part` is for Simulink models.

    Raises `InputError` where there is no such file, or it can be read as none of these.
    """
    file = Path(path)
    if not file.is_file():  # a folder, a missing file, or a sheet behind a #
        return _measurement(measurement.describe(path))
    if file.suffix.lower() == ".sldd":
        return _dictionary(file)
    if file.suffix.lower() in (".slx", ".mdl"):  # a damaged one too
        return _simulink(file, part)
    kind, head = _sniffed(file)
    if kind is FileKind.MODEL or recognises_simulink(head.encode()):
        return _simulink(file, part)
    if file.suffix.lower() == ".toml" or (kind is FileKind.CSV and _SECTION.search(head)):
        return _training(file) if is_training(read_toml(file)) else _project(file)
    if recognises_surrogate(head):
        return _surrogate(file)
    if file.suffix.lower() == ".kf":
        return _formula(file, formulas.read(file, surrogates=formulas.surrogates_beside(file)))
    if recognises_flash(CalibrationSource(file.name, head.encode())):
        return _calibration(calfiles.describe(file, a2l))
    if recognises_a2l(head):
        return _a2l(calfiles.describe_a2l(file))
    if _is_calibration(file, kind, head):
        return _calibration(calfiles.describe(file))
    if kind is FileKind.CSV and _LINE_OF_FORMULA.match(_first_line(head)):
        text, beside = formulas.text_of(file), formulas.surrogates_beside(file)
        return _formula(file, formulas.formula(text, file.name, surrogates=beside))
    try:
        return _measurement(measurement.describe(path))
    except InputError:
        reason = foreign_calibration(file)
        if reason is None:
            raise
    raise InputError([reason])


def _is_calibration(file: Path, kind: FileKind, head: str) -> bool:
    if kind is FileKind.EXCEL:
        return is_calibration_workbook(CalibrationSource(file.name, file.read_bytes(), file))
    if kind in (FileKind.MATLAB, FileKind.HDF5, FileKind.OTHER) and file.stat().st_size < _LARGEST_CALIBRATION:
        source = CalibrationSource(file.name, file.read_bytes(), file)
        return recognises_mat(source) and is_calibration_mat(source)
    if recognises_msq(head) or (kind is FileKind.CSV and recognises_script(head)):
        return True
    return kind in _CALIBRATIONS or recognises_cdfx(head) or (kind is FileKind.CSV and recognises_dcm(head))


def _sniffed(file: Path) -> tuple[FileKind, str]:
    try:
        with file.open("rb") as stream:
            head = stream.read(_HEAD)
        return kind_of(file)[0], head.decode("utf-8", errors="replace").replace("\r\n", "\n")
    except OSError as error:
        raise InputError.of(str(file), f"cannot be read: {error.strerror or error}") from None


def _first_line(text: str) -> str:
    """The first line that is not empty and no comment."""
    lines = (line.removeprefix("\ufeff").strip() for line in text.split("\n"))
    return next((line for line in lines if line and not line.startswith("#")), "")


def _measurement(found: measurement.Description) -> FileInfo:
    tables, notes = [], []
    for table in found.tables:
        several = f" in {table.name}" if len(found.tables) > 1 and table.name else ""
        rows: list[Sequence[str]] = [
            (f"channel{several}", "unit", "rate", "samples", "missing", "minimum", "maximum"),
            *(
                (
                    *(c.name, c.unit, _rate(c.rate), str(c.samples), f"{c.nan_share:.1%}"),
                    *(_number(c.minimum), _number(c.maximum)),
                )
                for c in table.channels
            ),
        ]
        if not any(row[2] for row in rows[1:]):  # points without time
            rows = [(*row[:2], *row[3:]) for row in rows]
        said = [c.description for c in table.channels]
        if any(said):
            rows = [(*row, more) for row, more in zip(rows, ["description", *said], strict=True)]
        tables.append(rows)
        if table.details:
            notes.append(f"{table.name or found.file}: {', '.join(f'{k} {v}' for k, v in table.details.items())}")
        if table.time:
            step = "" if table.time.step is None else f", a sample every {table.time.step:g} s"
            notes.append(
                f"{table.name + ': ' if several else ''}time from {table.time.begin:g} s to {table.time.end:g} s{step}"
            )
        notes += [f"{remark.severity}: {remark}" for remark in table.remarks]
        if table.left_out:
            notes.append(f"columns without numbers: {', '.join(table.left_out)}")
    size = " and ".join(f"{len(table.channels)} channels over {table.samples} samples" for table in found.tables)
    summary = f"{found.file}: measurement ({found.kind}), {size}"
    return FileInfo(summary, tables, notes, {"content": "measurement", **_plain(found.as_dict())})


def _calibration(found: calfiles.CalibrationFile) -> FileInfo:
    rows: list[Sequence[str]] = [("parameter", "kind", "size", "unit", "minimum", "maximum", "description")]
    rows += [
        (p.name, p.kind, " x ".join(map(str, p.shape)), p.unit, _number(p.minimum), _number(p.maximum), p.description)
        for p in found.parameters
    ]
    for heading, cells in (
        ("functions", [", ".join(p.functions) for p in found.parameters]),
        ("variants", [", ".join(variant or "(none)" for variant in p.variants) for p in found.parameters]),
    ):
        if any(cells):
            rows = [(*row, cell) for row, cell in zip(rows, [heading, *cells], strict=True)]
    axes = [("group axis", "size", "unit", "begin", "end")]
    axes += [(a.name, str(len(a)), a.unit, _number(a.breakpoints[0]), _number(a.breakpoints[-1])) for a in found.axes]
    texts = [
        ("text", "kind", "unit", "content"),
        *((text.name, text.kind, text.unit, text.text) for text in found.texts),
    ]
    values = sum(math.prod(p.shape) for p in found.parameters)
    summary = f"{found.path.name}: calibration ({found.kind}), {len(found.parameters)} parameters, {values} values"
    as_json = {
        "content": "calibration",
        "file": found.path.name,
        "kind": found.kind,
        "parameters": [asdict(p) for p in found.parameters],
        "axes": [
            {"name": a.name, "input": a.input, "unit": a.unit, "breakpoints": a.breakpoints.tolist()}
            for a in found.axes
        ],
        "texts": [asdict(text) for text in found.texts],
        "remarks": [str(remark) for remark in found.remarks],
    }
    return FileInfo(summary, [rows, axes, texts], [str(remark) for remark in found.remarks], _plain(as_json))


def _a2l(found: calfiles.A2lFile) -> FileInfo:
    a2l, labels = found.a2l, found.labels
    rows = [("label", "kind", "size", "unit", "lower", "upper", "address", "function", "description")]
    rows += [
        (
            one.name,
            one.kind,
            " x ".join(map(str, one.shape)),
            one.unit,
            _number(one.lower),
            _number(one.upper),
            f"0x{one.address:X}",
            ", ".join(one.functions),
            one.description,
        )
        for one in labels
    ]
    counts = {"labels": len(a2l.characteristics), "group axes": len(a2l.axis_pts), "measurements": a2l.measurements}
    counted = ", ".join(f"{count} {thing}" for thing, count in counts.items())
    version = f"ASAP2 {a2l.version}" if a2l.version else "ASAP2"
    as_json = {
        "content": "a2l",
        "file": found.path.name,
        "version": a2l.version,
        "project": a2l.project,
        "module": a2l.module,
        "program": a2l.epk,
        "measurements": a2l.measurements,
        "functions": [{"name": one.name, "description": one.description} for one in a2l.functions.values()],
        "labels": [asdict(one) for one in labels],
        "remarks": [str(remark) for remark in found.remarks],
    }
    summary = f"{found.path.name}: A2L description ({version}{a2l.project and f', project {a2l.project}'}), {counted}"
    return FileInfo(summary, [rows], [str(remark) for remark in found.remarks], _plain(as_json))


def _surrogate(file: Path) -> FileInfo:
    made = read_surrogate(file)
    as_json = {
        "content": "surrogate",
        "file": file.name,
        "name": made.name,
        "inputs": list(made.inputs),
        "output": made.output,
        "centres": made.expansion.size,
        "quality": [asdict(line) for line in made.quality],
    }
    if isinstance(made, DynamicSurrogate):
        as_json |= {"step": made.step, "lags": made.lags, "output_lags": made.output_lags, "stability": made.stability}
    notes = [made.stability] if isinstance(made, DynamicSurrogate) and made.stability else []
    ranges = ranges_table(made)
    as_json["ranges"] = {name: [float(least), float(most)] for name, _, least, most in ranges[1:]}
    tables = [quality_table(made), ranges]
    return FileInfo(f"{file.name}: a surrogate, {described(made)}", tables, notes, _plain(as_json))


def _training(file: Path) -> FileInfo:
    from kennfeld.project.surrogate_training import read_training  # which loads all that training needs

    training = read_training(file)
    settings, given = training.settings, training.data.datasets
    datasets = [("dataset", "use", "files"), *((d.name, d.use, ", ".join(d.files)) for d in given)]
    as_json = {
        "content": "training file",
        "file": file.name,
        "name": settings.name,
        "kind": settings.kind,
        "inputs": list(settings.inputs),
        "output": settings.output,
        "target": training.target.name,
        "datasets": [{"name": d.name, "use": d.use, "files": list(d.files)} for d in given],
    }
    called = f"{settings.output} = {settings.name}({', '.join(settings.inputs)})"
    summary = f"{file.name}: training file of the {settings.kind} surrogate {called}"
    return FileInfo(summary, [datasets], [f"written to {training.target.name}"], as_json)


def _formula(file: Path, model: Model) -> FileInfo:
    graph = model.graph
    outputs = set(graph.outputs)
    nodes = [("node", "unit", "")]
    nodes += [(name, graph.units.get(name, ""), "output" if name in outputs else "") for name in graph.names]
    inputs = [("input", "unit"), *((name, graph.units.get(name, "")) for name in graph.inputs)]
    words = ("scalar", "curve", "map", "cube", "cube")
    kinds = {name: words[axes] if axes < len(words) else "rbf" for name, axes in graph.parameters.items()}
    kinds |= {surrogate.name: "surrogate" for surrogate in model.surrogates}
    parameters = [("parameter", "kind"), *kinds.items()]
    memory = f", {len(graph.states)} states" if graph.states else ""
    found = events(graph, tuple(graph.parameters))
    notes = [f"{surrogate.name}.json: {described(surrogate)}" for surrogate in model.surrogates]
    if found:
        notes.append(f'{listed(found)} when parameters decide: derivatives do not see that, method = "global" does.')
    as_json = {
        "content": "formula",
        "file": file.name,
        "step": model.step,
        "states": len(graph.states),
        "events": [{"node": event.name, "kind": event.word, "parameters": list(event.parameters)} for event in found],
        "inputs": [{"name": name, "unit": graph.units.get(name, "")} for name in graph.inputs],
        "parameters": [{"name": name, "kind": kind} for name, kind in kinds.items()],
        "surrogates": [surrogate.name for surrogate in model.surrogates],
        "nodes": [{"name": name, "unit": graph.units.get(name, ""), "output": name in outputs} for name in graph.names],
    }
    summary = f"{file.name}: formula, {len(graph.names)} nodes{memory}"
    return FileInfo(summary, [inputs, parameters, nodes], notes, as_json)


def _simulink(file: Path, part: SimulinkSelection) -> FileInfo:
    found = summarize_model(file, part.folders)
    as_json = {"content": "Simulink model", **found.as_dict()}
    tables, notes = model_tables(found), model_notes(found)
    if found.kind != "library":
        from kennfeld.models.simulink.importable_subsystems import inspect_simulink  # all block types

        try:
            report = inspect_simulink(file, part.subsystem or None, part.parameters, part.folders, part.bind)
        except InputError as error:
            if any(part):  # what was asked for does not fit
                raise
            notes = [*notes, *(str(finding) for finding in error.findings)]
        else:
            seen = [*interface_tables(report), *tables[2:]] if report.whole or part.subsystem else tables
            tables = [*seen, *import_tables(report)]
            notes = list(dict.fromkeys([*notes, *import_notes(report)]))
            as_json |= {"import": asdict(report) | {"whole": report.whole}}
    return FileInfo(model_summary(found), tables, notes, _plain(as_json))


def _dictionary(file: Path) -> FileInfo:
    found = read_dictionary(file, follow=False)
    notes = [f"{name} is not readable: {why}" for name, why in found.data.unreadable.items()]
    return FileInfo(dictionary_summary(found), [dictionary_table(found)], notes, _plain(dictionary_json(found)))


def _project(file: Path) -> FileInfo:
    project = Project.read(file)
    given = project.file
    datasets = [("dataset", "use", "files"), *((d.name, d.use, ", ".join(d.files)) for d in given.datasets)]
    criteria = [("criterion", "target"), *((c.node, c.target.name or f"{c.target.value:g}") for c in given.criteria)]
    parameters = [("parameter with settings",), *((name,) for name in given.parameters)]
    as_json = {
        "content": "project",
        "file": file.name,
        "name": project.name,
        "model": given.model.file,
        "initial": list(given.calibration.initial),
        "surrogates": dict(given.surrogates),
        "output": list(project.formats),
        "datasets": [{"name": d.name, "use": d.use, "files": list(d.files)} for d in given.datasets],
        "criteria": [{"node": row[0], "target": row[1]} for row in criteria[1:]],
        "parameters": list(given.parameters),
    }
    notes = [f"start: {', '.join(given.calibration.initial)}"] if given.calibration.initial else []
    notes += [f"surrogate {name}: {path}" for name, path in given.surrogates.items()]
    summary = f"{file.name}: project {project.name}, function {given.model.file}"
    return FileInfo(summary, [datasets, criteria, parameters], notes, as_json)


def _rate(rate: float | None) -> str:
    """How often a channel is sampled: 100 Hz, or every 5 s.

    >>> _rate(100.0), _rate(0.2), _rate(None)
    ('100 Hz', 'every 5 s', '')
    """
    if rate is None:
        return ""
    return f"{rate:.4g} Hz" if rate >= 0.999 else f"every {1 / rate:.4g} s"


def _number(value: float | None) -> str:
    return "" if value is None or math.isnan(value) else f"{value:.6g}"


def _plain(value: Any) -> Any:
    """Containers and numbers that JSON can hold; what is not finite becomes null."""
    if isinstance(value, Mapping):
        return {key: _plain(inner) for key, inner in value.items()}
    if isinstance(value, list | tuple):
        return [_plain(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
