"""DCM blocks as parameters: numbers, axes, units, group axes; every block is checked before anything is built."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from math import isfinite, prod

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.dcm_lines import Block as Lines
from kennfeld.calfiles.dcm_lines import split, unquoted
from kennfeld.calfiles.format import Content, Notes, Source, counted
from kennfeld.parameters import Axis, Block, Parameter, ParameterSet, Text, parameter

__all__ = ["read_dcm"]

_AXES = (("x", "ST/X", "EINHEIT_X", "SSTX"), ("y", "ST/Y", "EINHEIT_Y", "SSTY"))


@dataclass(frozen=True)
class _Table:
    """A checked block whose group axes are not tied yet."""

    lines: Lines
    member: Parameter
    groups: tuple[str, ...] = ()  # the group axis each axis refers to


@dataclass(frozen=True)
class _Numbers:
    """All numbers behind one keyword of a block."""

    values: Float
    line: int  # where they begin
    rows: tuple[tuple[int, str, int], ...] = ()  # each ST/Y: its line, its text, how many numbers stood before it


@dataclass
class _Found:
    """What the blocks hold, by name."""

    tables: dict[str, _Table] = field(default_factory=dict)
    texts: dict[str, tuple[Lines, Text]] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)
    axis_lines: dict[str, Lines] = field(default_factory=dict)


def read_dcm(source: Source) -> Content:
    """The parameters of a DCM file, version 1.x or 2.x.

    Maps are stored by y in the file and turned here, so that `values[i, j]` is x index i, y index j.
    Raises `InputError` with every finding; text axes and text tables are left aside with a remark.
    """
    notes = Notes(source.name)
    lines = split(source.text, notes)
    reader = _Reader(notes, lines.version)
    blocks = [block for block in lines.blocks if block.sizes is not None]
    for block in blocks:
        if block.keyword == "STUETZSTELLENVERTEILUNG":
            reader.take_axis(block)
    for block in blocks:
        if block.keyword != "STUETZSTELLENVERTEILUNG":
            reader.take(block)
    members = reader.tied()
    remarks = notes.settle()
    texts = [text for _, text in reader.found.texts.values()]
    return Content(f"DCM {lines.version}", ParameterSet(members, texts, reader.found.axes.values()), remarks)


class _Reader:
    def __init__(self, notes: Notes, version: str) -> None:
        self.notes = notes
        self.version = version
        self.found = _Found()

    def take_axis(self, block: Lines) -> None:
        """Keep a group axis."""
        points = self._axis_points(block, 0)
        if points is None:
            return
        axis = Axis(points, unit=block.text_of("EINHEIT_X"), name=block.name)
        known = self.found.axes.setdefault(block.name, axis)
        first = self.found.axis_lines.setdefault(block.name, block)
        if not np.array_equal(known.breakpoints, points):
            self._repeated(block, first, "with other breakpoints")

    def take(self, block: Lines) -> None:
        """Check a block and keep what it holds."""
        keys = [key for _, key, _ in block.statements]
        if "VAR" in keys and {"WERT", "TEXT"} & set(keys[: keys.index("VAR")]):
            what = f"the value of variant {block.rest_of('VAR').strip()} is left aside"
            self.notes.remark(block.line, block.name, what)
        if block.keyword in ("FESTWERT", "TEXTSTRING") and block.rest_of("TEXT"):
            self._take_text(block)
            return
        texts = [key for key in keys if key in ("TEXT", "ST_TX/X", "ST_TX/Y")]
        if texts:
            what = f"{block.keyword} holds text ({texts[0]}), which is no number to calibrate; left aside"
            self.notes.remark(block.line, block.name, what)
            return
        table = self._table(block)
        if table is not None:
            self._take_table(block, table)

    def _take_text(self, block: Lines) -> None:
        text = Text(block.name, unquoted(block.rest_of("TEXT")), block.text_of("LANGNAME"))
        first, known = self.found.texts.setdefault(block.name, (block, text))
        if block.name in self.found.tables:
            self._twice(block, self.found.tables[block.name].lines.line, "as a text")
        elif known.text != text.text:
            self._repeated(block, first, "with another text")

    def _take_table(self, block: Lines, table: _Table) -> None:
        if block.name in self.found.texts:
            self._twice(block, self.found.texts[block.name][0].line, "as a number")
            return
        known = self.found.tables.setdefault(block.name, table)
        if not _same_values(known.member, table.member):
            self._repeated(block, known.lines, "with other values")

    def _repeated(self, block: Lines, first: Lines, difference: str) -> None:
        """One label may occur once a variant; the first variant counts."""
        if block.rest_of("VAR").strip() == first.rest_of("VAR").strip():
            self._twice(block, first.line, difference)
        else:
            variant = block.rest_of("VAR").strip()
            what = f"is another variant ({variant}) of the block in line {first.line}; left aside"
            self.notes.remark(block.line, block.name, what)

    def _twice(self, block: Lines, line: int, difference: str) -> None:
        what = f"{block.name} is defined a second time, {difference}, after line {line}"
        self.notes.error(block.line, block.name, what, "Keep one of the two.")

    def _table(self, block: Lines) -> _Table | None:
        assert block.sizes is not None
        attributes = {"unit": block.text_of("EINHEIT_W"), "description": block.text_of("LANGNAME")}
        if block.keyword == "FESTWERTEBLOCK":
            values = self._values(block, block.sizes)
            return None if values is None else _Table(block, Block(block.name, values, **attributes))
        axes = [self._axis(block, direction) for direction in range(len(block.sizes))]
        values = self._values(block, block.sizes)
        if values is None or None in axes:
            return None
        own = [axis for axis in axes if axis is not None]
        return _Table(block, parameter(block.name, values, own, **attributes), _groups(block))

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
        wrong = _wrong_axis(letter, found.values, block.sizes[direction])
        if wrong:
            self.notes.error(found.line, block.name, *wrong)
        return None if wrong else found.values

    def _points_elsewhere(self, block: Lines, direction: int, group: Axis | None) -> Float | None:
        """DCM 1.x writes group and fixed tables without breakpoints; a distribution may hold them."""
        assert block.sizes is not None
        if group is not None and len(group) == block.sizes[direction]:
            return group.breakpoints
        letter, keyword = _AXES[direction][:2]
        if self.version.startswith("1") and block.keyword.startswith(("FEST", "GRUPPEN")):
            what = f"{block.keyword} of DCM 1.x has no {letter} breakpoints in the file; left aside"
            self.notes.remark(block.line, block.name, what, "Export it as DCM 2.0.")
        else:
            self.notes.error(block.line, block.name, f"has no {letter} breakpoints", f"Add a line {keyword}.")
        return None

    def _values(self, block: Lines, sizes: tuple[int, ...]) -> Float | None:
        found = self._numbers(block, "WERT")
        if found is None or not self._rows_complete(block, found):
            return None
        count, wanted = len(found.values), prod(sizes)
        if count != wanted:
            asked = f"{' x '.join(map(str, sizes))} = {wanted}" if len(sizes) > 1 else str(wanted)
            self.notes.error(block.line, block.name, f"has {counted(count, 'value')}, its header asks for {asked}")
            return None
        return found.values.reshape(sizes[::-1]).T

    def _rows_complete(self, block: Lines, found: _Numbers) -> bool:
        """Whether each ST/Y of a map is followed by one row; a table of the right size may still be shifted."""
        if block.sizes is None or len(block.sizes) < 2 or len(found.rows) != block.sizes[1]:
            return True
        ends = [start for _, _, start in found.rows[1:]] + [len(found.values)]
        complete = True
        for (line, rest, start), end in zip(found.rows, ends, strict=True):
            if end - start != block.sizes[0]:
                count = counted(end - start, "value")
                what = f"the row at y = {rest.strip()} has {count}, the header asks for {block.sizes[0]}"
                self.notes.error(line, block.name, what)
                complete = False
        return complete

    def _numbers(self, block: Lines, keyword: str) -> _Numbers | None:
        """All numbers behind a keyword; None where one of them is none."""
        numbers: list[float] = []
        rows: list[tuple[int, str, int]] = []
        begin = 0
        try:
            for line, key, rest in block.statements:
                if key == keyword:
                    begin = begin or line
                    numbers += map(_strict_float if "_" in rest else float, rest.split())
                elif key == "ST/Y":
                    rows.append((line, rest, len(numbers)))
        except ValueError:
            self._wrong_numbers(block, keyword)
            return None
        values = np.array(numbers, dtype=np.float64)
        if not np.isfinite(values).all():
            self._wrong_numbers(block, keyword)
            return None
        return _Numbers(values, begin or block.line, tuple(rows))

    def _wrong_numbers(self, block: Lines, keyword: str) -> None:
        for line, key, rest in block.statements:
            for word in rest.split() if key == keyword else ():
                if not _is_number(word):
                    mend = "Write a decimal point." if _is_number(word.replace(",", ".", 1)) else ""
                    self.notes.error(line, block.name, f"{word[:60]!r} is no finite number", mend, rest)

    def _axis_named(self, reference: str) -> Axis | None:
        r"""ASCET refers to the axis `distrib` of a module as `distrib\Module`."""
        axes = self.found.axes
        return axes.get(reference) or axes.get(reference.partition("\\")[0])

    def tied(self) -> list[Parameter]:
        """The tables with their group axes named."""
        return [self._tied(table) for table in self.found.tables.values()]

    def _tied(self, table: _Table) -> Parameter:
        if not any(table.groups):
            return table.member
        pairs = zip(table.member.axes, table.groups, strict=True)
        return table.member.changed(axes=tuple(self._tie(table.lines, axis, group) for axis, group in pairs))

    def _tie(self, block: Lines, axis: Axis, reference: str) -> Axis:
        if not reference:
            return axis
        group = self._axis_named(reference)
        if group is None:
            group = self.found.axes[reference] = Axis(axis.breakpoints, unit=axis.unit, name=reference)
        if not np.array_equal(group.breakpoints, axis.breakpoints):
            what = f"has other breakpoints than the group axis {group.name}; they are kept as an axis of its own"
            self.notes.remark(block.line, block.name, what)
            return axis
        return Axis(axis.breakpoints, unit=axis.unit, name=group.name)


def _groups(block: Lines) -> tuple[str, ...]:
    """The group axes a block refers to; other kinds own their axes, whatever a comment says."""
    assert block.sizes is not None
    if not block.keyword.startswith("GRUPPEN"):
        return ()
    return tuple(block.rest_of(_AXES[direction][3]) for direction in range(len(block.sizes)))


def _wrong_axis(letter: str, points: Float, size: int) -> tuple[str, str] | None:
    """What is wrong with the breakpoints of an axis, and the mend."""
    if len(points) != size:
        return f"has {counted(len(points), f'{letter} breakpoint')}, its header asks for {size}", ""
    falling = np.flatnonzero(points[1:] <= points[:-1])
    if not falling.size:
        return None
    at = int(falling[0])
    what = (
        f"the {letter} axis does not increase: breakpoint {at + 2} ({points[at + 1]:g}) "
        f"does not exceed breakpoint {at + 1} ({points[at]:g})"
    )
    return what, "Each breakpoint must be larger than the one before."


def _same_values(first: Parameter, second: Parameter) -> bool:
    if first.kind != second.kind or not np.array_equal(first.values, second.values):
        return False
    pairs: Iterable[tuple[Axis, Axis]] = zip(first.axes, second.axes, strict=True)
    return all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in pairs)


def _strict_float(word: str) -> float:
    """Python would read 1_000 as a thousand."""
    if "_" in word:
        raise ValueError(word)
    return float(word)


def _is_number(word: str) -> bool:
    try:
        return isfinite(_strict_float(word))
    except ValueError:
        return False
