"""Numbers, breakpoints, sizes and repeated definitions in files, as several formats treat them."""

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import field
from math import nan
from typing import AnyStr

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.format import FileFindings, Item, Key
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text


@dataclass
class ItemCollector:
    """Items by name and variant; a label is a text or a number in all its variants, and the same if it is repeated."""

    findings: FileFindings
    items: dict[Key, Item] = field(default_factory=dict)
    lines: dict[Key, int] = field(default_factory=dict)
    first: dict[str, Key] = field(default_factory=dict)  # of each label

    def add(self, item: Item, line: int) -> bool:
        """Add an item that begins in a line; False if it contradicts an earlier one of its name, with an error."""
        key, is_text = (item.name, item.variant), isinstance(item, Text)
        first = self.first.setdefault(item.name, key)
        if is_text != isinstance(self.items.get(first, item), Text):
            self.report_repetition(item.name, line, self.lines[first], "as a text" if is_text else "as a number")
            return False
        known = self.items.setdefault(key, item)
        before = self.lines.setdefault(key, line)
        if not same_content(known, item):
            self.report_repetition(item.name, line, before, "with another text" if is_text else "with other values")
        return True

    def report_repetition(self, name: str, line: int, before: int, difference: str) -> None:
        """Add an error on a name that is already defined in another line."""
        message = f"{name} is already defined in line {before}, {difference}"
        self.findings.error(line, name, message, "Keep one of the two.")


def same_content(first: Item, second: Item) -> bool:
    """Check whether two definitions of a label have the same text, or the same kind, values and breakpoints."""
    if isinstance(first, Text) or isinstance(second, Text):
        return isinstance(first, Text) and isinstance(second, Text) and first.text == second.text
    return first.has_grid_of(second) and np.array_equal(first.values, second.values)


def drop_trailing_ones(sizes: tuple[int, ...]) -> tuple[int, ...]:
    """Drop trailing ones of a shape, which tools append; (3, 1) and (3,) are equal."""
    while len(sizes) > 1 and sizes[-1] == 1:
        sizes = sizes[:-1]
    return sizes


def in_rising_order(points: Float) -> tuple[Float, bool]:
    """Reverse breakpoints, Float[points], that fall, and return True with them; others stay as they are.

    >>> in_rising_order(np.array([-130.0, -140.0]))[0].tolist()
    [-140.0, -130.0]
    """
    falls = points.size > 1 and bool(np.all(points[1:] < points[:-1]))
    return (points[::-1], True) if falls else (points, False)


def turn(values: Float, axes: Sequence[Axis]) -> Float:
    """Convert values, Float[x, y, ...], between the rising order of breakpoints and that of a file, either way.

    >>> turn(np.array([1.0, 2.0]), [Axis([0, 1], falling=True)]).tolist()
    [2.0, 1.0]
    """
    falling = tuple(direction for direction, axis in enumerate(axes) if axis.falling)
    return np.flip(values, falling) if falling else values


def stored_breakpoints(axis: Axis) -> Float:
    """Return the breakpoints, Float[points], as files store them: of a falling axis from the greatest to the least."""
    return turn(axis.breakpoints, (axis,))


def in_stored_order(member: Parameter, axes: Sequence[Axis] | None = None) -> tuple[Float, list[Float]]:
    """Return the values of a parameter, Float[x, y, ...], and the breakpoints of each axis, as files store them.

    Args:
        member: The parameter.
        axes: The axes of the file to be updated, which may fall where those of the parameter rise; by default those of
            the parameter.

    >>> from kennfeld.domain.parameters import Curve
    >>> in_stored_order(Curve("C", Axis([0, 1], falling=True), [5, 6]))
    (array([6., 5.]), [array([1., 0.])])
    """
    stored = member.axes if axes is None else axes
    points = [turn(axis.breakpoints, (like,)) for axis, like in zip(member.axes, stored, strict=True)]
    return turn(member.values, stored), points


def stored_like(axis: Axis, known: Axis) -> Axis:
    """Return the axis as one that falls in files if a known one does; a single breakpoint has no order to be kept."""
    return axis if axis.falling == known.falling or len(known) == 1 else axis.changed(falling=known.falling)


def describe_fall(points: Float) -> str:
    """Describe the first of breakpoints, Float[points], that is not above the one before; empty if they increase."""
    for at in np.flatnonzero(points[1:] <= points[:-1]):
        return f"breakpoint {at + 2} ({points[at + 1]:g}) does not exceed breakpoint {at + 1} ({points[at]:g})"
    return ""


def parse_float(word: str) -> float:
    """Return the number that a word states; NaN for any other word, and for 1_000, which Python accepts."""
    try:
        return nan if "_" in word else float(word)
    except ValueError:
        return nan


def replace_numbers(text: str, before: Float, now: Float, write: Callable[[float, str], str]) -> str:
    """Replace the numbers in a text; unchanged ones keep their spelling.

    Args:
        text: Numbers separated by blanks.
        before: The numbers in the text, Float[numbers].
        now: Those that take their place, Float[numbers].
        write: Returns the text of a number, given also the word that it replaces.

    >>> replace_numbers("1.0  2", np.array([1.0, 2.0]), np.array([1.0, 3.0]), lambda number, word: f"{number:g}")
    '1.0  3'
    """
    pairs = iter(zip(before.tolist(), now.tolist(), strict=True))

    def replace(match: re.Match[str]) -> str:
        old, new = next(pairs)
        return match[0] if old == new else write(new, match[0])

    return re.sub(r"\S+", replace, text)


def replace_spans(text: AnyStr, spans: Mapping[tuple[int, int], AnyStr]) -> AnyStr:
    """Replace parts of a text, by begin and end.

    >>> replace_spans("K = 1, L = 2", {(11, 12): "30", (4, 5): "-1"})
    'K = -1, L = 30'
    """
    pieces: list[AnyStr] = []
    done = 0
    for (begin, end), new in sorted(spans.items()):
        pieces += [text[done:begin], new]
        done = end
    pieces.append(text[done:])
    return text[:0].join(pieces)
