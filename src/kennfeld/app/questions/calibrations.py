"""Calibration files: what they hold, how two sets of values differ, and what is taken or written from them."""

import math
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Literal

from kennfeld.app.answer import finite, finite_list
from kennfeld.app.folders import confined, writable
from kennfeld.app.questions.existing_files import ExistingFile
from kennfeld.app.questions.parameters import AxisPoints, describe_axes
from kennfeld.app.session.calibration_source import (
    SourceName,
    ValueSource,
    calibration_files,
    is_image,
    part_of,
    source_of,
)
from kennfeld.app.session.edited_values import fit_onto
from kennfeld.app.session.session import Session
from kennfeld.app.session.state import SetTables
from kennfeld.app.wire import Toml
from kennfeld.base.arrays import Float
from kennfeld.base.errors import ArgumentError, Finding
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.output_paths import plain_name
from kennfeld.calfiles import Change, Difference, Tolerance, compare, endings, losses, merge, read_with_findings, write
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text
from kennfeld.graph import Graph
from kennfeld.graph.traversal import coordinates_of

Item = Parameter | Text | Axis

MAX_ROWS = 5000  # labels that are listed
MAX_REMARKS = 50


@dataclass(frozen=True)
class ListedCalibration:
    """A calibration file of the folder; an image needs an A2L file."""

    name: str
    format: str
    image: bool


@dataclass(frozen=True)
class CalibrationFiles:
    """The calibration files of the folder.

    Attributes:
        descriptions: A2L files.
        endings: that can be written.
        initial: the initial files as the project names them.
    """

    files: Sequence[ListedCalibration]
    descriptions: Sequence[str]
    endings: Sequence[str]
    initial: Sequence[Toml]


@dataclass(frozen=True)
class AskedContents:
    """A set of values; an A2L file has labels alone."""

    source: SourceName


@dataclass(frozen=True)
class LabelRow:
    """A label of a set of values, with the range of its values."""

    name: str
    size: str
    kind: str
    unit: str
    description: str
    text: str
    function: str
    least: float | None
    greatest: float | None


@dataclass(frozen=True)
class SetContents:
    """The labels of a set of values, `count` of them, and what was skipped."""

    label: str
    rows: Sequence[LabelRow]
    count: int
    findings: Sequence[str]


@dataclass(frozen=True)
class AskedDifferences:
    """Two sets of values, and the largest differences that count as equal."""

    first: SourceName
    second: SourceName
    tolerance: float | None = None
    relative: float | None = None


@dataclass(frozen=True)
class AspectRow:
    """One aspect in which a label differs, in words."""

    aspect: str
    first: str
    second: str
    place: str


@dataclass(frozen=True)
class LabelDifference:
    """A label that differs in two sets.

    Attributes:
        name: with the variant, if there is one.
        label: its name alone.
        only: the set that has it alone.
        largest: largest difference of values.
        differ: number of values that differ, of `total`.
        place: of the largest difference.
        takeable: true if the project can take the values of the second set.
    """

    name: str
    label: str
    kind: str
    unit: str
    function: str
    only: Literal["", "first", "second"]
    largest: float | None
    differ: int
    total: int
    place: str
    aspects: Sequence[AspectRow]
    takeable: bool


@dataclass(frozen=True)
class SetDifferences:
    """The labels that differ in two sets, `count` of them, of those that were compared."""

    labels: tuple[str, str]
    rows: Sequence[LabelDifference]
    count: int
    compared: int
    findings: Sequence[str]


@dataclass(frozen=True)
class AskedPair:
    """A label of two sets."""

    first: SourceName
    second: SourceName
    name: str


@dataclass(frozen=True)
class LabelValues:
    """The values of a label in C order, with its axes; a text has none."""

    kind: str
    unit: str
    description: str
    function: str
    axes: Sequence[AxisPoints]
    values: Sequence[float | None]
    text: str


@dataclass(frozen=True)
class LabelPair:
    """A label in two sets; null for a set without it."""

    name: str
    first: LabelValues | None
    second: LabelValues | None


@dataclass(frozen=True)
class TakeCommand:
    """Labels of a set whose values the project takes."""

    source: SourceName
    names: Sequence[str]


@dataclass(frozen=True)
class TakenValues:
    """Number of parameters whose values were taken, and remarks."""

    taken: int
    findings: Sequence[str]


@dataclass(frozen=True)
class WriteCommand:
    """A file of the folder that is written; its ending selects the format.

    Attributes:
        first: the set that is written.
        target: name of the file.
        second: a set whose labels replace those of the first.
        names: these of its labels; null for all.
        image: the image whose copy gets the values.
        a2l: the A2L file of the image.
        force: replace a file that exists.
    """

    first: SourceName
    target: str
    second: SourceName | None = None
    names: Sequence[str] | None = None
    image: str = ""
    a2l: str = ""
    force: bool = False


@dataclass(frozen=True)
class LabelChange:
    """A label of the second set that was replaced or added."""

    name: str
    action: str
    details: str


