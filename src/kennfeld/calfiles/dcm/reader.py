"""Converts DCM blocks to parameters: numbers, axes, units and group axes."""

import re
from collections.abc import Mapping, Set
from dataclasses import replace
from math import isfinite, prod
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import ItemCollector, describe_fall, in_rising_order, parse_float, turn
from kennfeld.calfiles.dcm.lines import DcmBlock, DcmLines, split_blocks, unquote
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, Key, ReadResult, build_set
from kennfeld.calfiles.verbal_values import unify_text_kinds
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Parameter, parameter
from kennfeld.domain.texts import Text, TextKind

_AXES = (("x", "ST/X", "EINHEIT_X", "SSTX"), ("y", "ST/Y", "EINHEIT_Y", "SSTY"))
_MAX_VARIANT_LINE = 4096  # characters of a line with the values of variants; the search takes the square of them
_VARIANT = re.compile(r'([^,="]+)(?:=\s*("(?:[^"\\]|\\.)*"|[^,]*))?\s*(?:,|$)')


@dataclass(frozen=True)
class _Numbers:
    """All numbers after one keyword of a block."""

    values: Float
    line: int  # where they begin
    rows: tuple[tuple[int, str, int], ...] = ()  # each ST/Y: its line, its text, how many numbers stood before it


@dataclass(frozen=True, eq=False)
class Dcm:
    """A DCM file as read: its text, its blocks and their content.

    `keys` gives name and variant for the line in which a block begins; blocks that hold no numbers have none.
    `block_axes` has the axes of each block with breakpoints, which fall if they do in that block.
    """

    source: CalibrationSource
    blocks: tuple[DcmBlock, ...]
    keys: Mapping[int, Key]
    items: Mapping[Key, Item]
    axes: Mapping[str, Axis]
    criteria: Set[str]
    block_axes: Mapping[int, tuple[Axis, ...]]


