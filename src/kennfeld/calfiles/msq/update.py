"""A tune with other numbers: every character that says something else stays as it is."""

import re
from html import escape

import numpy as np

from kennfeld.arrays import Float
from kennfeld.calfiles.format import Findings, WriteResult
from kennfeld.calfiles.msq.reader import Constant, Msq
from kennfeld.formatting import count_noun, holds_control_characters, join_limited
from kennfeld.parameter_set import ParameterSet
from kennfeld.parameters import Axis, Parameter, Text

__all__ = []

_WORD = re.compile(r"\S+")


def write_msq(parameters: ParameterSet, file: str) -> WriteResult:
    """The tune that a set was read from, with the numbers and words of the set.

    Numbers are rounded to the digits of their constant, which is told. Raises `InputError` where the set was not read
    from a tune, and for each parameter that the tune has not, or has in another size.
    """
    notes = Findings(file)
    tune = parameters.origin
    if not isinstance(tune, Msq) or not tune.source.is_exact:
        message = "a tune is written into the one it was read from, and this set was read from another format"
        notes.error(0, "", message, "Merge the set into the tune: kennfeld merge tune.msq new.dcm -o new.msq")
        notes.settle()
    assert isinstance(tune, Msq)
    update = _MsqUpdate(tune, notes)
    for thing in parameters.chosen:
        update.take(thing)
    for axis in parameters.axes:
        update.take_axis(axis)
    for thing in parameters.others:
        notes.error(0, thing.name, f"has the variant {thing.variant!r}, a tune has none", "Choose one of the variants.")
    update.tell_units()
    remarks = notes.settle()
    return WriteResult(tune.source.encoded(update.text()), remarks)


class _MsqUpdate:
    def __init__(self, tune: Msq, notes: Findings) -> None:
        self.tune = tune
        self.notes = notes
        self.contents: dict[str, str] = {}
        self.units: list[str] = []  # labels in another unit than in the tune

    def text(self) -> str:
        """The characters of the new file."""
        pieces, done = [], 0
        for name, constant in self.tune.constants.items():
            if name in self.contents:
                pieces += [self.tune.text[done : constant.begin], self.contents[name]]
                done = constant.begin + len(constant.content)
        return "".join([*pieces, self.tune.text[done:]])

    def tell_units(self) -> None:
        """Numbers in another unit than that of the tune would be wrong; that is for a person to decide."""
        if self.units:
            message = f"{join_limited(self.units)} in another unit than in the tune, written as they are"
            self.notes.remark(0, "", message, "See whether that is meant.")

    def take(self, thing: Parameter | Text) -> None:
        """Put one parameter or text into its constant."""
        before = self.tune.things.get(thing.name)
        if before is None:
            remedy = (
                "Leave it out." if thing.name not in self.tune.constants else "It is the axis of a table in the tune."
            )
            self.notes.error(0, thing.name, "is no parameter of the tune", remedy)
        elif isinstance(thing, Text) or isinstance(before, Text):
            self._take_text(thing, before)
        elif thing.kind != before.kind or thing.values.shape != before.values.shape:
            found, wanted = (f"{one.kind} {' x '.join(map(str, one.values.shape))}".strip() for one in (thing, before))
            self.notes.error(0, thing.name, f"is a {found}, in the tune a {wanted}", "Sizes are fixed by the firmware.")
        else:
            if thing.unit and before.unit and thing.unit != before.unit:
                self.units.append(thing.name)
            self._take_axes(thing, before)
            self._numbers(self.tune.constants[thing.name], before.values.T.ravel(), thing.values.T.ravel())

    def _take_text(self, thing: Parameter | Text, before: Parameter | Text) -> None:
        if not isinstance(thing, Text) or not isinstance(before, Text):
            self.notes.error(0, thing.name, "is a text on one side and a number on the other")
            return
        if thing.kind != before.kind:
            self.notes.remark(0, thing.name, f"is of the kind {thing.kind} here, {before.kind} in the tune")
        if thing.text != before.text:
            if holds_control_characters(thing.text) or '"' in thing.text:
                self.notes.error(0, thing.name, f"{thing.text[:60]!r} cannot be a word in a tune")
            content = self.tune.constants[thing.name].content
            first, last = content.find('"'), content.rfind('"')
            head, tail = (content[: first + 1], content[last:]) if first < last else ("", "")
            self.contents[thing.name] = f"{head}{escape(thing.text, quote=False)}{tail}"

    def _take_axes(self, thing: Parameter, before: Parameter) -> None:
        for now, known in zip(thing.axes, before.axes, strict=True):
            if now.name != known.name and not np.array_equal(now.breakpoints, known.breakpoints):
                message = f"has an axis of its own with other breakpoints than {known.name}, which the tune gives it"
                self.notes.error(0, thing.name, message, f"Change the group axis {known.name}.")

    def take_axis(self, axis: Axis) -> None:
        """Put the breakpoints of a group axis into their constant."""
        before = self.tune.axes.get(axis.name)
        if before is None or len(before) != len(axis):
            message = (
                "is no axis of the tune"
                if before is None
                else f"has {len(axis)} breakpoints, {len(before)} in the tune"
            )
            self.notes.error(0, axis.name, message, "Sizes are fixed by the firmware.")
            return
        made = self._numbers(self.tune.constants[axis.name], before.breakpoints, axis.breakpoints)
        if np.any(np.diff(made) <= 0):
            digits = self.tune.constants[axis.name].digits
            message = (
                f"does not increase any more when rounded to {count_noun(digits or 0, 'digit')}, as the tune stores it"
            )
            self.notes.error(0, axis.name, message, "Move its breakpoints apart.")

    def _numbers(self, constant: Constant, before: Float, now: Float) -> Float:
        """Write what changed into the places of the old numbers; gives the numbers as they are rounded."""
        if not np.isfinite(now).all():
            self.notes.error(0, constant.name, "a tune cannot hold values that are not finite")
            return before
        rounded = now if constant.digits is None else np.array([round(v, constant.digits) for v in now.tolist()])
        rounded = np.where(now == before, before, rounded)
        if np.array_equal(rounded, before):
            self._tell_rounded(constant, rounded, now)
            return before
        pieces, done = [], 0
        for found, old, new in zip(_WORD.finditer(constant.content), before.tolist(), rounded.tolist(), strict=True):
            pieces += [constant.content[done : found.start()], found[0] if old == new else repr(new + 0.0)]
            done = found.end()
        self.contents[constant.name] = "".join([*pieces, constant.content[done:]])
        self._tell_rounded(constant, rounded, now)
        return rounded

    def _tell_rounded(self, constant: Constant, rounded: Float, now: Float) -> None:
        difference = float(np.abs(rounded - now).max(initial=0.0))
        if difference > 1e-9 * max(1.0, float(np.abs(now).max(initial=0.0))):
            digits = count_noun(constant.digits or 0, "digit")
            message = f"rounded to {digits}, as the tune stores it, by at most {difference:.3g}"
            self.notes.remark(0, constant.name, message)