@dataclass(frozen=True)
class RoundedRow:
    """A label whose values a file does not store exactly: asked for, stored, and how many differ."""

    name: str
    differ: int
    total: int
    largest: float | None
    place: str
    asked: str
    stored: str


@dataclass(frozen=True)
class WrittenCalibration:
    """A file that was written, and what differs from the first set."""

    file: str
    changes: Sequence[LabelChange]
    findings: Sequence[str]
    rounded: Sequence[RoundedRow]


def calibrations(session: Session) -> CalibrationFiles:
    """Return the calibration files of the folder, the A2L files among them, and the endings that can be written."""
    files = calibration_files(session.path.parent)
    plain = [ListedCalibration(name, kind, is_image(name)) for name, kind in files if kind != "A2L"]
    settings = session.settings.get("calibration", {})
    initial = settings.get("initial", []) if isinstance(settings, dict) else []
    return CalibrationFiles(
        files=plain,
        descriptions=[name for name, kind in files if kind == "A2L"],
        endings=list(endings()),
        initial=initial if isinstance(initial, list) else [initial],
    )


def contents(session: Session, asked: AskedContents) -> SetContents:
    """Return what a set of values holds."""
    if asked.source.file.lower().endswith(".a2l"):
        return _labels(confined(session.path.parent, asked.source.file))
    source = source_of(session, asked.source)
    rows = [_content(item) for item in _items(source)]
    return SetContents(source.label, rows[:MAX_ROWS], len(rows), _texts(source.findings))


def _labels(path: Path) -> SetContents:
    """Return the labels of an A2L file with their limits."""
    from kennfeld.calfiles import describe_a2l

    description = describe_a2l(path)
    rows = [
        LabelRow(
            name=label.name,
            kind=label.kind,
            size=" x ".join(map(str, label.shape)),
            unit=label.unit,
            description=label.description,
            function=", ".join(label.functions),
            text="",
            least=finite(label.lower),
            greatest=finite(label.upper),
        )
        for label in description.labels
    ]
    return SetContents(path.name, rows[:MAX_ROWS], len(rows), _texts(description.findings))


def _content(item: Item) -> LabelRow:
    side = _side(item)
    known = [value for value in side.values if value is not None]
    return LabelRow(
        name=item.name,
        size=" x ".join(str(len(axis.points)) for axis in side.axes),
        kind=side.kind,
        unit=side.unit,
        description=side.description,
        text=side.text,
        function=side.function,
        least=min(known, default=None),
        greatest=max(known, default=None),
    )


def differences(session: Session, asked: AskedDifferences) -> SetDifferences:
    """Return the differences between two sets, a row for each name."""
    first, second = source_of(session, asked.first), source_of(session, asked.second)
    allowed = Tolerance(asked.tolerance or 0.0, asked.relative or 0.0)
    comparison = compare(first.parameters, second.parameters, allowed)
    by_name: dict[str, list[Difference]] = {}
    for difference in comparison.differences:
        by_name.setdefault(difference.name, []).append(difference)
    own = session.view.now.parameters if session.view is not None else ParameterSet()
    graph = None if session.view is None else session.view.model.problem.graph
    rows = [_row(name, each, first, second, own, graph) for name, each in by_name.items()]
    return SetDifferences(
        labels=(first.label, second.label),
        rows=rows[:MAX_ROWS],
        count=len(rows),
        compared=comparison.compared,
        findings=_texts((*first.findings, *second.findings)),
    )


def _row(
    name: str,
    own: Sequence[Difference],
    first: ValueSource,
    second: ValueSource,
    present: ParameterSet,
    graph: Graph | None,
) -> LabelDifference:
    label = _label(name, first, second)
    item = _item(second, label) or _item(first, label)
    presence = next((difference for difference in own if difference.aspect == "presence"), None)
    numbers = [difference for difference in own if difference.largest is not None]
    largest = next((difference for difference in numbers if difference.aspect == "values"), None)
    return LabelDifference(
        name=name,
        label=label,
        kind="" if item is None else _kind(item),
        unit=getattr(item, "unit", ""),
        function=own[0].function,
        only="" if presence is None else "first" if presence.left else "second",
        largest=None if largest is None or largest.largest is None else finite(largest.largest),
        differ=0 if largest is None else largest.count,
        total=0 if largest is None else largest.total,
        place="" if largest is None else _place(largest, item, graph),
        aspects=[AspectRow(d.aspect, d.left, d.right, d.place) for d in own],
        takeable=label in present and isinstance(_item(second, label), Parameter),
    )


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


def pair(session: Session, asked: AskedPair) -> LabelPair:
    """Return a label in two sets, with its axes."""
    items = [_item(source_of(session, source), asked.name) for source in (asked.first, asked.second)]
    first, second = (None if item is None else _side(item) for item in items)
    return LabelPair(asked.name, first, second)


