"""Rewrites a tune with other numbers and keeps every other character."""

from html import escape

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_labels, count_noun, holds_control_characters
from kennfeld.calfiles.content import in_stored_order, replace_numbers, replace_spans, turn
from kennfeld.calfiles.format import FileFindings, Item, WriteResult
from kennfeld.calfiles.msq.reader import Msq, TuneConstant
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.texts import Text


def write_msq(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the tune that a set was read from, with the numbers and words of the set.

    Numbers are rounded to the digits of their constant, with a warning. Raises `InputError` if the set was not read
    from a tune, and for each parameter that the tune has not, or has in another size.
    """
    findings = FileFindings(file)
    tune = parameters.origin
    if not isinstance(tune, Msq) or not tune.source.is_exact:
        message = "a tune can only be written over the tune it was read from, but this set was read from another format"
        findings.error(0, "", message, "Merge the set into the tune: kennfeld merge tune.msq new.dcm -o new.msq")
        findings.finish()
    assert isinstance(tune, Msq)
    update = _MsqUpdate(tune, findings)
    for item in parameters.chosen:
        update.take(item)
    for axis in parameters.axes:
        update.take_axis(axis)
    for item in parameters.others:
        message = f"has the variant {item.variant!r}, but a tune has no variants"
        findings.error(0, item.name, message, "Choose one of the variants.")
    if update.units:
        message = f"written without conversion, since the tune has another unit: {count_labels(update.units)}"
        findings.warning(0, "", message, "Check that this is intended.")
    return WriteResult(tune.source.encoded(update.text()), findings.finish())


class _MsqUpdate:
    def __init__(self, tune: Msq, findings: FileFindings) -> None:
        self.tune = tune
        self.findings = findings
        self.contents: dict[str, str] = {}
        self.units: list[str] = []  # labels in another unit than in the tune

    def text(self) -> str:
        spans = {}
        for name, content in self.contents.items():
            constant = self.tune.constants[name]
            spans[constant.begin, constant.begin + len(constant.content)] = content
        return replace_spans(self.tune.text, spans)

    def take(self, item: Item) -> None:
        before = self.tune.items.get(item.name)
        if before is None:
            is_axis = item.name in self.tune.constants
            remedy = "It is the axis of a table in the tune." if is_axis else "Leave it out."
            self.findings.error(0, item.name, "is not a parameter of the tune", remedy)
        elif isinstance(item, Text) or isinstance(before, Text):
            self._take_text(item, before)
        elif item.kind != before.kind or item.values.shape != before.values.shape:
            kinds = (f"{member.kind} {' x '.join(map(str, member.values.shape))}".strip() for member in (item, before))
            message = "is a {}, but a {} in the tune".format(*kinds)
            self.findings.error(0, item.name, message, "Sizes are fixed by the firmware.")
        else:
            if item.unit and before.unit and item.unit != before.unit:
                self.units.append(item.name)
            for axis, known in zip(item.axes, before.axes, strict=True):
                if axis.name != known.name and not np.array_equal(axis.breakpoints, known.breakpoints):
                    message = f"has its own axis, whose breakpoints differ from {known.name} in the tune"
                    self.findings.error(0, item.name, message, f"Change the group axis {known.name}.")
            # a row for each y, as in the file
            old, new = (in_stored_order(each, before.axes)[0].T.ravel() for each in (before, item))
            self._numbers(self.tune.constants[item.name], old, new)

    def _take_text(self, item: Item, before: Item) -> None:
        if not isinstance(item, Text) or not isinstance(before, Text):
            self.findings.error(0, item.name, "is a text in one file and a number in the other")
            return
        if item.kind != before.kind:
            self.findings.warning(0, item.name, f"is of kind {item.kind}, but {before.kind} in the tune")
        if item.text != before.text:
            if holds_control_characters(item.text) or '"' in item.text:
                self.findings.error(0, item.name, f"{item.text[:60]!r} is not a valid word in a tune")
            content = self.tune.constants[item.name].content
            first, last = content.find('"'), content.rfind('"')
            head, tail = (content[: first + 1], content[last:]) if first < last else ("", "")
            self.contents[item.name] = f"{head}{escape(item.text, quote=False)}{tail}"

    def take_axis(self, axis: Axis) -> None:
        before = self.tune.axes.get(axis.name)
        if before is None or len(before) != len(axis):
            message = "is not an axis of the tune"
            if before is not None:
                message = f"has {len(axis)} breakpoints, but {len(before)} in the tune"
            self.findings.error(0, axis.name, message, "Sizes are fixed by the firmware.")
            return
        old, new = (turn(each.breakpoints, (before,)) for each in (before, axis))
        result = self._numbers(self.tune.constants[axis.name], old, new)
        if np.any(np.diff(turn(result, (before,))) <= 0):
            rounded = f"rounding to {count_noun(self.tune.constants[axis.name].digits or 0, 'digit')}"
            message = f"is not strictly {'decreasing' if before.falling else 'increasing'} after {rounded}, as stored"
            self.findings.error(0, axis.name, message, "Increase the distance of its breakpoints.")

    def _numbers(self, constant: TuneConstant, before: Float, now: Float) -> Float:
        """Replace changed numbers in place; return the values as rounded."""
        if not np.isfinite(now).all():
            self.findings.error(0, constant.name, "a tune cannot store non-finite values")
            return before
        rounded = now if constant.digits is None else np.array([round(v, constant.digits) for v in now.tolist()])
        # an unchanged number keeps digits beyond those that its constant states
        rounded = np.where(now == before, before, rounded)
        if not np.array_equal(rounded, before):
            # + 0.0 makes 0.0 of the -0.0 that rounding may leave
            content = replace_numbers(constant.content, before, rounded, lambda number, _: repr(number + 0.0))
            self.contents[constant.name] = content
        difference = float(np.abs(rounded - now).max(initial=0.0))
        if difference > 1e-9 * max(1.0, float(np.abs(now).max(initial=0.0))):
            digits = count_noun(constant.digits or 0, "digit")
            message = f"rounded to {digits}, as the tune stores it; the largest change is {difference:.3g}"
            self.findings.warning(0, constant.name, message)
        return rounded
