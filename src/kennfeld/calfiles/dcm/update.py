"""Rewrites a DCM file with other numbers and keeps every other byte.

Comments, order, encoding, blank lines, unknown lines and the spelling of unchanged numbers are kept. Only a block whose
size changed is rewritten; removed parameters are deleted, new ones are appended.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.dcm.lines import DcmBlock as Lines
from kennfeld.calfiles.dcm.reader import Dcm, Key, VariantValue, variant_values
from kennfeld.calfiles.dcm.writer import axis_block, check_storable, item_block, quote, shares_block, whole_text
from kennfeld.calfiles.format import WriteResult
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

Item = Parameter | Text
_WORD = re.compile(r"\S+")
_AXES = ("ST/X", "ST/Y")
_EMPTY_LABELS: dict[str, object] = {"functions": (), "display_name": ""}  # a set without them leaves those of the file

_GROUP_AXIS = re.compile(r"\s*\*\s*SST")


def write_dcm(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the DCM file that a set was read from with its new values, or a new file.

    Raises `InputError` naming every parameter that DCM cannot store.
    """
    check_storable(parameters, file)
    origin = parameters.origin
    if not isinstance(origin, Dcm) or not origin.source.is_exact:
        return WriteResult(whole_text(parameters).encode("utf-8", errors="replace"))
    update = _DcmUpdate(origin, parameters)
    return WriteResult(origin.source.encoded("".join(update.lines())))


class _DcmUpdate:
    def __init__(self, dcm: Dcm, parameters: ParameterSet) -> None:
        self.dcm = dcm
        self.now: Mapping[Key, Item] = parameters.everything
        self.axes = {axis.name: axis for axis in parameters.axes}
        self.text = dcm.source.lines
        self.newline = (_line_end(self.text[0]) if self.text else "") or "\n"
        # What was never read stays, unless the set is a part of the file only.
        self.complete = dcm.items.keys() <= self.now.keys() and dcm.axes.keys() <= self.axes.keys()

    def lines(self) -> Iterator[str]:
        """Return the lines of the new file."""
        done = 0  # lines
        for block in self.dcm.blocks:
            yield from self.text[done : block.line - 1]
            done = block.end
            result = list(self._block(block))
            yield from result
            if not result and done < len(self.text) and not self.text[done].strip():
                done += 1  # the blank line that parted the block from the next one
        yield from self.text[done:]
        yield from self._added()

    def _block(self, block: Lines) -> Iterator[str]:
        key = self.dcm.keys.get(block.line)
        if key is None:
            stays = self.complete
        elif block.keyword == "STUETZSTELLENVERTEILUNG":
            axis = self.axes.get(key[0])
            stays = axis is not None
            if axis is not None and not np.array_equal(axis.breakpoints, self.dcm.axes[key[0]].breakpoints):
                yield from self._with_axis(block, axis)
                return
        else:
            stays = key in self.now
            if stays and not self._is_unchanged(block, key):
                yield from self._with_item(block, key)
                return
        if stays:
            yield from self.text[block.line - 1 : block.end]

    def _is_unchanged(self, block: Lines, key: Key) -> bool:
        keys = [key, *((key[0], one.variant) for one in variant_values(block, self.dcm.criteria))]
        return all(one in self.now and _alike(self.now[one], self.dcm.items[one]) for one in keys)

    def _with_axis(self, block: Lines, axis: Axis) -> Iterator[str]:
        before = self.dcm.axes[axis.name]
        if len(before) != len(axis):
            yield from self._anew(block, axis_block(axis))
        else:
            yield from self._replaced(block, {"ST/X": (before.breakpoints, axis.breakpoints)}, {})

    def _with_item(self, block: Lines, key: Key) -> Iterator[str]:
        before, now = self.dcm.items[key], self.now[key]
        values = variant_values(block, self.dcm.criteria)
        if not _has_same_form(before, now) or any((key[0], one.variant) not in self.now for one in values):
            others = [item for item in self.now.values() if item.name == key[0] and shares_block(now, item)]
            yield from self._anew(block, item_block(_with_kept_labels(before, now), others))
            return
        texts = {one.line: self._variant_line(one.line, values, key[0]) for one in values}
        if now.description and now.description != before.description:
            texts |= self._described(block, now.description)
        numbers = {}
        if isinstance(now, Text) and isinstance(before, Text):
            if now.text != before.text:
                line = _line_of(block, "TEXT")
                texts[line] = self._requoted(line, now.text)
        elif isinstance(now, Parameter) and isinstance(before, Parameter):
            numbers["WERT"] = (before.values.T.ravel(), now.values.T.ravel())
            for word, old, new in zip(_AXES, before.axes, now.axes, strict=False):
                numbers[word] = (old.breakpoints, new.breakpoints)
        yield from self._replaced(block, numbers, texts)

    def _described(self, block: Lines, description: str) -> dict[int, str]:
        """Return the line of the description, replaced or added below the block header."""
        line = _line_of(block, "LANGNAME")
        if line:
            return {line: self._requoted(line, description)}
        first = self.text[block.line - 1]
        return {block.line: f"{first}   LANGNAME {quote(description)}{_line_end(first)}"}

    def _requoted(self, number: int, text: str) -> str:
        return _replace_text(self.text[number - 1], text)

    def _variant_line(self, number: int, values: Sequence[VariantValue], name: str) -> str:
        """Return the line with the values of other variants in a block of one value."""
        line = self.text[number - 1]
        rest = line.rstrip("\r\n").split(None, 1)[1]
        head = len(line.rstrip("\r\n")) - len(rest)
        for one in sorted((one for one in values if one.line == number), key=lambda one: one.start, reverse=True):
            now = self.now[name, one.variant]
            if _alike(now, self.dcm.items[name, one.variant]):
                continue
            result = quote(now.text) if isinstance(now, Text) else _format_like(float(now.values), one.value)
            at = head + one.start
            line = line[:at] + result + line[at + len(one.value) :]
        return line

    def _replaced(
        self, block: Lines, numbers: Mapping[str, tuple[Float, Float]], texts: Mapping[int, str]
    ) -> Iterator[str]:
        """Yield the lines of a block with new numbers; `numbers` has the old and new ones by keyword."""
        done = dict.fromkeys(numbers, 0)
        result = dict(texts)
        for number, word, rest in block.statements:
            if word not in numbers:
                continue
            count, (before, now) = len(rest.split()), numbers[word]
            part = slice(done[word], done[word] + count)
            done[word] += count
            if not np.array_equal(before[part], now[part]):
                result[number] = _replace_numbers(
                    self.text[number - 1], rest, before[part].tolist(), now[part].tolist()
                )
        for number in range(block.line, block.end + 1):
            yield result.get(number, self.text[number - 1])

    def _anew(self, block: Lines, text: str) -> Iterator[str]:
        """Rewrite a block, keeping its comments and unknown lines."""
        known = {number for number, _, _ in block.statements}
        aside = [self.text[n - 1] for n in range(block.line + 1, block.end) if n not in known]
        *body, end = text.splitlines()
        yield from (line + self.newline for line in body)
        yield from (line for line in aside if line.strip() and not _GROUP_AXIS.match(line))
        yield end + _line_end(self.text[block.end - 1])

    def _added(self) -> Iterator[str]:
        """Yield the blocks that the file did not have."""
        inside = {
            (key[0], one.variant)
            for block in self.dcm.blocks
            if (key := self.dcm.keys.get(block.line)) is not None
            for one in variant_values(block, self.dcm.criteria)
        }
        blocks = [item_block(item) for key, item in self.now.items() if key not in self.dcm.items and key not in inside]
        blocks += [
            axis_block(axis) for name, axis in self.axes.items() if name not in self.dcm.axes and " " not in name
        ]
        if blocks and self.text and not _line_end(self.text[-1]):
            yield self.newline
        for block in blocks:
            yield self.newline
            yield block.replace("\n", self.newline)


