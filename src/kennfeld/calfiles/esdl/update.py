"""Rewrites an ESDL file with other numbers and keeps every other character."""

from collections.abc import Sequence

import numpy as np

from kennfeld.ascet import syntax as e
from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_labels
from kennfeld.calfiles.content import in_stored_order, replace_spans, turn
from kennfeld.calfiles.esdl.reader import EsdlOrigin, EsdlValue, Number
from kennfeld.calfiles.format import FileFindings, WriteResult
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter


def write_esdl(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the ESDL file that a set was read from, with the numbers of the set.

    Parameters of other files are left out, with a warning. Raises `InputError` if the set was not read from an ESDL
    file, or if a table has another size.
    """
    findings = FileFindings(file)
    origin = parameters.origin
    if not isinstance(origin, EsdlOrigin) or not origin.source.is_exact:
        message = "an ESDL file can only be written over the one it was read from, but this set is from another file"
        remedy = "Name the .esdl file first under initial, or merge: kennfeld merge Class.esdl new.dcm -o New.esdl"
        findings.error(0, "", message, remedy)
        findings.finish()
    assert isinstance(origin, EsdlOrigin)
    update = _EsdlUpdate(origin, findings)
    for member in parameters.parameters:
        update.take(member)
    for axis in parameters.axes:
        if axis.name in origin.axes:
            own = origin.axes[axis.name]
            update.replace(axis.name, own.points, turn(axis.breakpoints, (own.axis,)))
    if update.others:
        findings.warning(0, "", f"left out, since the file does not have them: {count_labels(update.others)}")
    return WriteResult(origin.source.encoded(update.text()), findings.finish())


class _EsdlUpdate:
    def __init__(self, origin: EsdlOrigin, findings: FileFindings) -> None:
        self.origin, self.findings = origin, findings
        self.changes: dict[tuple[int, int], str] = {}  # by begin and end
        self.others: list[str] = []

    def text(self) -> str:
        return replace_spans(self.origin.text, self.changes)

    def take(self, member: Parameter) -> None:
        """Take the numbers of a parameter."""
        item = self.origin.item(member.name)
        if item is None:
            if not any(short in self.origin.axes for short in self.origin.short_names(member.name)):
                self.others.append(member.name)
        elif member.kind != item.parameter.kind or member.values.shape != item.parameter.values.shape:
            shapes = (f"{p.kind} {' x '.join(map(str, p.values.shape))}".strip() for p in (member, item.parameter))
            message = "is a {}, but a {} in the file".format(*shapes)
            self.findings.error(0, member.name, message, "Keep the size of the table, or write another format.")
        else:
            self._take_numbers(member, item)

    def _take_numbers(self, member: Parameter, item: EsdlValue) -> None:
        values, points = in_stored_order(member, item.parameter.axes)
        self.replace(member.name, item.values, values.ravel())
        # tables over shared axes have no breakpoints in their text
        for trees, breakpoints in zip(item.axes, points, strict=False):
            self.replace(member.name, trees, breakpoints)

    def replace(self, name: str, trees: Sequence[Number], numbers: Float) -> None:
        """Replace the numbers that changed."""
        if len(trees) != numbers.size or not np.all(np.isfinite(numbers)):
            self.findings.error(0, name, "has other sizes than in the file, or values that are not finite")
            return
        for tree, number in zip(trees, numbers.tolist(), strict=True):
            begin, end, text, value = _span(tree)
            if number != value:
                self.changes[begin, end] = _format_like(number, tree, text)


def _span(tree: Number) -> tuple[int, int, str, float]:
    """Return begin, end, text and value of a number."""
    if isinstance(tree, e.Unary):
        assert isinstance(tree.operand, e.Number)
        _, end, text, value = _span(tree.operand)
        return tree.place.offset, end, text, -value if tree.operator == "-" else value
    begin = tree.place.offset
    return begin, begin + len(tree.text), tree.text, float(tree.value)


def _format_like(number: float, tree: Number, text: str) -> str:
    """Format a number in its shortest exact form; truth values and integers stay such if they can."""
    if isinstance(tree, e.Truth):
        return "true" if number else "false"
    is_real = isinstance(tree, e.Number) and tree.is_real
    is_real = is_real or (isinstance(tree, e.Unary) and isinstance(tree.operand, e.Number) and tree.operand.is_real)
    if not is_real and number == int(number):
        return str(int(number))
    # a real number has a point, before an exponent as well
    mantissa, exponent, power = repr(number).partition("e")
    return f"{mantissa}{'' if '.' in mantissa else '.0'}{exponent}{power}"
