"""Converts DCM blocks to parameters: numbers, axes, units and group axes."""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from math import isfinite, prod
from typing import Any

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.dcm.lines import DcmBlock as Lines
from kennfeld.calfiles.dcm.lines import DcmLines, split_blocks, unquote
from kennfeld.calfiles.format import CalibrationSource, Findings, ReadResult, build_set
from kennfeld.calfiles.verbal_values import unify_text_kinds
from kennfeld.formatting import count_noun
from kennfeld.parameters import Axis, Block, Parameter, Text, TextKind, parameter

_AXES = (("x", "ST/X", "EINHEIT_X", "SSTX"), ("y", "ST/Y", "EINHEIT_Y", "SSTY"))
_MAX_VARIANT_LINE = 4096  # characters of a line with the values of variants; the search takes the square of them
_VARIANT = re.compile(r'([^,="]+)(?:=\s*("(?:[^"\\]|\\.)*"|[^,]*))?\s*(?:,|$)')

Key = tuple[str, str]  # name and variant
Item = Parameter | Text


@dataclass(frozen=True)
class PendingTable:
    """A checked block whose group axes are not resolved yet."""

    lines: Lines
    item: Item
    groups: tuple[str, ...] = ()  # the group axis each axis refers to


@dataclass(frozen=True)
class _Numbers:
    """All numbers after one keyword of a block."""

    values: Float
    line: int  # where they begin
    rows: tuple[tuple[int, str, int], ...] = ()  # each ST/Y: its line, its text, how many numbers stood before it


@dataclass
class DcmContent:
    """The parameters, texts and group axes of the blocks."""

    items: dict[Key, PendingTable] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)
    axis_lines: dict[str, Lines] = field(default_factory=dict)
    keys: dict[int, Key] = field(default_factory=dict)  # of the block that begins in a line


@dataclass(frozen=True, eq=False)
class Dcm:
    """A DCM file as read: its text, its blocks and their content.

    `keys` gives name and variant for the line in which a block begins; blocks that hold no numbers have none.
    """

    source: CalibrationSource
    blocks: tuple[Lines, ...]
    keys: Mapping[int, Key]
    items: Mapping[Key, Item]
    axes: Mapping[str, Axis]
    criteria: frozenset[str]