def read_dcm(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a DCM file, version 1.x or 2.x.

    Maps are stored by y in the file and turned here, so that `values[i, j]` is x index i, y index j; so are axes that
    fall. Of a label with several variants the first one counts. Text axes, text tables and axes that neither rise nor
    fall are skipped with a warning, and stay in the file when it is written again.

    Raises:
        InputError: with all findings.
    """
    findings = FileFindings(source.name)
    lines = split_blocks(source.text, findings)
    reader = _DcmReader(findings, lines)
    blocks = [block for block in lines.blocks if block.sizes is not None]
    # axes first, as a table may stand before the axis it refers to
    for block in blocks:
        if block.keyword == "STUETZSTELLENVERTEILUNG":
            reader.take_axis(block)
    for block in blocks:
        if block.keyword != "STUETZSTELLENVERTEILUNG":
            reader.take(block)
    items = reader.tie_items()
    warnings = findings.finish()
    origin = Dcm(source, tuple(lines.blocks), reader.keys, items, reader.axes, lines.criteria, reader.block_axes)
    return ReadResult(f"DCM {lines.version}", build_set(items, reader.axes.values(), origin), warnings)


def variant_of(block: DcmBlock, criteria: Set[str] = frozenset()) -> str:
    """Return the variant for which a block holds: `Engine=2,Gear=1`; empty if it names none."""
    if variant_values(block, criteria):
        return ""
    return ",".join("=".join(map(str.strip, part.split("="))) for part in block.rest_of("VAR").split(","))


@dataclass(frozen=True)
class VariantValue:
    """The value of another variant in a block of one value, `VAR VariantA=27.5`: `start` is its place in the rest."""

    variant: str
    value: str
    line: int
    start: int


def variant_values(block: DcmBlock, criteria: Set[str]) -> list[VariantValue]:
    """Return the values of other variants in a block of one value.

    Such a line states a criterion instead if the variant coding of the file declares it.
    """
    keys = [key for _, key, _ in block.statements]
    first = next((at for at, key in enumerate(keys) if key in ("WERT", "TEXT")), None)
    if block.keyword not in ("FESTWERT", "TEXTSTRING") or first is None:
        return []
    values = [
        VariantValue(match[1].strip(), (match[2] or "").strip(), line, match.start(2))
        for line, key, rest in block.statements[first:]
        if key == "VAR" and len(rest) < _MAX_VARIANT_LINE
        for match in _VARIANT.finditer(rest)
    ]
    quoted = keys[first] == "TEXT"
    fits = (value.value.startswith('"') if quoted else _is_number(value.value) for value in values)
    return values if all(fits) and not criteria & {value.variant for value in values} else []


class _DcmReader:
    def __init__(self, findings: FileFindings, lines: DcmLines) -> None:
        self.findings = findings
        self.version = lines.version
        self.criteria = lines.criteria
        self.items = ItemCollector(findings)
        self.blocks: dict[Key, DcmBlock] = {}  # of each item
        self.axes: dict[str, Axis] = {}
        self.axis_blocks: dict[str, DcmBlock] = {}
        self.axis_variants: dict[Key, Axis | None] = {}  # by name and variant; None if it cannot be read
        self.keys: dict[int, Key] = {}  # of the block that begins in a line
        self.block_axes: dict[int, tuple[Axis, ...]] = {}  # of the block that begins in a line
        self.skipped_axes: dict[str, int] = {}  # lines of group axes that cannot be read

    def take_axis(self, block: DcmBlock) -> None:
        own = self._axis(block, 0)
        self.axis_variants.setdefault((block.name, variant_of(block)), own)
        if own is None:
            self.skipped_axes.setdefault(block.name, block.line)
            return
        axis = self.axes.setdefault(block.name, own.changed(name=block.name))
        first = self.axis_blocks.setdefault(block.name, block)
        self.block_axes[block.line] = (own,)
        if np.array_equal(axis.breakpoints, own.breakpoints):
            self.keys[block.line] = (block.name, "")
        elif variant_of(block) == variant_of(first):
            self.items.report_repetition(block.name, block.line, first.line, "with other breakpoints")
        else:
            message = f"is the axis of line {first.line} in another variant ({variant_of(block)})"
            remedy = "Tables of that variant have it as an axis of their own."
            self.findings.warning(block.line, block.name, message, remedy)

    def take(self, block: DcmBlock) -> None:
        texts = [key for _, key, _ in block.statements if key in ("TEXT", "ST_TX/X", "ST_TX/Y")]
        item: Item | None
        if block.keyword in ("FESTWERT", "TEXTSTRING") and block.rest_of("TEXT"):
            kind: TextKind = "text" if block.keyword == "TEXTSTRING" else "enumeration"
            item = Text(block.name, block.text_of("TEXT"), kind=kind, **self._labels(block))
        elif texts:
            message = f"{block.keyword} contains text ({texts[0]}) and cannot be calibrated; skipped"
            self.findings.warning(block.line, block.name, message)
            return
        else:
            item = self._parameter(block)
        if item is None:
            return
        self._hold(block, item)
        for other in variant_values(block, self.criteria):
            if isinstance(item, Text):
                self._hold(block, replace(item, text=unquote(other.value), variant=other.variant))
            else:
                self._hold(block, item.changed(values=np.array(float(other.value)), variant=other.variant))

    def _hold(self, block: DcmBlock, item: Item) -> None:
        if self.items.add(item, block.line):
            key = (item.name, item.variant)
            self.blocks.setdefault(key, block)
            self.keys.setdefault(block.line, key)

    def _labels(self, block: DcmBlock) -> dict[str, Any]:
        return {
            "unit": block.text_of("EINHEIT_W"),
            "description": block.text_of("LANGNAME"),
            "functions": block.functions,
            "display_name": block.text_of("DISPLAYNAME"),
            "variant": variant_of(block, self.criteria),
        }

    def _parameter(self, block: DcmBlock) -> Parameter | None:
        sizes = block.sizes or ()
        count = len(sizes) if block.keyword != "FESTWERTEBLOCK" else 0
        candidates = [self._axis(block, direction) for direction in range(count)]
        axes = [axis for axis in candidates if axis is not None]
        values = self._values(block, sizes)
        if values is None:
            return None
        if block.keyword == "FESTWERTEBLOCK":
            return Block(block.name, values, **self._labels(block))
        if len(axes) < len(sizes):
            return None
        self.block_axes[block.line] = tuple(axes)
        return parameter(block.name, turn(values, axes), axes, **self._labels(block))

    def _axis(self, block: DcmBlock, direction: int) -> Axis | None:
        """Return an axis of a block, which falls if it does in the file."""
        assert block.sizes is not None
        letter, keyword, unit, group = _AXES[direction]
        size = block.sizes[direction]
        if not any(key == keyword for _, key, _ in block.statements):
            return self._axis_elsewhere(block, direction, self._axis_named(block.rest_of(group)))
        numbers = self._numbers(block, keyword)
        if numbers is None:
            return None
        points = numbers.values
        if len(points) != size:
            message = f"has {count_noun(len(points), f'{letter} breakpoint')}, but its header states {size}"
            self.findings.error(numbers.line, block.name, message)
            return None
        rising, falls = in_rising_order(points)
        if fall := describe_fall(rising):
            message = f"the {letter} axis neither rises nor falls: {fall}; skipped"
            self.findings.warning(numbers.line, block.name, message, "Correct its breakpoints.")
            return None
        return Axis(rising, unit=block.text_of(unit), falling=falls)

    def _axis_elsewhere(self, block: DcmBlock, direction: int, group: Axis | None) -> Axis | None:
        """Return the axis of a table without breakpoints: DCM 1.x stores them in a distribution, if at all."""
        assert block.sizes is not None
        key = ("" if group is None else group.name, variant_of(block, self.criteria))
        # the axis of the table's own variant, if there are several
        own = self.axis_variants.get(key, group)
        if own is not None and len(own) == block.sizes[direction]:
            return own.changed(name="", unit=block.text_of(_AXES[direction][2]))
        letter, keyword = _AXES[direction][:2]
        reference = block.rest_of(_AXES[direction][3])
        if reference in self.skipped_axes:
            message = f"skipped, as its {letter} axis {reference} in line {self.skipped_axes[reference]} is"
            self.findings.warning(block.line, block.name, message)
            return None
        if self.version.startswith("1") and block.keyword.startswith(("FEST", "GRUPPEN")):
            message = f"{block.keyword} of DCM 1.x has no {letter} breakpoints in the file; skipped"
            self.findings.warning(block.line, block.name, message, "Export it as DCM 2.0.")
        else:
            self.findings.error(block.line, block.name, f"has no {letter} breakpoints", f"Add a line {keyword}.")
        return None

    def _values(self, block: DcmBlock, sizes: tuple[int, ...]) -> Float | None:
        numbers = self._numbers(block, "WERT")
        if numbers is None or not self._has_complete_rows(block, numbers):
            return None
        if len(numbers.values) == prod(sizes):
            return numbers.values.reshape(sizes[::-1]).T
        stated = f"{' x '.join(map(str, sizes))} = {prod(sizes)}" if len(sizes) > 1 else str(prod(sizes))
        message = f"has {count_noun(len(numbers.values), 'value')}, but its header states {stated}"
        self.findings.error(block.line, block.name, message)
        return None

    def _has_complete_rows(self, block: DcmBlock, numbers: _Numbers) -> bool:
        """Check whether each ST/Y of a map is followed by one full row."""
        # without an ST/Y for each row, the values are counted as a whole
        if block.sizes is None or len(block.sizes) < 2 or len(numbers.rows) != block.sizes[1]:
            return True
        # a row ends where the next one begins
        ends = [start for _, _, start in numbers.rows[1:]] + [len(numbers.values)]
        complete = True
        for (line, rest, start), end in zip(numbers.rows, ends, strict=True):
            if end - start != block.sizes[0]:
                count = count_noun(end - start, "value")
                message = f"the row at y = {rest.strip()} has {count}, but the header states {block.sizes[0]}"
                self.findings.error(line, block.name, message)
                complete = False
        return complete

    def _numbers(self, block: DcmBlock, keyword: str) -> _Numbers | None:
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
            # `float` is faster, but reads 1_000 as a number
            values = np.array(list(map(parse_float if "_" in "".join(words) else float, words)), dtype=np.float64)
        except ValueError:
            values = np.array([np.nan])
        if np.isfinite(values).all():
            return _Numbers(values, begin or block.line, tuple(rows))
        self._report_wrong_numbers(block, keyword)
        return None

    def _report_wrong_numbers(self, block: DcmBlock, keyword: str) -> None:
        for line, key, rest in block.statements:
            for word in rest.split() if key == keyword else ():
                if not _is_number(word):
                    remedy = "Write a decimal point." if _is_number(word.replace(",", ".", 1)) else ""
                    self.findings.error(line, block.name, f"must be a finite number, got {word[:60]!r}", remedy, rest)

    def _axis_named(self, reference: str) -> Axis | None:
        r"""Return a group axis; ASCET refers to the axis `distrib` of a module as `distrib\Module`."""
        return self.axes.get(reference) or self.axes.get(reference.partition("\\")[0])

    def tie_items(self) -> dict[Key, Item]:
        """Return all items, tables with their group axes named, the texts of a label of one kind."""
        items = dict(self.items.items)
        for key, item in items.items():
            block = self.blocks[key]
            # Other kinds own their axes, whatever a comment states.
            if isinstance(item, Parameter) and block.keyword.startswith("GRUPPEN"):
                pairs = zip(item.axes, _AXES, strict=False)
                items[key] = item.changed(
                    axes=tuple(self._tie(block, axis, block.rest_of(names[3])) for axis, names in pairs)
                )
        return unify_text_kinds(items)

    def _tie(self, block: DcmBlock, axis: Axis, reference: str) -> Axis:
        if not reference:
            return axis
        group = self._axis_named(reference)
        if group is None:
            # the table states the breakpoints of an axis that the file lacks
            group = self.axes[reference] = axis.changed(name=reference)
        if not np.array_equal(group.breakpoints, axis.breakpoints):
            message = f"has other breakpoints than the group axis {group.name}; kept as an axis of its own"
            self.findings.warning(block.line, block.name, message)
            return axis
        return Axis(axis.breakpoints, unit=axis.unit or group.unit, name=group.name, falling=axis.falling)


def _is_number(word: str) -> bool:
    return isfinite(parse_float(word))
