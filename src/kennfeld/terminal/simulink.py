"""A Simulink model or data dictionary in sentences and tables."""

from collections.abc import Mapping, Sequence

import numpy as np

from kennfeld.models.simulink.import_report import ImportReport
from kennfeld.models.simulink.outline import ModelOutline
from kennfeld.models.simulink.variables.data_dictionary import Dictionary
from kennfeld.models.simulink.variables.stored_variables import StoredVariable

__all__ = [
    "dictionary_json",
    "dictionary_summary",
    "dictionary_table",
    "import_notes",
    "import_tables",
    "interface_tables",
    "model_notes",
    "model_summary",
    "model_tables",
]

Rows = list[Sequence[str]]
_MOST_REMARKS = 20  # on one import


def model_summary(found: ModelOutline) -> str:
    """The sentence on top: what it is, of which release, how large."""
    release = found.version if found.version.startswith("R") else f"version {found.version}"
    total = sum(found.blocks.values())
    solver = f", solver {_solver(found)}" if found.kind == "model" else ""
    return f"{found.file}: Simulink {found.kind} ({release}), {_counted(total, 'block')}{solver}"


def _solver(found: ModelOutline) -> str:
    solver = found.solver
    if solver.reference:
        return f"of the configuration {solver.reference}, which is kept elsewhere"
    step = f" with the step {solver.fixed_step}" if solver.fixed_step else ""
    return f"{solver.name or 'not stated'}{step}, from {solver.start or '0'} to {solver.stop or '?'}"


def _counted(number: int, word: str) -> str:
    return f"{number} {word}" if number == 1 else f"{number} {word}s"


def model_tables(found: ModelOutline) -> list[Rows]:
    """Inputs and outputs, subsystems, blocks by type, charts, functions, links, and where data come from."""
    ports: Rows = [("input", "unit"), *((port.name, port.unit) for port in found.inputs)]
    outputs: Rows = [("output", "unit"), *((port.name, port.unit) for port in found.outputs)]
    inner: Rows = [("subsystem", "", "inputs", "outputs", "blocks")]
    inner += [(s.path, s.kind, ", ".join(s.inputs), ", ".join(s.outputs), str(s.blocks)) for s in found.subsystems]
    blocks: Rows = [("block type", "count"), *((kind or "?", str(count)) for kind, count in found.blocks.items())]
    charts: Rows = [("chart", "kind", "states", "transitions")]
    charts += [(path, kind, str(states), str(moves)) for path, kind, states, moves in found.charts]
    functions: Rows = [("MATLAB function", "lines"), *((path, str(lines)) for path, lines in found.functions)]
    links: Rows = [("refers to", "type", "times", "from")]
    links += [(c.source, " ".join(c.type.split()), str(c.count), c.found) for c in found.connections]
    sources: Rows = [("data from", "name", "content"), *((s.kind, s.name, s.content) for s in found.sources)]
    return [ports, outputs, inner, blocks, charts, functions, links, sources]


def model_notes(found: ModelOutline) -> list[str]:
    """What was wrong with files that the model refers to, and what was left aside."""
    return [*map(str, found.problems), *found.remarks]


def import_tables(report: ImportReport) -> list[Rows]:
    """Where values come from, what has none, what cannot be built, and what can be imported by itself."""
    valueless: Rows = [("variable without a value", "blocks", "needed by")]
    valueless += [(name, str(len(paths)), _listed(paths)) for name, paths in report.undefined.items()]
    missing: Rows = [("not supported", "type", "why", "mend", "stops an output")]
    missing += [
        (_listed([one.path for one in several], 1), one.type, one.why, one.finding.remedy, "yes" if one.stops else "no")
        for several in report.groups
        for one in several[:1]
    ]
    parts: Rows = [("can be imported by itself", "blocks", "inputs", "outputs")]
    parts += [(one.path, str(one.blocks), ", ".join(one.inputs), ", ".join(one.outputs)) for one in report.subsystems]
    return [_parameters(report), valueless, missing, parts]