def read_dcm(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a DCM file, version 1.x or 2.x.

    Maps are stored by y in the file and turned here, so that `values[i, j]` is x index i, y index j. Of a label with
    several variants the first one counts. Raises `InputError` with all findings; text axes and text tables are left
    aside with a remark, and stay in the file when it is written again.
    """
    findings = Findings(source.name)
    lines = split_blocks(source.text, findings)
    reader = _DcmReader(findings, lines)
    blocks = [block for block in lines.blocks if block.sizes is not None]
    for block in blocks:
        if block.keyword == "STUETZSTELLENVERTEILUNG":
            reader.take_axis(block)
    for block in blocks:
        if block.keyword != "STUETZSTELLENVERTEILUNG":
            reader.take(block)
    items, axes = reader.tied(), reader.found.axes
    remarks = findings.finish()
    origin = Dcm(source, tuple(lines.blocks), reader.found.keys, items, axes, lines.criteria)
    return ReadResult(f"DCM {lines.version}", build_set(items, axes.values(), origin), remarks)


def variant_of(block: Lines, criteria: frozenset[str] = frozenset()) -> str:
    """Return the variant for which a block holds: `Engine=2,Gear=1`; empty if it names none."""
    return "" if variant_values(block, criteria) else _normalise_criteria(block.rest_of("VAR"))


def _normalise_criteria(rest: str) -> str:
    return ",".join("=".join(side.strip() for side in part.split("=")) for part in rest.split(","))


@dataclass(frozen=True)
class VariantValue:
    """The value of another variant in a block of one value, `VAR VariantA=27.5`: `start` is its place in the rest."""

    variant: str
    value: str
    line: int
    start: int


def variant_values(block: Lines, criteria: frozenset[str]) -> list[VariantValue]:
    """Return the values of other variants in a block of one value.

    Such a line states a criterion instead where the variant coding of the file declares it.
    """
    keys = [key for _, key, _ in block.statements]
    if block.keyword not in ("FESTWERT", "TEXTSTRING") or not {"WERT", "TEXT"} & set(keys):
        return []
    first = next(at for at, key in enumerate(keys) if key in ("WERT", "TEXT"))
    values = [
        VariantValue(match[1].strip(), (match[2] or "").strip(), line, match.start(2))
        for line, key, rest in block.statements[first:]
        if key == "VAR" and len(rest) < _MAX_VARIANT_LINE
        for match in _VARIANT.finditer(rest)
    ]
    quoted = keys[first] == "TEXT"
    fits = (one.value.startswith('"') if quoted else _is_number(one.value) for one in values)
    return values if all(fits) and not criteria & {one.variant for one in values} else []


class _DcmReader:
    def __init__(self, findings: Findings, lines: DcmLines) -> None:
        self.findings = findings
        self.version = lines.version
        self.criteria = lines.criteria
        self.found = DcmContent()
        self.first: dict[str, PendingTable] = {}  # of each label

    def take_axis(self, block: Lines) -> None:
        points = self._axis_points(block, 0)
        if points is None:
            return
        axis = Axis(points, unit=block.text_of("EINHEIT_X"), name=block.name)
        known = self.found.axes.setdefault(block.name, axis)
        first = self.found.axis_lines.setdefault(block.name, block)
        if np.array_equal(known.breakpoints, points):
            self.found.keys[block.line] = (block.name, "")
        elif variant_of(block) == variant_of(first):
            self._twice(block, first.line, "with other breakpoints")
        else:
            message = f"is the axis of line {first.line} in another variant ({variant_of(block)}); skipped"
            self.findings.warning(block.line, block.name, message)

    def take(self, block: Lines) -> None:
        """Check a block and add its content."""
        keys = [key for _, key, _ in block.statements]
        if block.keyword in ("FESTWERT", "TEXTSTRING") and block.rest_of("TEXT"):
            kind: TextKind = "text" if block.keyword == "TEXTSTRING" else "enumeration"
            text, unit = unquote(block.rest_of("TEXT")), block.text_of("EINHEIT_W")
            self._take(block, Text(block.name, text, kind=kind, unit=unit, **self._labels(block)))
            return
        texts = [key for key in keys if key in ("TEXT", "ST_TX/X", "ST_TX/Y")]
        if texts:
            message = f"{block.keyword} contains text ({texts[0]}) and cannot be calibrated; skipped"
            self.findings.warning(block.line, block.name, message)
            return
        table = self._table(block)
        if table is not None:
            self._take(block, table, _group_axes(block))

    def _take(self, block: Lines, item: Item, groups: tuple[str, ...] = ()) -> None:
        self._hold(block, item, groups)
        for one in variant_values(block, self.criteria):
            if isinstance(item, Text):
                self._hold(block, replace(item, text=unquote(one.value), variant=one.variant))
            else:
                self._hold(block, item.changed(values=np.array(float(one.value)), variant=one.variant))

    def _hold(self, block: Lines, item: Item, groups: tuple[str, ...] = ()) -> None:
        """Add an item; a label may occur once per variant."""
        key = (item.name, item.variant)
        held = PendingTable(block, item, groups)
        first = self.first.setdefault(item.name, held)
        if isinstance(item, Text) != isinstance(first.item, Text):
            self._twice(block, first.lines.line, "as a text" if isinstance(item, Text) else "as a number")
            return
        known = self.found.items.setdefault(key, held)
        self.found.keys.setdefault(block.line, key)
        if not _same_content(known.item, item):
            self._twice(block, known.lines.line, "with another text" if isinstance(item, Text) else "with other values")

    def _labels(self, block: Lines) -> dict[str, Any]:
        return {
            "description": block.text_of("LANGNAME"),
            "functions": block.functions,
            "display_name": block.text_of("DISPLAYNAME"),
            "variant": variant_of(block, self.criteria),
        }

    def _twice(self, block: Lines, line: int, difference: str) -> None:
        message = f"{block.name} is already defined in line {line}, {difference}"
        self.findings.error(block.line, block.name, message, "Keep one of the two.")

    def _table(self, block: Lines) -> Parameter | None:
        assert block.sizes is not None
        attributes = self._labels(block) | {"unit": block.text_of("EINHEIT_W")}
        if block.keyword == "FESTWERTEBLOCK":
            values = self._values(block, block.sizes)
            return None if values is None else Block(block.name, values, **attributes)
        axes = [self._axis(block, direction) for direction in range(len(block.sizes))]
        values = self._values(block, block.sizes)
        if values is None or None in axes:
            return None
        own = [axis for axis in axes if axis is not None]
        return parameter(block.name, values, own, **attributes)

    def _axis(self, block: Lines, direction: int) -> Axis | None:
        points = self._axis_points(block, direction)
        return None if points is None else Axis(points, unit=block.text_of(_AXES[direction][2]))

    def _axis_points(self, block: Lines, direction: int) -> Float | None:
        assert block.sizes is not None
        letter, keyword, _, group = _AXES[direction]
        if not any(key == keyword for _, key, _ in block.statements):
            return self._points_elsewhere(block, direction, self._axis_named(block.rest_of(group)))
        found = self._numbers(block, keyword)
        if found is None:
            return None
        wrong = _axis_fault(letter, found.values, block.sizes[direction])
        if wrong:
            self.findings.error(found.line, block.name, *wrong)
        return None if wrong else found.values

    def _points_elsewhere(self, block: Lines, direction: int, group: Axis | None) -> Float | None:
        """Return breakpoints of a table without any: DCM 1.x stores them in a distribution, if at all."""
        assert block.sizes is not None
        if group is not None and len(group) == block.sizes[direction]:
            return group.breakpoints
        letter, keyword = _AXES[direction][:2]
        if self.version.startswith("1") and block.keyword.startswith(("FEST", "GRUPPEN")):
            message = f"{block.keyword} of DCM 1.x has no {letter} breakpoints in the file; skipped"
            self.findings.warning(block.line, block.name, message, "Export it as DCM 2.0.")
        else:
            self.findings.error(block.line, block.name, f"has no {letter} breakpoints", f"Add a line {keyword}.")
        return None

    def _values(self, block: Lines, sizes: tuple[int, ...]) -> Float | None:
        found = self._numbers(block, "WERT")
        if found is None or not self._rows_complete(block, found):
            return None
        count, wanted = len(found.values), prod(sizes)
        if count != wanted:
            asked = f"{' x '.join(map(str, sizes))} = {wanted}" if len(sizes) > 1 else str(wanted)
            self.findings.error(
                block.line, block.name, f"has {count_noun(count, 'value')}, but its header states {asked}"
            )
            return None
        return found.values.reshape(sizes[::-1]).T

    def _rows_complete(self, block: Lines, found: _Numbers) -> bool:
        """Check whether each ST/Y of a map is followed by one full row."""
        if block.sizes is None or len(block.sizes) < 2 or len(found.rows) != block.sizes[1]:
            return True
        ends = [start for _, _, start in found.rows[1:]] + [len(found.values)]
        complete = True
        for (line, rest, start), end in zip(found.rows, ends, strict=True):
            if end - start != block.sizes[0]:
                count = count_noun(end - start, "value")
                message = f"the row at y = {rest.strip()} has {count}, but the header states {block.sizes[0]}"
                self.findings.error(line, block.name, message)
                complete = False
        return complete

    def _numbers(self, block: Lines, keyword: str) -> _Numbers | None:
        """Return all numbers after a keyword; None if one of them is invalid."""
        words: list[str] = []
        rows: list[tuple[int, str, int]] = []
        waiting: list[str] = []  # lines that are split together, since a split for each would take twice as long
        begin = 0
        for line, key, rest in block.statements:
            if key == keyword:
                begin = begin or line
                waiting.append(rest)
            elif key == "ST/Y":
                words += " ".join(waiting).split()
                waiting.clear()
                rows.append((line, rest, len(words)))
        words += " ".join(waiting).split()
        try:
            values = np.array(list(map(_strict_float if "_" in "".join(words) else float, words)), dtype=np.float64)
        except ValueError:
            self._wrong_numbers(block, keyword)
            return None
        if not np.isfinite(values).all():
            self._wrong_numbers(block, keyword)
            return None
        return _Numbers(values, begin or block.line, tuple(rows))

    def _wrong_numbers(self, block: Lines, keyword: str) -> None:
        for line, key, rest in block.statements:
            for word in rest.split() if key == keyword else ():
                if not _is_number(word):
                    remedy = "Write a decimal point." if _is_number(word.replace(",", ".", 1)) else ""
                    self.findings.error(line, block.name, f"must be a finite number, got {word[:60]!r}", remedy, rest)

    def _axis_named(self, reference: str) -> Axis | None:
        r"""Return a group axis; ASCET refers to the axis `distrib` of a module as `distrib\Module`."""
        axes = self.found.axes
        return axes.get(reference) or axes.get(reference.partition("\\")[0])

    def tied(self) -> dict[Key, Item]:
        """Return all items, tables with their group axes named, the texts of a label of one kind."""
        return unify_text_kinds({key: self._tied(held) for key, held in self.found.items.items()})

    def _tied(self, held: PendingTable) -> Item:
        if isinstance(held.item, Text) or not any(held.groups):
            return held.item
        pairs = zip(held.item.axes, held.groups, strict=True)
        return held.item.changed(axes=tuple(self._tie(held.lines, axis, group) for axis, group in pairs))

    def _tie(self, block: Lines, axis: Axis, reference: str) -> Axis:
        if not reference:
            return axis
        group = self._axis_named(reference)
        if group is None:
            group = self.found.axes[reference] = Axis(axis.breakpoints, unit=axis.unit, name=reference)
        if not np.array_equal(group.breakpoints, axis.breakpoints):
            message = f"has other breakpoints than the group axis {group.name}; kept as an axis of its own"
            self.findings.warning(block.line, block.name, message)
            return axis
        return Axis(axis.breakpoints, unit=axis.unit or group.unit, name=group.name)


def _group_axes(block: Lines) -> tuple[str, ...]:
    """Return the group axes of a block; other kinds own their axes, whatever a comment states."""
    assert block.sizes is not None
    if not block.keyword.startswith("GRUPPEN"):
        return ()
    return tuple(block.rest_of(_AXES[direction][3]) for direction in range(len(block.sizes)))


def _axis_fault(letter: str, points: Float, size: int) -> tuple[str, str] | None:
    """Return what is wrong with breakpoints and the remedy, or None."""
    if len(points) != size:
        return f"has {count_noun(len(points), f'{letter} breakpoint')}, but its header states {size}", ""
    falling = np.flatnonzero(points[1:] <= points[:-1])
    if not falling.size:
        return None
    at = int(falling[0])
    message = (
        f"the {letter} axis is not strictly increasing: breakpoint {at + 2} ({points[at + 1]:g}) "
        f"does not exceed breakpoint {at + 1} ({points[at]:g})"
    )
    return message, "Each breakpoint must be greater than the previous one."


def _same_content(first: Item, second: Item) -> bool:
    if isinstance(first, Text) or isinstance(second, Text):
        return isinstance(first, Text) and isinstance(second, Text) and first.text == second.text
    if first.kind != second.kind or not np.array_equal(first.values, second.values):
        return False
    pairs: Iterable[tuple[Axis, Axis]] = zip(first.axes, second.axes, strict=True)
    return all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in pairs)


def _strict_float(word: str) -> float:
    """Convert a word to a number, but not 1_000, which Python accepts."""
    if "_" in word:
        raise ValueError(word)
    return float(word)


def _is_number(word: str) -> bool:
    try:
        return isfinite(_strict_float(word))
    except ValueError:
        return False