def _line_end(line: str) -> str:
    """Return the line end as the file writes it; empty for a last line without one."""
    return line[len(line.rstrip("\r\n")) :]


def _line_of(block: Lines, keyword: str) -> int:
    """Return the line of a keyword; 0 if it is not there."""
    return next((line for line, word, _ in block.statements if word == keyword), 0)


def _alike(now: Item, before: Item) -> bool:
    """Check whether a block needs no change; limits are not stored in DCM."""
    if now is before:
        return True
    if not _has_same_form(before, now) or (now.description and now.description != before.description):
        return False
    if isinstance(now, Text) or isinstance(before, Text):
        return isinstance(now, Text) and isinstance(before, Text) and now.text == before.text
    return np.array_equal(now.values, before.values) and all(
        np.array_equal(one.breakpoints, other.breakpoints) for one, other in zip(now.axes, before.axes, strict=True)
    )


def _with_kept_labels(before: Item, now: Item) -> Item:
    """Return `now` with the labels of the file for those it lacks."""
    labels = {label: getattr(now, label) or getattr(before, label) for label in ("description", *_EMPTY_LABELS)}
    return replace(now, **labels) if isinstance(now, Text) else now.changed(**labels)


def _has_same_form(before: Item, now: Item) -> bool:
    """Check whether only numbers differ: same kind, size, units, group axes and labels."""
    if any(getattr(now, label) not in (getattr(before, label), _EMPTY_LABELS[label]) for label in _EMPTY_LABELS):
        return False
    if isinstance(before, Text) or isinstance(now, Text):
        return _has_same_text_form(before, now)
    if before.kind != now.kind or before.values.shape != now.values.shape or before.unit != now.unit:
        return False
    return all(
        one.name == other.name and one.unit == other.unit for one, other in zip(before.axes, now.axes, strict=True)
    )


def _has_same_text_form(before: Item, now: Item) -> bool:
    """Check whether only the text differs; enumerations and booleans share one keyword."""
    if not (isinstance(before, Text) and isinstance(now, Text)):
        return False
    return (before.kind == "text") == (now.kind == "text") and before.unit == now.unit


def _replace_numbers(line: str, rest: str, before: Sequence[float], now: Sequence[float]) -> str:
    """Replace numbers within a line; unchanged ones keep their spelling."""
    head = len(line.rstrip("\r\n")) - len(rest)
    pieces, done = [line[:head]], 0
    for found, old, new in zip(_WORD.finditer(rest), before, now, strict=True):
        pieces.append(rest[done : found.start()])
        pieces.append(found[0] if old == new else _format_like(new, found[0]))
        done = found.end()
    return "".join([*pieces, rest[done:], line[head + len(rest) :]])


def _format_like(value: float, like: str) -> str:
    """Format a number in its shortest exact form; without a point if it had none and is an integer."""
    return str(int(value)) if like.lstrip("+-").isdigit() and value == int(value) else repr(value)


def _replace_text(line: str, text: str) -> str:
    """Replace the quoted text of a line."""
    first, last = line.find('"'), line.rfind('"')
    if first < 0:
        word = _WORD.findall(line)[-1]
        first = line.rfind(word)
        last = first + len(word) - 1
    return f"{line[:first]}{quote(text)}{line[last + 1 :]}"
