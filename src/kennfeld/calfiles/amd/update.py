"""Rewrites an `.axl` archive or a `.data.amd` file with other numbers and keeps everything else."""

import re
from collections import defaultdict
from collections.abc import Mapping, Sequence
from html import escape
from typing import Final

import numpy as np

from kennfeld.ascet.amd.data_sets import DataValue
from kennfeld.ascet.amd.files import ARCHIVE, ENDING, file_name
from kennfeld.base.archives import with_members
from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_labels, holds_control_characters, join_names
from kennfeld.calfiles.amd.reader import AmdOrigin, AmdReference, AmdValue
from kennfeld.calfiles.content import in_stored_order, replace_spans
from kennfeld.calfiles.format import FileFindings, Item, WriteResult
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.domain.texts import Text

_ZIP: Final = b"PK\x03\x04"
_ATTRIBUTE: Final = rb"\s+[\w:.-]+\s*=\s*(?:\"[^\"]*\"|'[^']*')"
# the value of the element that begins here, behind any other attributes
_VALUE: Final = re.compile(rb"<[\w:.-]+(?:" + _ATTRIBUTE + rb")*?\s+value\s*=\s*(\"[^\"]*\"|'[^']*')")
_SIGNATURE: Final = re.compile(rb"<(?:\w+:)?SignatureValue\b")


def write_amd(parameters: ParameterSet, file: str) -> WriteResult:
    """Return the file that a set was read from, with the numbers of the set.

    Parameters of other files are left out, with a warning. So is a digital signature that no longer fits, which stays
    in the file. Raises `InputError` if the set was not read from such a file, or if a table has another size.
    """
    findings = FileFindings(file)
    origin = parameters.origin
    if isinstance(origin, AmdReference):
        origin = origin.origin()
    if not isinstance(origin, AmdOrigin):
        message = "an .axl or .amd file can only be written over the one it was read from, but this set is from another"
        remedy = "Name it first under initial, or merge: kennfeld merge Engine.axl new.dcm -o New.axl"
        findings.error(0, "", message, remedy)
        findings.finish()
    assert isinstance(origin, AmdOrigin)
    own = ARCHIVE if origin.source.raw.startswith(_ZIP) else ENDING
    if not file.lower().endswith(own):
        message = f"the values are those of {origin.source.name}, which is not such a file"
        findings.error(0, "", message, f"Write a file that ends in {own}.")
    update = _AmdUpdate(origin, findings)
    for item in (*parameters.chosen, *parameters.others):
        update.take(item)
    if update.others:
        findings.warning(0, "", f"left out, since the file does not have them: {count_labels(update.others)}")
    changed = update.contents()
    signed = [file_name(path) for path, raw in changed.items() if _SIGNATURE.search(raw)]
    if signed:
        message = f"values changed, so that digital signatures no longer fit: {join_names(signed, 4)}"
        findings.warning(0, "", message, "ASCET signs components again when it exports them.")
    return WriteResult(_replaced(origin.source.raw, changed), findings.finish())


def _replaced(raw: bytes, changed: Mapping[str, bytes]) -> bytes:
    """Return a file with changed contents; in an archive, all other members stay as they are."""
    if not changed:
        return raw
    if not raw.startswith(_ZIP):
        return next(iter(changed.values()))
    return with_members(raw, changed)


class _AmdUpdate:
    def __init__(self, origin: AmdOrigin, findings: FileFindings) -> None:
        self.origin, self.findings = origin, findings
        self.changes: dict[str, dict[tuple[int, int], bytes]] = defaultdict(dict)  # by path, then begin and end
        self.others: list[str] = []

    def contents(self) -> dict[str, bytes]:
        """Return the files that changed."""
        return {path: replace_spans(self.origin.contents[path], changes) for path, changes in self.changes.items()}

    def take(self, item: Item) -> None:
        """Take the values of a parameter or text."""
        value = self.origin.value(item.name, item.variant)
        before = None if value is None else value.item
        if value is None or before is None:
            self.others.append(item.name)
        elif isinstance(before, Text):
            self._take_text(item, value) if isinstance(item, Text) else self._take_number(item, value)
        elif isinstance(item, Text):
            self.findings.error(0, item.name, "is a text in one file and a number in the other")
        elif item.kind != before.kind or item.values.shape != before.values.shape:
            shapes = (f"{p.kind} {' x '.join(map(str, p.values.shape))}".strip() for p in (item, before))
            message = "is a {}, but a {} in the file".format(*shapes)
            self.findings.error(0, item.name, message, "Keep the size of the table, or write another format.")
        else:
            values, breakpoints = in_stored_order(item, before.axes)
            self._replace(item.name, value, value.entry.values, values.ravel())
            for points, numbers in zip(value.entry.axes, breakpoints, strict=True):
                self._replace(item.name, value, points, numbers)

    def _take_number(self, item: Parameter, value: AmdValue) -> None:
        """Take the label of a number."""
        labels = {float(number): label for label, number in value.labels}
        label = labels.get(float(item.values)) if item.values.ndim == 0 else None
        if label is None:
            self.findings.error(0, item.name, "is an enumeration, of which the file has no label for this number")
        elif label != value.entry.values[0].text:
            self._put(item.name, value, value.entry.values[0], escape(label))

    def _take_text(self, item: Text, value: AmdValue) -> None:
        known = value.entry.values[0]
        if item.text != known.text:
            if holds_control_characters(item.text):
                self.findings.error(0, item.name, f"{item.text[:60]!r} is not a valid word")
            self._put(item.name, value, known, escape(item.text))

    def _replace(self, name: str, value: AmdValue, before: Sequence[DataValue], now: Float) -> None:
        """Replace the numbers that changed."""
        if not np.all(np.isfinite(now)):
            self.findings.error(0, name, "has values that are not finite, which the file cannot store")
            return
        for known, number in zip(before, now.tolist(), strict=True):
            if number != known.number:
                if known.kind == "Logic" and number not in (0.0, 1.0):
                    self.findings.error(0, name, f"{number:g} is not a truth value", "Use 0 or 1.")
                self._put(name, value, known, _format_like(number, known))

    def _put(self, name: str, value: AmdValue, known: DataValue, text: str) -> None:
        raw = self.origin.contents[value.path]
        match = _VALUE.match(raw, known.begin)
        if match is None:
            message = "cannot be replaced, since the file is not encoded in UTF-8 or ASCII"
            self.findings.error(0, name, message, "Save it in UTF-8.")
            return
        begin, end = match.span(1)
        # without the quotes
        self.changes[value.path][begin + 1, end - 1] = text.encode("utf-8")


def _format_like(number: float, known: DataValue) -> str:
    """Format a number in its shortest exact form; truth values and integers stay such if they can."""
    if known.kind == "Logic":
        return "true" if number else "false"
    if known.text.lstrip("+-").isdecimal() and number == int(number):
        return str(int(number))
    return repr(number)
