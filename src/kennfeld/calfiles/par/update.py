"""Rewrites a CANape parameter file with other numbers and keeps every other character.

A parameter file holds numbers as the control unit stores them. Labels whose stored and physical values are the same can
change, others only with the conversions of the A2L file.
"""

from collections.abc import Sequence

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_labels
from kennfeld.calfiles.content import in_stored_order, replace_spans
from kennfeld.calfiles.format import FileFindings, WriteResult
from kennfeld.calfiles.par.conversions import StoredQuantity, physical, stored
from kennfeld.calfiles.par.lines import AXES, ParLabel, ParNumber, displayed_value, is_hexadecimal
from kennfeld.calfiles.par.reader import Par, agree
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

_OTHER_FORMAT = "Write DCM or CDFX, and load it in CANape."
_TINY = 1e-12  # relative rounding of a conversion
_GIVE_A2L = "Put the A2L file beside it under the name in its first line, or give it with --a2l."


def write_par(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the parameter file that a set was read from, with the numbers and texts of the set.

    Labels of other files are left out, with a warning. Raises `InputError` if the set was not read from a parameter
    file, or for values that the file cannot take.
    """
    findings = FileFindings(file)
    par = parameters.origin
    if not isinstance(par, Par) or not par.source.is_exact:
        message = (
            "a CANape parameter file can only be written over the one it was read from, since it holds the numbers"
        )
        remedy = "Merge the set into the file: kennfeld merge base.par new.dcm -o new.par"
        findings.error(0, "", f"{message} of the control unit, and this set was read from another file", remedy)
        findings.finish()
    assert isinstance(par, Par)
    update = _ParUpdate(par, findings)
    for item in parameters.chosen:
        update.take(item)
    for item in parameters.others:
        message = f"has the variant {item.variant!r}, but a parameter file has no variants"
        findings.error(0, item.name, message, "Choose one of the variants.")
    update.report()
    return WriteResult(par.source.encoded(update.text()), findings.finish())


class _ParUpdate:
    def __init__(self, par: Par, findings: FileFindings) -> None:
        self.par, self.findings = par, findings
        self.changes: dict[int, tuple[int, str]] = {}  # by begin: length of the old text, the new one
        self.others: list[str] = []
        self.rounding: dict[str, float] = {}

    def text(self) -> str:
        spans = {(begin, begin + length): word for begin, (length, word) in self.changes.items()}
        return replace_spans(self.par.text, spans)

    def report(self) -> None:
        """Warn about labels that were left out and numbers that were rounded to integers."""
        if self.others:
            self.findings.warning(0, "", f"left out, since the file does not have them: {count_labels(self.others)}")
        for name, error in self.rounding.items():
            self.findings.warning(0, name, f"rounded to integers, as stored; the largest change is {error:.3g}")

    def take(self, item: Parameter | Text) -> None:
        """Take the numbers or the text of an item."""
        before = self.par.items.get(item.name)
        if before is None:
            self.others.append(item.name)
        elif isinstance(item, Text) or isinstance(before, Text):
            self._take_text(item, before)
        elif item.kind != before.kind or item.values.shape != before.values.shape:
            shapes = (f"{p.kind} {' x '.join(map(str, p.values.shape))}".strip() for p in (item, before))
            self.findings.error(0, item.name, "is a {}, but a {} in the file".format(*shapes), _OTHER_FORMAT)
        else:
            label = self.par.labels[item.name]
            (old, old_points), (new, new_points) = (in_stored_order(each, before.axes) for each in (before, item))
            # in the file, x runs fastest
            self._replace(label, "", old.T.ravel(), new.T.ravel())
            for letter, *points in zip(AXES, old_points, new_points, strict=False):
                self._replace(label, letter, *points)

    def _take_text(self, item: Parameter | Text, before: Parameter | Text) -> None:
        if not isinstance(item, Text) or not isinstance(before, Text):
            self.findings.error(0, item.name, "is a text in one file and a number in the other")
        elif item.text != before.text and before.kind != "text":
            self._take_word(item)
        elif item.text != before.text:
            self._take_codes(item, self.par.labels[item.name])

    def _take_word(self, item: Text) -> None:
        quantity = self.par.quantities.get((item.name, ""))
        if quantity is None or quantity.conversion.words is None:
            message = f"the number of the word {item.text[:40]!r} is not in the file"
            self.findings.error(0, item.name, message, _GIVE_A2L)
            return
        raw, number = quantity.conversion.words.raw(item.text), self.par.labels[item.name].values[0]
        if raw is None:
            self.findings.error(0, item.name, f"{item.text[:40]!r} is not a word of {quantity.conversion.name}")
            return
        self.changes[number.begin] = len(number.word), str(int(raw)) if raw == int(raw) else repr(raw)
        self.changes[number.physical_begin] = len(number.physical), item.text

    def _take_codes(self, item: Text, label: ParLabel) -> None:
        codes = [ord(character) for character in item.text]
        if len(codes) > len(label.values) or max(codes, default=0) > 255 or 0 in codes:
            message = f"a text of up to {len(label.values)} characters fits, got {item.text[:60]!r}"
            self.findings.error(0, item.name, message, "Shorten it.")
            return
        # the room of a text is fixed
        codes += [0] * (len(label.values) - len(codes))
        for number, code in zip(label.values, codes, strict=True):
            self.changes[number.begin] = len(number.word), str(code)
        end = label.values[-1].begin + len(label.values[-1].word)
        comment = self.par.text[end:].partition("\n")[0].rstrip("\r")
        if ";" in comment:
            self.changes[end] = len(comment), f" ; {item.text}"

    def _replace(self, label: ParLabel, letter: str, before: Float, now: Float) -> None:
        """Replace the numbers of the values or of an axis that changed, and their physical values."""
        numbers, quantity = (
            label.axes[letter] if letter else label.values,
            self.par.quantities.get((label.name, letter)),
        )
        if np.array_equal(before, now):
            return
        if not np.isfinite(now).all():
            self.findings.error(0, label.name, "a parameter file cannot store non-finite values")
        elif quantity is None and not _is_identity(label, numbers):
            message = "is stored with a conversion that the file does not state, so it cannot be changed"
            self.findings.error(0, label.name, message, _GIVE_A2L)
        else:
            for number, old, new in zip(numbers, before.tolist(), now.tolist(), strict=True):
                if old != new:
                    self._change(label, number, new, quantity)

    def _change(self, label: ParLabel, number: ParNumber, value: float, quantity: StoredQuantity | None) -> None:
        """Replace one number and its physical value."""
        raw = value if quantity is None else stored(quantity, value)
        if raw is None:
            message = f"{value:g} has no stored number in the conversion {quantity.conversion.name if quantity else ''}"
            self.findings.error(0, label.name, message, "Choose a value within its range.")
            return
        word = self._word(label, raw, value, quantity)
        self.changes[number.begin] = len(number.word), word
        # a word or a remark stays
        if np.isnan(displayed_value(number.physical)):
            return
        shown = _display(float(word) if quantity is None else physical(quantity, float(word)), number.physical)
        if quantity is None and not is_hexadecimal(number.physical):
            shown = word
        self.changes[number.physical_begin] = len(number.physical), shown

    def _word(self, label: ParLabel, raw: float, value: float, quantity: StoredQuantity | None) -> str:
        """Return the text of a stored number; integers are rounded and must fit their type."""
        if not label.is_integer:
            return repr(raw)
        rounded = round(raw)
        bits = label.bits or 32
        low, high = (0, 2**bits - 1) if label.type == "UINT" else (-(2 ** (bits - 1)), 2 ** (bits - 1) - 1)
        if not low <= rounded <= high:
            message = f"must be stored as {low} to {high}, in {label.type}({bits}), got {raw:g} for {value:g}"
            self.findings.error(0, label.name, message, "Limit it with bounds.")
        exact = float(rounded) if quantity is None else physical(quantity, float(rounded))
        error = 0.0 if exact is None else abs(exact - value)
        # 1e-300, as an error has no relation to a value of 0
        if error > _TINY * max(abs(value), 1e-300):
            self.rounding[label.name] = max(self.rounding.get(label.name, 0.0), error)
        return str(rounded)


def _display(value: float | None, like: str) -> str:
    """Return a physical value with as many decimals as another one."""
    if value is None:
        return ""
    if is_hexadecimal(like) and value >= 0:
        return f"0x{round(value):X}"
    if "e" in like.lower():
        return repr(value)
    return f"{value:.{len(like.partition('.')[2])}f}"


def _is_identity(label: ParLabel, numbers: Sequence[ParNumber]) -> bool:
    """Check whether stored and physical values are the same: zeros alone do not tell it of integers."""
    if not label.is_integer and any(np.isnan(displayed_value(number.physical)) for number in numbers):
        return True
    return agree(numbers) and (not label.is_integer or any(number.raw for number in numbers))
