"""Rewrites a DCM file with other numbers and keeps every other byte.

Comments, order, encoding, blank lines, unknown lines and the spelling of unchanged numbers are kept. Only a block whose
size changed is rewritten; removed parameters are deleted, new ones are appended.
"""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.calfiles.content import in_stored_order, replace_numbers, same_content, stored_like, turn
from kennfeld.calfiles.dcm.lines import DcmBlock
from kennfeld.calfiles.dcm.reader import Dcm, VariantValue, variant_values
from kennfeld.calfiles.dcm.writer import axis_block, check_storable, item_block, quote, shares_block, whole_text
from kennfeld.calfiles.format import Item, Key, WriteResult
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

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
    return WriteResult(origin.source.encoded("".join(_DcmUpdate(origin, parameters).lines())))


class _DcmUpdate:
    def __init__(self, dcm: Dcm, parameters: ParameterSet) -> None:
        self.dcm = dcm
        parameters = _in_order_of(parameters, dcm.axes)
        self.now: Mapping[Key, Item] = parameters.everything
        self.axes = {axis.name: axis for axis in parameters.axes}
        self.text = dcm.source.lines
        self.newline = (_line_end(self.text[0]) if self.text else "") or "\n"
        # What was never read stays, unless the set is only a part of the file.
        self.complete = dcm.items.keys() <= self.now.keys() and dcm.axes.keys() <= self.axes.keys()

    def lines(self) -> Iterator[str]:
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

    def _block(self, block: DcmBlock) -> Iterator[str]:
        key = self.dcm.keys.get(block.line)
        unchanged = self.text[block.line - 1 : block.end]
        if key is None:
            return iter(unchanged if self.complete else ())
        if block.keyword != "STUETZSTELLENVERTEILUNG":
            keys = [key, *((key[0], other.variant) for other in variant_values(block, self.dcm.criteria))]
            if all(key in self.now and _is_alike(self.now[key], self.dcm.items[key]) for key in keys):
                return iter(unchanged)
            return self._with_item(block, key) if key in self.now else iter(())
        axis, before = self.axes.get(key[0]), self.dcm.axes[key[0]]
        if axis is None:
            return iter(())
        own = self.dcm.block_axes[block.line]
        if len(before) != len(axis):
            return self._rewrite(block, axis_block(stored_like(axis, own[0])))
        return self._replace(block, {"ST/X": (turn(before.breakpoints, own), turn(axis.breakpoints, own))}, {})

    def _with_item(self, block: DcmBlock, key: Key) -> Iterator[str]:
        before, now = self.dcm.items[key], self.now[key]
        values = variant_values(block, self.dcm.criteria)
        if not _has_same_form(before, now) or any((key[0], value.variant) not in self.now for value in values):
            others = [item for item in self.now.values() if item.name == key[0] and shares_block(now, item)]
            # labels that the set lacks are those of the file
            labels = {label: getattr(now, label) or getattr(before, label) for label in ("description", *_EMPTY_LABELS)}
            now = replace(now, **labels) if isinstance(now, Text) else now.changed(**labels)
            own = self.dcm.block_axes.get(block.line, ())
            if isinstance(now, Parameter) and len(own) == len(now.axes):
                now = now.changed(axes=tuple(map(stored_like, now.axes, own)))
            return self._rewrite(block, item_block(now, others))
        texts = {value.line: self._variant_line(value.line, values, key[0]) for value in values}
        if now.description and now.description != before.description:
            texts |= self._description_line(block, now.description)
        numbers: dict[str, tuple[Float, Float]] = {}
        if isinstance(now, Text) and isinstance(before, Text):
            if now.text != before.text:
                line = _line_of(block, "TEXT")
                texts[line] = _replace_text(self.text[line - 1], now.text)
        elif isinstance(now, Parameter) and isinstance(before, Parameter):
            own = self.dcm.block_axes.get(block.line, ())
            (old, old_points), (new, new_points) = (in_stored_order(item, own) for item in (before, now))
            numbers = dict(zip(_AXES, zip(old_points, new_points, strict=True), strict=False))
            # row by row, as the file has them
            numbers["WERT"] = old.T.ravel(), new.T.ravel()
        return self._replace(block, numbers, texts)

    def _description_line(self, block: DcmBlock, description: str) -> dict[int, str]:
        """Return the line of the description, replaced or added below the block header."""
        line = _line_of(block, "LANGNAME")
        if line:
            return {line: _replace_text(self.text[line - 1], description)}
        first = self.text[block.line - 1]
        return {block.line: f"{first}   LANGNAME {quote(description)}{_line_end(first)}"}

    def _variant_line(self, number: int, values: Sequence[VariantValue], name: str) -> str:
        """Return the line with the values of other variants in a block of one value."""
        line = self.text[number - 1]
        rest = line.rstrip("\r\n").split(None, 1)[1]
        head = len(line.rstrip("\r\n")) - len(rest)
        for value in reversed([value for value in values if value.line == number]):  # from the end, so that starts stay
            now = self.now[name, value.variant]
            if not _is_alike(now, self.dcm.items[name, value.variant]):
                result = quote(now.text) if isinstance(now, Text) else _format_like(float(now.values), value.value)
                at = head + value.start
                line = line[:at] + result + line[at + len(value.value) :]
        return line

    def _replace(
        self, block: DcmBlock, numbers: Mapping[str, tuple[Float, Float]], texts: Mapping[int, str]
    ) -> Iterator[str]:
        """Yield the lines of a block with new numbers; `numbers` has the old and new ones by keyword."""
        done = dict.fromkeys(numbers, 0)
        result = dict(texts)
        for number, word, rest in block.statements:
            if word not in numbers:
                continue
            count, (before, now) = len(rest.split()), numbers[word]
            # the numbers of a keyword go on over its lines
            part = slice(done[word], done[word] + count)
            done[word] += count
            if not np.array_equal(before[part], now[part]):
                line = self.text[number - 1]
                end = len(line.rstrip("\r\n"))
                changed = replace_numbers(rest, before[part], now[part], _format_like)
                result[number] = line[: end - len(rest)] + changed + line[end:]
        for number in range(block.line, block.end + 1):
            yield result.get(number, self.text[number - 1])

    def _rewrite(self, block: DcmBlock, text: str) -> Iterator[str]:
        """Rewrite a block, keeping its comments and unknown lines."""
        known = {number for number, _, _ in block.statements}
        aside = [self.text[n - 1] for n in range(block.line + 1, block.end) if n not in known]
        *body, end = text.splitlines()
        yield from (line + self.newline for line in body)
        # the new text states the group axes itself
        yield from (line for line in aside if line.strip() and not _GROUP_AXIS.match(line))
        yield end + _line_end(self.text[block.end - 1])

    def _added(self) -> Iterator[str]:
        """Yield the blocks that the file did not have."""
        inside = {
            (key[0], value.variant)
            for block in self.dcm.blocks
            if (key := self.dcm.keys.get(block.line)) is not None
            for value in variant_values(block, self.dcm.criteria)
        }
        blocks = [item_block(item) for key, item in self.now.items() if key not in self.dcm.items and key not in inside]
        blocks += [
            axis_block(axis) for name, axis in self.axes.items() if name not in self.dcm.axes and " " not in name
        ]
        # a last line without its end must not run into a new block
        if blocks and self.text and not _line_end(self.text[-1]):
            yield self.newline
        for block in blocks:
            yield self.newline
            yield block.replace("\n", self.newline)