def _side(item: Item) -> LabelValues:
    if isinstance(item, Text):
        return _of(item, item.kind, [], [], item.text)
    if isinstance(item, Axis):
        index = AxisPoints("number", "", list(range(1, len(item) + 1)))
        return _of(item, "group axis", [index], finite_list(item.breakpoints), "")
    axes = [AxisPoints(axis.input or axis.name, axis.unit, axis.breakpoints.tolist()) for axis in item.index_axes]
    return _of(item, item.kind, axes, finite_list(item.values), "")


def _of(item: Item, kind: str, axes: list[AxisPoints], values: list[float | None], text: str) -> LabelValues:
    functions = getattr(item, "functions", ())
    return LabelValues(
        kind=kind,
        unit=item.unit,
        description=getattr(item, "description", ""),
        function=functions[0] if functions else "",
        axes=axes,
        values=values,
        text=text,
    )


def take_values(session: Session, asked: TakeCommand) -> TakenValues:
    """Take the values of labels of a set into the project; undo takes them back.

    Tables with other axes are interpolated onto those of the project.
    """
    if session.is_calibrating:
        raise ArgumentError("a calibration is running, whose values would replace these; take them at its end")
    source, own = source_of(session, asked.source), session.parameters
    tables: dict[str, Float | None] = {}
    remarks = []
    for name in asked.names:
        if name not in source.parameters or name not in own:
            raise ArgumentError(f"{name[:100]} is not a parameter of both the project and {source.label}")
        other = source.parameters[name]
        tables[name] = fit_onto(own[name], other).values
        if [a.breakpoints.tolist() for a in own[name].axes] != [a.breakpoints.tolist() for a in other.axes]:
            remarks.append(f"{name}: interpolated onto the axes of the project")
    if not tables:
        raise ArgumentError("no parameter is chosen")
    session.do(SetTables(f"Took {', '.join(list(tables)[:3])} from {source.label}", tables))
    return TakenValues(len(tables), remarks)


def write_calibration(session: Session, asked: WriteCommand) -> WrittenCalibration | ExistingFile:
    """Write a set of values, or two that are merged, as a file of the folder.

    A file that exists is replaced only with `force`.
    """
    first, folder = source_of(session, asked.first), session.path.parent
    target = writable(folder, plain_name(asked.target))
    if target.suffix.lower() not in endings():
        raise ArgumentError(f"unknown format {target.suffix!r}; known are {', '.join(endings())}")
    if target.exists() and not asked.force:
        return ExistingFile(target.name)
    parameters, changes = first.parameters, tuple[Change, ...]()
    if asked.second is not None:
        second = source_of(session, asked.second)
        own = second.parameters if asked.names is None else part_of(second.parameters, set(asked.names))
        merged = merge([(first.label, first.parameters), (second.label, own)])
        parameters, changes = merged.parameters, merged.changes
    image, a2l = (confined(folder, name) if name else None for name in (asked.image, asked.a2l))
    findings = [*write(parameters, target, image, a2l), *losses(parameters, target)]
    rows = rounded(parameters, target, a2l or first.a2l)
    return WrittenCalibration(target.name, [_change_row(change) for change in changes], _texts(findings), rows)


def _place(difference: Difference, item: Item | None, graph: Graph | None) -> str:
    """Return the place of a difference by the names of the axes, if they are known: `Speed = 700`."""
    if not isinstance(item, Parameter):
        return difference.place
    inputs = [] if graph is None else coordinates_of(graph, item.name)
    names = [axis.input for axis in describe_axes(item, inputs)]
    points = [part.partition("=")[2].strip() for part in difference.place.split(", ")]
    if not all(names) or len(names) != len(points):
        return difference.place
    return ", ".join(f"{name} = {point}" for name, point in zip(names, points, strict=True))


def _change_row(change: Change) -> LabelChange:
    details = "; ".join(f"{each.aspect} {each.left} -> {each.right}"[:120] for each in change.differences)
    return LabelChange(change.name, "replaced" if change.replaces else "added", details)


def rounded(parameters: ParameterSet, target: Path, a2l: Path | None) -> list[RoundedRow]:
    """Return the labels whose values an image does not store exactly: asked for, stored, and how many differ."""
    if not is_image(target.name):
        return []
    stored, _ = read_with_findings(target, a2l)
    both = [name for name in parameters if name in stored]
    comparison = compare(parameters.select(both), stored.select(both))
    return [
        RoundedRow(
            name=each.name,
            differ=each.count,
            total=each.total,
            largest=finite(each.largest if each.largest is not None else math.nan),
            place=each.place,
            asked=each.left,
            stored=each.right,
        )
        for each in comparison.differences
        if each.largest is not None
    ]


def _texts(findings: Iterable[Finding]) -> list[str]:
    texts = list(map(str, findings))
    more = len(texts) - MAX_REMARKS
    return [*texts[:MAX_REMARKS], *([f"{more} more remarks"] if more > 0 else [])]
