"""Converts the labels of a CANape parameter file to parameters in physical units.

The file holds numbers as the control unit stores them, and behind them their physical values, rounded to the digits
that CANape displays. If both agree, the exact number is read. Conversions, units and group axes are in the A2L file,
which is not read.
"""

from collections.abc import Mapping, Sequence
from math import isnan

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.content import ItemCollector, describe_fall, drop_trailing_ones, parse_float
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, ReadResult, build_set
from kennfeld.calfiles.par.lines import AXES, ParLabel, ParNumber, split_labels, version_of
from kennfeld.formatting import count_labels
from kennfeld.lazy_dataclass import dataclass
from kennfeld.parameters import Axis, Block, Parameter, Text, parameter


@dataclass(frozen=True)
class Par:
    """A parameter file as read: its text, and its labels and items by name."""

    source: CalibrationSource
    text: str
    labels: Mapping[str, ParLabel]
    items: Mapping[str, Item]


def read_par(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a CANape parameter file; raises `InputError` with all findings."""
    findings = FileFindings(source.name)
    lines = source.lines
    labels = split_labels(lines, findings)
    findings_before = findings.finish()
    reader = _ParReader(FileFindings(source.name))
    for label in labels:
        reader.take(label)
    reader.report()
    items = reader.items.items
    origin = Par(source, "".join(lines), reader.labels, {name: item for (name, _), item in items.items()})
    warnings = (*findings_before, *reader.findings.finish())
    return ReadResult(f"CANape PAR {version_of(source.text)}", build_set(items, (), origin), warnings)


class _ParReader:
    def __init__(self, findings: FileFindings) -> None:
        self.findings = findings
        self.items = ItemCollector(findings)
        self.labels: dict[str, ParLabel] = {}
        self.raw: list[str] = []  # labels without physical values
        self.rounded: list[str] = []  # labels whose physical values are only known as displayed

    def take(self, label: ParLabel) -> None:
        item = self._text(label) or self._parameter(label)
        if item is not None and self.items.add(item, label.line):
            self.labels.setdefault(label.name, label)

    def _text(self, label: ParLabel) -> Text | None:
        if label.type == "STRING":
            codes = bytes(int(number.raw) for number in label.values)
            return Text(label.name, codes.partition(b"\0")[0].decode("latin-1"))
        word = label.values[0].physical
        if label.sizes or not label.is_integer or not word or not isnan(parse_float(word)):
            return None
        return Text(label.name, word, kind="enumeration")

    def _parameter(self, label: ParLabel) -> Parameter | None:
        values = self._numbers(label, label.values)
        if values is None:
            self.findings.warning(label.line, label.name, "skipped: a block or table of words")
            return None
        shape = tuple(reversed(label.sizes))
        axes = [label.axes[letter] for letter in AXES[: len(shape)] if letter in label.axes]
        table = values.reshape(label.sizes).T
        is_complete = list(label.axes) and list(AXES[: len(axes)]) == sorted(label.axes)
        dropped = drop_trailing_ones(shape) if shape else ()
        if not axes:
            block = table.reshape(dropped)
            return Block(label.name, block) if shape else parameter(label.name, block)
        if not is_complete or len(axes) < len(dropped):
            message = "has breakpoints for some of its axes only, so it is read as a value block"
            self.findings.warning(label.line, label.name, message)
            return Block(label.name, table.reshape(dropped))
        return self._table(label, table.reshape(shape[: len(axes)]), axes)

    def _table(self, label: ParLabel, table: Float, axes: Sequence[Sequence[ParNumber]]) -> Parameter | None:
        points = [self._numbers(label, numbers) for numbers in axes]
        for letter, breakpoints in zip(AXES, points, strict=False):
            fall = "breakpoints that are words" if breakpoints is None else describe_fall(breakpoints)
            if fall or breakpoints is None:
                self.findings.warning(label.line, label.name, f"skipped: axis {letter}: {fall}")
                return None
        return parameter(label.name, table, [Axis(breakpoints) for breakpoints in points if breakpoints is not None])

    def _numbers(self, label: ParLabel, numbers: Sequence[ParNumber]) -> Float | None:
        """Return physical values; None if they are words."""
        raw = np.array([number.raw for number in numbers], dtype=np.float64)
        texts = [number.physical for number in numbers]
        physical = np.array([parse_float(text) for text in texts])
        if not label.is_integer and np.isnan(physical).any():
            return raw  # behind the number of a float stands a remark
        if not any(texts):
            self.raw.append(label.name)
            return raw
        if np.isnan(physical).any():
            return None
        if agree(numbers):
            return raw
        self.rounded.append(label.name)
        return physical

    def report(self) -> None:
        """Warn about values that are not, or not exactly, the physical ones."""
        if self.raw:
            message = "integers without physical values, read as the control unit stores them"
            remedy = (
                "Right only if their conversion is the identity; else save the file in CANape with physical values."
            )
            self.findings.warning(0, "", f"{message}: {count_labels(list(dict.fromkeys(self.raw)))}", remedy)
        if self.rounded:
            message = "physical values with the digits that CANape displays"
            self.findings.warning(0, "", f"{message}: {count_labels(list(dict.fromkeys(self.rounded)))}")


def agree(numbers: Sequence[ParNumber]) -> bool:
    """Check whether the physical values are the stored numbers, rounded to the digits shown."""
    return all(abs(number.raw - parse_float(number.physical)) <= _half_digit(number.physical) for number in numbers)


def _half_digit(text: str) -> float:
    """Return half a unit of the last digit of a number.

    >>> _half_digit("1.25"), _half_digit("3e2")
    (0.005, 50.0)
    """
    mantissa, _, exponent = text.lower().partition("e")
    power = int(exponent or 0) - len(mantissa.partition(".")[2])
    return 0.5 * 10.0 ** max(min(power, 300), -300)
