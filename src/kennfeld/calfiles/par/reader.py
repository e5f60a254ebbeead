"""Converts the labels of a CANape parameter file to parameters in physical units.

The file holds numbers as the control unit stores them, and behind them their physical values, rounded to the digits
that CANape displays. If both agree, the exact number is read. With the A2L file of the control unit, the exact physical
values follow from its conversions, and units and descriptions are known.
"""

import re
from collections.abc import Mapping, Sequence
from math import isnan
from typing import Any

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_labels
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import ItemCollector, describe_fall, drop_trailing_ones, in_rising_order, turn
from kennfeld.calfiles.format import CalibrationSource, FileFindings, Item, ReadResult, build_set
from kennfeld.calfiles.par.conversions import Conversions, StoredQuantity, find_conversions, physical
from kennfeld.calfiles.par.lines import (
    AXES,
    ParLabel,
    ParNumber,
    displayed_value,
    is_hexadecimal,
    split_labels,
    version_of,
)
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Block, Parameter, parameter
from kennfeld.domain.texts import Text

_LIKE_A_NUMBER = re.compile(r"[-+]?[\d.,]+(?:[eE][-+]?\d+)?(?:\s.*)?")  # 1,5 or 1.5 bar, but not 2WD
_NO_VALUES = "skipped: the texts behind its numbers are not physical values"


@dataclass(frozen=True)
class Par:
    """A parameter file as read: its text, and its labels and items by name.

    `quantities` has the conversions that the A2L file states, by name and axis; the axis of values is empty.
    """

    source: CalibrationSource
    text: str
    labels: Mapping[str, ParLabel]
    items: Mapping[str, Item]
    quantities: Mapping[tuple[str, str], StoredQuantity]


def read_par(source: CalibrationSource) -> ReadResult:
    """Return the parameters of a CANape parameter file; raises `InputError` with all findings.

    `source.partner` is its A2L file, by default the one that its first line names, if it is in the same folder.
    """
    findings = FileFindings(source.name)
    lines = source.lines
    labels = split_labels(lines, findings)
    findings_before = findings.finish()
    own = FileFindings(source.name)
    reader = _ParReader(own, find_conversions(source, own))
    for label in labels:
        reader.take(label)
    reader.report()
    items = reader.items.items
    by_name = {name: item for (name, _), item in items.items()}
    origin = Par(source, "".join(lines), reader.labels, by_name, reader.quantities)
    warnings = (*findings_before, *reader.findings.finish())
    return ReadResult(f"CANape PAR {version_of(source.text)}", build_set(items, (), origin), warnings)


