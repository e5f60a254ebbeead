"""DCM blocks as parameters: numbers, axes, units, group axes; every block is checked before anything is built."""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.dcm_lines import Block as Lines
from kennfeld.calfiles.dcm_lines import split, unquoted
from kennfeld.calfiles.format import Content, Notes, Source
from kennfeld.errors import ArgumentError
from kennfeld.parameters import Axis, Block, Parameter, ParameterSet, Text, parameter

__all__ = ["read_dcm"]

_AXES = (("x", "ST/X", "EINHEIT_X", "SSTX"), ("y", "ST/Y", "EINHEIT_Y", "SSTY"))


@dataclass(frozen=True)
class _Table:
    """A checked block whose group axes are not tied yet."""

    lines: Lines
    member: Parameter
    groups: tuple[str, ...] = ()  # the group axis each axis refers to


@dataclass
class _Found:
    """What the blocks hold, by name."""

    tables: dict[str, _Table] = field(default_factory=dict)
    texts: dict[str, tuple[Lines, Text]] = field(default_factory=dict)
    axes: dict[str, Axis] = field(default_factory=dict)


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
        points = self._axis_points(block, 0)
        if points is None:
            return
        axis = Axis(points, unit=block.text_of("EINHEIT_X"), name=block.name)
        first = self.found.axes.setdefault(block.name, axis)
        if not np.array_equal(first.breakpoints, points):
            self._twice(block, 0, "other breakpoints")

    def take(self, block: Lines) -> None:
        if block.keyword in ("FESTWERT", "TEXTSTRING") and block.rest_of("TEXT"):
            return self._take_text(block)
        texts = [key for _, key, _ in block.statements if key in ("TEXT", "ST_TX/X", "ST_TX/Y")]
        if texts:
            what = f"{block.keyword} holds text ({texts[0]}), which is no number to calibrate; left aside"
            return self.notes.remark(block.line, block.name, what)
        table = self._table(block)
        if table is not None:
            self._take_table(block, table)
        return None

    def _take_text(self, block: Lines) -> None:
        text = Text(block.name, unquoted(block.rest_of("TEXT")), block.text_of("LANGNAME"))
        first, known = self.found.texts.setdefault(block.name, (block, text))
        if block.name in self.found.tables:
            self._twice(block, self.found.tables[block.name].lines.line, "as a number")
        elif known.text != text.text:
            self._repeated(block, first, "another text")

    def _take_table(self, block: Lines, table: _Table) -> None:
        if block.name in self.found.texts:
            return self._twice(block, self.found.texts[block.name][0].line, "as a text")
        known = self.found.tables.setdefault(block.name, table)
        if not _same_values(known.member, table.member):
            self._repeated(block, known.lines, "other values")
        return None

    def _repeated(self, block: Lines, first: Lines, difference: str) -> None:
        """One label may occur once a variant; the first variant counts."""
        if block.rest_of("VAR").strip() == first.rest_of("VAR").strip():
            return self._twice(block, first.line, difference)
        what = f"is another variant (VAR {block.rest_of('VAR').strip()}) of the block in line {first.line}; left aside"
        return self.notes.remark(block.line, block.name, what)

    def _twice(self, block: Lines, line: int, difference: str) -> None:
        where = f"line {line}" if line else "a block before"
        what = f"{block.name} is defined a second time, with {difference} than in {where}"
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
        points, line = self._numbers(block, keyword)
        if points is None:
            return None
        if len(points) != block.sizes[direction]:
            what = f"has {_count(len(points), f'{letter} breakpoint')}, its header asks for {block.sizes[direction]}"
            return self.notes.error(line, block.name, what)
        falling = np.flatnonzero(np.diff(points) <= 0)
        if falling.size:
            at = int(falling[0])
            what = (
                f"the {letter} axis does not increase: breakpoint {at + 2} ({points[at + 1]:g}) "
                f"does not exceed breakpoint {at + 1} ({points[at]:g})"
            )
            return self.notes.error(line, block.name, what, "Each breakpoint must be larger than the one before.")
        return points

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
        values, _ = self._numbers(block, "WERT")
        if values is None or not self._rows_complete(block, len(values)):
            return None
        wanted = 1
        for size in sizes:
            wanted *= size
        if len(values) != wanted:
            asked = f"{' x '.join(map(str, sizes))} = {wanted}" if len(sizes) > 1 else str(wanted)
            source = "its header asks" if sizes else f"{block.keyword} asks"
            self.notes.error(block.line, block.name, f"has {_count(len(values), 'value')}, {source} for {asked}")
            return None
        return values.reshape(sizes[::-1]).T

    def _rows_complete(self, block: Lines, total: int) -> bool:
        """Whether each ST/Y of a map is followed by one row; a table of the right size may still be shifted."""
        if block.sizes is None or len(block.sizes) != 2 or block.keyword == "FESTWERTEBLOCK":
            return True
        starts: list[tuple[int, str, int]] = []
        taken = 0
        for line, keyword, rest in block.statements:
            if keyword == "ST/Y":
                starts.append((line, rest, taken))
            elif keyword == "WERT":
                taken += len(rest.split())
        if len(starts) != block.sizes[1]:
            return True
        ends = [start for _, _, start in starts[1:]] + [total]
        short = [(line, rest, end - start) for (line, rest, start), end in zip(starts, ends, strict=True)]
        short = [row for row in short if row[2] != block.sizes[0]]
        for line, rest, count in short:
            what = f"the row at y = {rest.strip()} has {_count(count, 'value')}, the header asks for {block.sizes[0]}"
            self.notes.error(line, block.name, what)
        return not short

    def _numbers(self, block: Lines, keyword: str) -> tuple[Float | None, int]:
        """All numbers behind a keyword, and the line where they begin; None where one of them is none."""
        numbers: list[float] = []
        usable, begin = True, 0
        for line, key, rest in block.statements:
            if key == keyword:
                begin = begin or line
                try:
                    numbers += map(float, rest.split())
                except ValueError:
                    usable = self._wrong_number(block, line, rest)
                if "_" in rest:
                    usable = self._wrong_number(block, line, rest)
        made = np.array(numbers, dtype=np.float64)
        if usable and not np.isfinite(made).all():
            usable = self._not_finite(block, keyword)
        return (made if usable else None), begin or block.line

    def _wrong_number(self, block: Lines, line: int, rest: str) -> bool:
        word = next((word for word in rest.split() if not _is_number(word)), rest)
        mend = "Write a decimal point." if _is_number(word.replace(",", ".", 1)) else ""
        self.notes.error(line, block.name, f"{word[:60]!r} is no number", mend, rest)
        return False

    def _not_finite(self, block: Lines, keyword: str) -> bool:
        for line, key, rest in block.statements:
            for word in rest.split() if key == keyword else ():
                if not np.isfinite(float(word)):
                    self.notes.error(line, block.name, f"{word[:60]!r} is no finite number", "", rest)
        return False

    def _axis_named(self, reference: str) -> Axis | None:
        """ASCET refers to the axis `distrib` of a module as `distrib\\Module`."""
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


def _same_values(first: Parameter, second: Parameter) -> bool:
    if first.kind != second.kind or not np.array_equal(first.values, second.values):
        return False
    pairs: Iterable[tuple[Axis, Axis]] = zip(first.axes, second.axes, strict=True)
    return all(np.array_equal(a.breakpoints, b.breakpoints) for a, b in pairs)


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return "_" not in word


def _count(number: int, thing: str) -> str:
    return f"{number} {thing}" if number == 1 else f"{number} {thing}s"