def interface_tables(report: ImportReport) -> list[Rows]:
    """Inputs and outputs as a project names them, of a part of a model too."""
    inputs: Rows = [("input", "unit"), *((one.name, one.unit) for one in report.inputs)]
    outputs: Rows = [("output", "unit"), *((one.name, one.unit) for one in report.outputs)]
    return [inputs, outputs]


def _parameters(report: ImportReport) -> Rows:
    """A row a parameter: what it is, its value or the range of its values, its limits, and where it comes from."""
    rows: Rows = [("parameter", "kind", "size", "value", "unit", "limits", "value from")]
    for one in report.parameters:
        size = " x ".join(map(str, one.shape))
        value = f"{one.smallest:.6g}" + (f" to {one.largest:.6g}" if one.largest != one.smallest else "")
        where = f"{one.source}, locked" if one.locked else one.source
        rows.append((one.name, one.kind, size, value, one.unit, _limits(one.lower, one.upper), where))
    return rows


def _limits(lower: float | None, upper: float | None) -> str:
    if lower is None and upper is None:
        return ""
    if upper is None:
        return f"from {_number(lower)}"
    return f"up to {_number(upper)}" if lower is None else f"{_number(lower)} to {_number(upper)}"


def _listed(paths: Sequence[str], shown: int = 3) -> str:
    """The first paths, and how many more there are."""
    return ", ".join(paths[:shown]) + (f" and {len(paths) - shown} more" if len(paths) > shown else "")


def import_notes(report: ImportReport) -> list[str]:
    """How much of the model can be calibrated, and what runs in another way than in Simulink."""
    whole = "all outputs can be calibrated" if report.whole else "some outputs cannot be calibrated as it is"
    give = "Give the variables values with --parameters: scripts (.m), .mat, .sldd, calibration files."
    more = len(report.remarks) - _MOST_REMARKS
    loops = [f"algebraic loop: {' -> '.join(loop[:10])}" for loop in report.loops]
    return [
        f"{report.supported} of {_counted(report.total, 'block')} supported; {whole}",
        *map(str, report.stopped),
        *([give] if report.undefined else []),
        *loops,
        *report.substitutions,
        *report.fixed,
        *report.remarks[:_MOST_REMARKS],
        *([f"and {more} more remarks; --json lists them"] if more > 0 else []),
    ]


def dictionary_summary(found: Dictionary) -> str:
    """The sentence on top of a data dictionary."""
    more = f", refers to {', '.join(found.references)}" if found.references else ""
    return f"{found.path.name}: Simulink data dictionary, {_counted(len(found.data.entries), 'variable')}{more}"


def dictionary_table(found: Dictionary) -> Rows:
    """A row a variable."""
    rows: Rows = [("variable", "class", "size", "unit", "minimum", "maximum", "description")]
    rows += [
        (name, e.kind, _size(e), e.unit, _number(e.minimum), _number(e.maximum), e.description)
        for name, e in found.data.entries.items()
    ]
    return rows


def dictionary_json(found: Dictionary) -> Mapping[str, object]:
    """The same for programs."""
    variables = [
        {
            "name": name,
            "class": e.kind,
            "size": list(e.value.shape) if isinstance(e.value, np.ndarray) else None,
            "unit": e.unit,
            "minimum": e.minimum,
            "maximum": e.maximum,
            "type": e.type,
            "description": e.description,
        }
        for name, e in found.data.entries.items()
    ]
    return {
        "content": "data dictionary",
        "file": found.path.name,
        "references": list(found.references),
        "variables": variables,
        "unreadable": dict(found.data.unreadable),
        "types": list(found.types),
    }


def _size(entry: StoredVariable) -> str:
    return " x ".join(map(str, entry.value.shape)) if isinstance(entry.value, np.ndarray) else ""


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.6g}"
