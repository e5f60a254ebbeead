"""Calibration files: what they hold, how two sets of values differ, and what is taken or written from them."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

from kennfeld.app.answer import Answer, Given, finite, finite_list
from kennfeld.app.folders import confined, writable
from kennfeld.app.session.calibration_source import (
    ValueSource,
    calibration_files,
    is_image,
    part_of,
    source_of,
)
from kennfeld.app.session.edited_values import fit_onto
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding
from kennfeld.base.output_paths import plain_name
from kennfeld.calfiles import Change, Difference, Tolerance, compare, endings, losses, merge, read, write
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Axis, Parameter, Text

Item = Parameter | Text | Axis

MAX_ROWS = 5000  # labels that are listed
MAX_REMARKS = 50


def calibrations(session: Session, given: Given) -> Answer:
    """Return the calibration files of the folder, the A2L files among them, and the endings that can be written."""
    files = calibration_files(session.path.parent)
    plain = [{"name": name, "format": kind, "image": is_image(name)} for name, kind in files if kind != "A2L"]
    settings = session.settings.get("calibration", {})
    initial = settings.get("initial", []) if isinstance(settings, dict) else []
    return Answer(
        {
            "files": plain,
            "descriptions": [name for name, kind in files if kind == "A2L"],
            "endings": list(endings()),
            "initial": initial if isinstance(initial, list) else [initial],
        }
    )


def contents(session: Session, given: Given) -> Answer:
    """Return what a set of values holds: `source` is one of `source_of`, or an A2L file, which has labels alone."""
    if str(given["source"].get("file", "")).lower().endswith(".a2l"):
        return _labels(confined(session.path.parent, given["source"]["file"]))
    source = source_of(session, given["source"])
    rows = [_content(item) for item in _items(source)]
    return Answer(
        {"label": source.label, "rows": rows[:MAX_ROWS], "count": len(rows), "findings": _texts(source.findings)}
    )


def _labels(path: Path) -> Answer:
    """Return the labels of an A2L file with their limits."""
    from kennfeld.calfiles import describe_a2l

    description = describe_a2l(path)
    rows = [
        {
            "name": label.name,
            "kind": label.kind,
            "size": " x ".join(map(str, label.shape)),
            "unit": label.unit,
            "description": label.description,
            "function": ", ".join(label.functions),
            "text": "",
            "least": finite(label.lower),
            "greatest": finite(label.upper),
        }
        for label in description.labels
    ]
    findings = _texts(description.findings)
    return Answer({"label": path.name, "rows": rows[:MAX_ROWS], "count": len(rows), "findings": findings})


def _content(item: Item) -> dict[str, Any]:
    side = _side(item)
    known = [value for value in side["values"] if value is not None]
    ends = {"least": min(known, default=None), "greatest": max(known, default=None)}
    size = " x ".join(str(len(axis["points"])) for axis in side["axes"])
    row = {key: side[key] for key in ("kind", "unit", "description", "text", "function")}
    return {"name": item.name, "size": size, **row, **ends}


def differences(session: Session, given: Given) -> Answer:
    """Return the differences between the sets `first` and `second`, a row for each name.

    `tolerance` and `relative` are the largest differences that count as equal.
    """
    first, second = (source_of(session, given[side]) for side in ("first", "second"))
    allowed = Tolerance(float(given.get("tolerance") or 0.0), float(given.get("relative") or 0.0))
    comparison = compare(first.parameters, second.parameters, allowed)
    by_name: dict[str, list[Difference]] = {}
    for difference in comparison.differences:
        by_name.setdefault(difference.name, []).append(difference)
    own = session.view.now.parameters if session.view is not None else ParameterSet()
    rows = [_row(name, each, first, second, own) for name, each in by_name.items()]
    return Answer(
        {
            "labels": [first.label, second.label],
            "rows": rows[:MAX_ROWS],
            "count": len(rows),
            "compared": comparison.compared,
            "findings": _texts((*first.findings, *second.findings)),
        }
    )


def _row(
    name: str, own: Sequence[Difference], first: ValueSource, second: ValueSource, present: ParameterSet
) -> dict[str, Any]:
    label = _label(name, first, second)
    item = _item(second, label) or _item(first, label)
    presence = next((difference for difference in own if difference.aspect == "presence"), None)
    numbers = [difference for difference in own if difference.largest is not None]
    largest = next((difference for difference in numbers if difference.aspect == "values"), None)
    return {
        "name": name,
        "label": label,
        "kind": "" if item is None else _kind(item),
        "unit": getattr(item, "unit", ""),
        "function": own[0].function,
        "only": "" if presence is None else "first" if presence.left else "second",
        "largest": None if largest is None or largest.largest is None else finite(largest.largest),
        "differ": 0 if largest is None else largest.count,
        "total": 0 if largest is None else largest.total,
        "place": "" if largest is None else largest.place,
        "aspects": [{"aspect": d.aspect, "first": d.left, "second": d.right, "place": d.place} for d in own],
        "takeable": label in present and isinstance(_item(second, label), Parameter),
    }


def _label(name: str, first: ValueSource, second: ValueSource) -> str:
    """Return the name of a label without the variant that a difference adds to it."""
    if _item(first, name) is None and _item(second, name) is None:
        return name.rpartition(" (")[0] or name
    return name


def _item(source: ValueSource, name: str) -> Item | None:
    return next((item for item in _items(source) if item.name == name), None)


def _items(source: ValueSource) -> list[Item]:
    return [*source.parameters.parameters, *source.parameters.texts, *source.parameters.axes]


def _kind(item: Item) -> str:
    return "group axis" if isinstance(item, Axis) else item.kind


def pair(session: Session, given: Given) -> Answer:
    """Return the label `name` in both sets, with its axes; None for a set without it."""
    sides = (source_of(session, given[side]) for side in ("first", "second"))
    items = [_item(source, given["name"]) for source in sides]
    first, second = (None if item is None else _side(item) for item in items)
    return Answer({"name": given["name"], "first": first, "second": second})


def _side(item: Item) -> dict[str, Any]:
    if isinstance(item, Text):
        return _of(item, item.kind, [], [], item.text)
    if isinstance(item, Axis):
        index = {"input": "number", "unit": "", "points": list(range(1, len(item) + 1))}
        return _of(item, "group axis", [index], finite_list(item.breakpoints), "")
    axes = [
        {"input": axis.input or axis.name, "unit": axis.unit, "points": axis.breakpoints.tolist()}
        for axis in item.index_axes
    ]
    return _of(item, item.kind, axes, finite_list(item.values), "")


def _of(item: Any, kind: str, axes: list[Any], values: list[float | None], text: str) -> dict[str, Any]:
    functions = getattr(item, "functions", ())
    return {
        "kind": kind,
        "unit": item.unit,
        "description": getattr(item, "description", ""),
        "function": functions[0] if functions else "",
        "axes": axes,
        "values": values,
        "text": text,
    }


def take_values(session: Session, given: Given) -> Answer:
    """Take the values of the labels `names` of the set `source` into the project; undo takes them back.

    Tables with other axes are interpolated onto those of the project.
    """
    source, own = source_of(session, given["source"]), session.parameters
    tables: dict[str, Float | None] = {}
    remarks = []
    for name in given["names"]:
        if name not in source.parameters or name not in own:
            raise ArgumentError(f"{str(name)[:100]} is not a parameter of both the project and {source.label}")
        other = source.parameters[name]
        tables[name] = fit_onto(own[name], other).values
        if [a.breakpoints.tolist() for a in own[name].axes] != [a.breakpoints.tolist() for a in other.axes]:
            remarks.append(f"{name}: interpolated onto the axes of the project")
    if not tables:
        raise ArgumentError("no parameter is chosen")
    session.do(SetTables(f"Took {', '.join(list(tables)[:3])} from {source.label}", tables))
    return Answer({"taken": len(tables), "findings": remarks})


def write_calibration(session: Session, given: Given) -> Answer:
    """Write a set of values as the file `target` of the folder; its ending selects the format.

    With `second`, the labels `names` of that set replace those of `first`. `image` and its `a2l` are the image whose
    copy gets the values. A file that exists is replaced only with `force`; without it, the answer has its name as
    `exists`.
    """
    first, folder = source_of(session, given["first"]), session.path.parent
    target = writable(folder, plain_name(str(given["target"])))
    if target.suffix.lower() not in endings():
        raise ArgumentError(f"unknown format {target.suffix!r}; known are {', '.join(endings())}")
    if target.exists() and not given.get("force"):
        return Answer({"exists": target.name})
    parameters, changes = first.parameters, tuple[Change, ...]()
    if given.get("second"):
        second = source_of(session, given["second"])
        own = second.parameters if given.get("names") is None else part_of(second.parameters, set(given["names"]))
        merged = merge([(first.label, first.parameters), (second.label, own)])
        parameters, changes = merged.parameters, merged.changes
    image, a2l = (confined(folder, str(given[key])) if given.get(key) else None for key in ("image", "a2l"))
    findings = [*write(parameters, target, image, a2l), *losses(parameters, target)]
    rows = rounded(parameters, target, a2l or first.a2l)
    return Answer(
        {
            "file": target.name,
            "changes": [_change_row(change) for change in changes],
            "findings": _texts(findings),
            "rounded": rows,
        }
    )


def _change_row(change: Change) -> dict[str, str]:
    details = "; ".join(f"{each.aspect} {each.left} -> {each.right}"[:120] for each in change.differences)
    return {"name": change.name, "action": "replaced" if change.replaces else "added", "details": details}


def rounded(parameters: ParameterSet, target: Path, a2l: Path | None) -> list[dict[str, Any]]:
    """Return the labels whose values an image does not store exactly: asked for, stored, and how many differ."""
    if not is_image(target.name):
        return []
    stored = read(target, a2l)
    both = [name for name in parameters if name in stored]
    comparison = compare(parameters.select(both), stored.select(both))
    return [
        {
            "name": each.name,
            "differ": each.count,
            "total": each.total,
            "largest": finite(each.largest if each.largest is not None else math.nan),
            "place": each.place,
            "asked": each.left,
            "stored": each.right,
        }
        for each in comparison.differences
        if each.largest is not None
    ]


def _texts(findings: Iterable[Finding]) -> list[str]:
    texts = list(map(str, findings))
    more = len(texts) - MAX_REMARKS
    return [*texts[:MAX_REMARKS], *([f"{more} more remarks"] if more > 0 else [])]
