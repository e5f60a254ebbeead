"""Description of a calibration file, and of an A2L file."""

import math
from dataclasses import asdict
from typing import Any

from kennfeld import calfiles
from kennfeld.base.formatting import number_text, size_text
from kennfeld.files.file_info import DescribedFile, FileInfo, json_entry, without_empty


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
        without_empty([head, *rows], "functions", "variants"),
        without_empty([("group axis", "size", "unit", "begin", "end", "order"), *axes], "order"),
        [("text", "kind", "unit", "content"), *((t.name, t.kind, t.unit, t.text) for t in file.texts)],
    ]
    values = sum(math.prod(p.shape) for p in file.parameters)
    remarks = list(map(str, file.findings))
    as_json = json_entry(
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
    as_json = json_entry(
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


def _select(item: object, *names: str) -> dict[str, Any]:
    return {name: getattr(item, name) for name in names}