class _ParReader:
    def __init__(self, findings: FileFindings, conversions: Conversions | None) -> None:
        self.findings = findings
        self.conversions = conversions
        self.quantities: dict[tuple[str, str], StoredQuantity] = {}
        self.different: list[str] = []  # labels whose values do not fit the A2L file
        self.items = ItemCollector(findings)
        self.labels: dict[str, ParLabel] = {}
        self.raw: list[str] = []  # labels without physical values
        self.rounded: list[str] = []  # labels whose physical values are only known as displayed

    def take(self, label: ParLabel) -> None:
        self._find_quantities(label)
        item = self._text(label) or self._parameter(label)
        if item is not None and self.items.add(item, label.line):
            self.labels.setdefault(label.name, label)

    def _find_quantities(self, label: ParLabel) -> None:
        """Note the conversions of a label, unless they contradict the physical values in the file."""
        if self.conversions is None or label.type == "STRING":
            return
        quantities = {"": self.conversions.values(label.name)}
        quantities |= {letter: self.conversions.axis(label.name, letter) for letter in label.axes}
        for letter, quantity in quantities.items():
            numbers = label.axes[letter] if letter else label.values
            if quantity is not None and _fits(quantity, numbers):
                self.quantities[label.name, letter] = quantity
            elif quantity is not None:
                self.different.append(label.name)

    def _labels(self, label: ParLabel) -> dict[str, Any]:
        """Return the unit and the description of a label."""
        quantity = self.quantities.get((label.name, ""))
        if self.conversions is None or quantity is None:
            return {}
        return {"unit": quantity.unit, "description": self.conversions.description(label.name)}

    def _text(self, label: ParLabel) -> Text | None:
        if label.type == "STRING":
            codes = bytes(int(number.raw) for number in label.values)
            return Text(label.name, codes.partition(b"\0")[0].decode("latin-1"))
        word = label.values[0].physical
        if label.sizes or not label.is_integer or not word or not isnan(displayed_value(word)):
            return None
        is_known = (label.name, "") in self.quantities
        # `1,5` or `1.5 bar` is a number in another form, unless an A2L file states it as a word
        if _LIKE_A_NUMBER.fullmatch(word) and not is_known:
            return None
        return Text(label.name, word, kind="enumeration", **self._labels(label))

    def _parameter(self, label: ParLabel) -> Parameter | None:
        values = self._numbers(label, label.values, self.quantities.get((label.name, "")))
        labels = self._labels(label)
        if values is None:
            self.findings.warning(label.line, label.name, _NO_VALUES)
            return None
        shape = tuple(reversed(label.sizes))
        axes = [label.axes[letter] for letter in AXES[: len(shape)] if letter in label.axes]
        table = values.reshape(label.sizes).T
        # breakpoints of x, of x and y, or of all three
        is_complete = list(label.axes) and list(AXES[: len(axes)]) == sorted(label.axes)
        dropped = drop_trailing_ones(shape) if shape else ()
        if not axes:
            block = table.reshape(dropped)
            return Block(label.name, block, **labels) if shape else parameter(label.name, block, **labels)
        if not is_complete or len(axes) < len(dropped):
            message = "has breakpoints for some of its axes only, so it is read as a value block"
            self.findings.warning(label.line, label.name, message)
            return Block(label.name, table.reshape(dropped), **labels)
        return self._table(label, table.reshape(shape[: len(axes)]), axes)

    def _table(self, label: ParLabel, table: Float, axes: Sequence[Sequence[ParNumber]]) -> Parameter | None:
        directions = []
        for letter, numbers in zip(AXES, axes, strict=False):
            quantity = self.quantities.get((label.name, letter))
            points = self._numbers(label, numbers, quantity)
            rising, falls = (None, False) if points is None else in_rising_order(points)
            fall = "breakpoints that are words" if rising is None else describe_fall(rising)
            if rising is None or fall:
                self.findings.warning(label.line, label.name, f"skipped: axis {letter}: {fall}")
                return None
            words = (quantity.input, quantity.unit) if quantity else ()
            directions.append(Axis(rising, *words, falling=falls))
        return parameter(label.name, turn(table, directions), directions, **self._labels(label))

    def _numbers(self, label: ParLabel, numbers: Sequence[ParNumber], quantity: StoredQuantity | None) -> Float | None:
        """Return physical values; None if they are words."""
        if quantity is not None:
            words = quantity.conversion.words is not None
            return None if words else np.array([physical(quantity, number.raw) for number in numbers], dtype=np.float64)
        raw = np.array([number.raw for number in numbers], dtype=np.float64)
        texts = [number.physical for number in numbers]
        displayed = np.array([displayed_value(text) for text in texts])
        if not label.is_integer and np.isnan(displayed).any():
            return raw  # behind the number of a float stands a remark
        if not any(texts):
            self.raw.append(label.name)
            return raw
        if np.isnan(displayed).any():
            return None
        if agree(numbers):
            return raw
        self.rounded.append(label.name)
        return displayed

    def report(self) -> None:
        """Warn about values that are not, or not exactly, the physical ones."""
        if self.raw:
            message = "integers without physical values, read as the control unit stores them"
            remedy = (
                "Right only if their conversion is the identity; else save the file in CANape with physical values."
            )
            self.findings.warning(0, "", f"{message}: {count_labels(list(dict.fromkeys(self.raw)))}", remedy)
        if self.different:
            message = "the physical values do not follow from the A2L file, which is not used for"
            remedy = "Is it the A2L file of this program?"
            self.findings.warning(0, "", f"{message} {count_labels(list(dict.fromkeys(self.different)))}", remedy)
        if self.rounded:
            message = "physical values with the digits that CANape displays"
            self.findings.warning(0, "", f"{message}: {count_labels(list(dict.fromkeys(self.rounded)))}")


def _fits(quantity: StoredQuantity, numbers: Sequence[ParNumber]) -> bool:
    """Check whether the conversion gives the physical values in the file, up to the digits shown."""
    words = quantity.conversion.words
    for number in numbers:
        value, displayed = physical(quantity, number.raw), displayed_value(number.physical)
        if words is not None:
            fits = not number.physical or words.text(number.raw) == number.physical
        else:
            fits = value is not None and (isnan(displayed) or abs(value - displayed) <= _half_digit(number.physical))
        if not fits:
            return False
    return True


def agree(numbers: Sequence[ParNumber]) -> bool:
    """Check whether the physical values are the stored numbers, rounded to the digits shown."""
    return all(abs(number.raw - displayed_value(number.physical)) <= _half_digit(number.physical) for number in numbers)


def _half_digit(text: str) -> float:
    """Return half a unit of the last digit of a number.

    >>> _half_digit("1.25"), _half_digit("3e2")
    (0.005, 50.0)
    """
    if is_hexadecimal(text):
        return 0.5
    mantissa, _, exponent = text.lower().partition("e")
    power = int(exponent or 0) - len(mantissa.partition(".")[2])
    # a damaged exponent must not overflow
    return 0.5 * 10.0 ** max(min(power, 300), -300)