def _in_order_of(parameters: ParameterSet, axes: Mapping[str, Axis]) -> ParameterSet:
    """Return the set with group axes that fall where those of a file do."""
    groups = [stored_like(axis, axes.get(axis.name, axis)) for axis in parameters.axes]
    if all(axis.falling == before.falling for axis, before in zip(groups, parameters.axes, strict=True)):
        return parameters
    return ParameterSet(parameters.parameters, parameters.texts, groups, parameters.others)


def _line_end(line: str) -> str:
    """Return the line end as the file writes it; empty for a last line without one."""
    return line[len(line.rstrip("\r\n")) :]


def _line_of(block: DcmBlock, keyword: str) -> int:
    """Return the line of a keyword; 0 if it is not there."""
    return next((line for line, word, _ in block.statements if word == keyword), 0)


def _is_alike(now: Item, before: Item) -> bool:
    """Check whether a block needs no change; limits are not stored in DCM."""
    if now is before:
        return True
    described = now.description and now.description != before.description
    return not described and _has_same_form(before, now) and same_content(now, before)


def _has_same_form(before: Item, now: Item) -> bool:
    """Check whether only numbers or the text differ: same kind, size, units, group axes and labels."""
    if any(getattr(now, label) not in (getattr(before, label), empty) for label, empty in _EMPTY_LABELS.items()):
        return False
    if before.unit != now.unit:
        return False
    if isinstance(before, Text) or isinstance(now, Text):
        texts = isinstance(before, Text) and isinstance(now, Text)
        return texts and (before.kind == "text") == (now.kind == "text")  # others share one keyword
    if before.kind != now.kind or before.values.shape != now.values.shape:
        return False
    pairs = zip(before.axes, now.axes, strict=True)
    return all(axis.name == other.name and axis.unit == other.unit for axis, other in pairs)


def _format_like(value: float, like: str) -> str:
    """Format a number in its shortest exact form; without a point if it had none and is an integer."""
    return str(int(value)) if like.lstrip("+-").isdigit() and value == int(value) else repr(value)


def _replace_text(line: str, text: str) -> str:
    first, last = line.find('"'), line.rfind('"')
    if first < 0:
        word = _WORD.findall(line)[-1]
        first = line.rfind(word)
        last = first + len(word) - 1
    return f"{line[:first]}{quote(text)}{line[last + 1 :]}"
