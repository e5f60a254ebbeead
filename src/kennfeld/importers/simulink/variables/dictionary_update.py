"""Writes values into a copy of a data dictionary (`.sldd`): only the numbers of its entries change.

An entry is a variable, a `Simulink.Parameter`, a `Simulink.LookupTable` or a `Simulink.Breakpoint`, or a struct whose
fields are these. A table without breakpoints of its own has them in other entries, which the group axes of a
calibration are named after.
"""

import io
import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import field
from math import copysign
from pathlib import Path

import numpy as np

from kennfeld.base.archives import with_members
from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.formatting import join_names, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.content import replace_spans
from kennfeld.calfiles.format import WriteResult
from kennfeld.domain.axis import AXIS_LETTERS
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Parameter
from kennfeld.importers.simulink.reader.model_package import is_zip
from kennfeld.importers.simulink.variables.data_dictionary import Dictionary, is_chunk, read_dictionary
from kennfeld.importers.simulink.variables.dictionary_places import REAL, TRUTHS, NumberSpan, ValuePlace, value_places
from kennfeld.importers.simulink.variables.stored_variables import StoredVariable, Value
from kennfeld.matlab.values import INTEGERS

_TRUTH = {"true": "1", "false": "0"}
_SPECIAL = {"inf": "Inf", "-inf": "-Inf", "nan": "NaN"}


def update_dictionary(parameters: ParameterSet, path: Path) -> WriteResult:
    """Return a copy of a data dictionary with other values.

    Args:
        parameters: the values; those that the dictionary does not have are named in a warning.
        path: the dictionary.

    Raises:
        InputError: it is not a dictionary in the XML format, has none of the parameters, or cannot hold one of them.
    """
    dictionary = read_dictionary(path, follow=False)  # refuses what is not one
    raw = path.read_bytes()
    location = Location(path.name)
    if not is_zip(raw):
        message = "is a data dictionary in the text format, into which values are not written"
        raise InputError.of(location, message, 'Save it with FileFormat = "compressed-binary".')
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        chunks = {name: archive.read(name) for name in archive.namelist() if is_chunk(name.lstrip("/"))}
    update = _Update(value_places(chunks, path.name), dictionary, location)
    for parameter in parameters.values():
        update.write(parameter)
    update.report_missing([name for name in parameters if _entry_name(name) not in update.places], len(parameters))
    contents = {name: replace_spans(content, update.changes_of(name)) for name, content in chunks.items()}
    return WriteResult(with_members(raw, contents), update.findings.finish())


@dataclass
class _Update:
    """The new texts of numbers, and what is reported of them."""

    places: Mapping[str, ValuePlace]
    dictionary: Dictionary
    location: Location
    findings: Findings = field(default_factory=Findings)
    texts: dict[NumberSpan, bytes] = field(default_factory=dict)

    def changes_of(self, chunk: str) -> dict[tuple[int, int], bytes]:
        """Return the new texts of a chunk by the offsets of the old ones."""
        return {(span.begin, span.end): text for span, text in self.texts.items() if span.chunk == chunk}

    def write(self, parameter: Parameter) -> None:
        """Write a table, then its breakpoints; a parameter without an entry is reported elsewhere."""
        name = _entry_name(parameter.name)
        place = self.places.get(name)
        if place is None:
            return
        if place.values is None:
            self.findings.error(self.location, f"{parameter.name} holds no numbers", "Check the name.")
            return
        stored = _stored(self.dictionary, name)
        values = parameter.values if name == parameter.name else parameter.values.T
        self._write(place.values, values, name, stored)
        for direction in range(len(parameter.axes)):
            self._write_axis(parameter, direction, place, stored)

    def _write_axis(
        self, parameter: Parameter, direction: int, place: ValuePlace, stored: StoredVariable | None
    ) -> None:
        axis, label = parameter.axes[direction], f"{parameter.name}.{AXIS_LETTERS[direction]}"
        own = place.axes[direction] if direction < len(place.axes) else axis.name
        if isinstance(own, NumberSpan):
            points = stored.breakpoints if stored is not None else ()
            self._write(own, axis.breakpoints, label, points[direction] if direction < len(points) else None)
            return
        shared = self.places.get(own) if own else None
        if own and shared is not None and shared.values is not None:
            self._write(shared.values, axis.breakpoints, own, _stored(self.dictionary, own))
            return
        message = f"the breakpoints of {label} are not written: no entry is known to hold them"
        self.findings.remark(self.location, message)

    def _write(self, span: NumberSpan, values: Float, label: str, stored: StoredVariable | None) -> None:
        # stored by columns
        flat, kind = np.ravel(values, order="F"), _kind(span, stored)
        fault = _fault(span, kind, values)
        if fault is not None:
            self.findings.error(self.location, f"{label} {fault[0]}", fault[1])
            return
        self._check_limits(flat, label, stored)
        text = _text(span, kind, flat).encode()
        if self.texts.setdefault(span, text) != text:
            message = f"{label} has two sets of values in the calibration: of several tables, or as an axis and alone"
            self.findings.error(self.location, message, "Keep one of them.")

    def _check_limits(self, values: Float, label: str, stored: StoredVariable | None) -> None:
        low = -np.inf if stored is None or stored.minimum is None else stored.minimum
        high = np.inf if stored is None or stored.maximum is None else stored.maximum
        beyond = values[(values < low) | (values > high)]
        if beyond.size:
            side = f"minimum of {low:g}" if beyond[0] < low else f"maximum of {high:g}"
            message = f"{label} is {beyond[0]:g}, beyond its {side} in the dictionary"
            self.findings.warning(self.location, message, "Simulink refuses such a value: change one of them.")

    def report_missing(self, missing: Sequence[str], count: int) -> None:
        """Report the parameters without an entry, and the referenced dictionaries that have them."""
        known: dict[Path, Dictionary] = {}
        if missing and self.dictionary.references:
            read_dictionary(self.dictionary.path, known=known)
        referenced = {path.name: further for path, further in known.items() if path != self.dictionary.path}
        nowhere = list(missing)
        for file, further in referenced.items():
            names = [name for name in nowhere if _stored(further, _entry_name(name)) is not None]
            nowhere = [name for name in nowhere if name not in names]
            if names:
                message = f"has no entry {join_names(names)}, but {file} does, to which it refers"
                self.findings.warning(self.location, message, f"Write into {file}, too.")
        # a dictionary of another model would be copied unchanged
        if missing and len(missing) == count:
            message = "has none of the parameters"
            self.findings.error(self.location, message, "Check the names; literals are in the model.")
        elif nowhere:
            self.findings.warning(self.location, f"has no entry {join_names(nowhere)}", "Change them in the model.")


def _entry_name(name: str) -> str:
    """Return the name of the entry of a parameter; a model that looks up `M'` has a parameter of this name."""
    return name.removesuffix("'")


def _stored(dictionary: Dictionary, name: str) -> StoredVariable | None:
    """Return the variable or the object of a name, within structs too; None if there is none."""
    first, *path = name.split(".")
    value: Value = dictionary.data.entries.get(first)
    for key in path:
        while isinstance(value, StoredVariable):
            value = value.value
        value = value.get(key) if isinstance(value, Mapping) else None
    if value is None or isinstance(value, StoredVariable):
        return value
    return StoredVariable(name, value, "")


def _kind(span: NumberSpan, stored: StoredVariable | None) -> str:
    """Return the class that the numbers have in the end: that of the text, or a whole type of its object."""
    stated = stored.type if stored is not None else ""
    return stated if span.kind in REAL and stated in ("boolean", *INTEGERS) else span.kind


def _fault(span: NumberSpan, kind: str, values: Float) -> tuple[str, str] | None:
    """Return why a property cannot hold values, and the remedy; None if it can."""
    if span.obstacle:
        return f"{span.obstacle}, so that values are not written", "Enter it by hand."
    # a row and a column are one curve
    own, new = ([size for size in shape if size != 1] for shape in (span.shape, values.shape))
    if own != new:
        message = f"has the size {size_text(span.shape)}, the new values {size_text(values.shape)}"
        return message, "Change the size in the dictionary."
    wrong = values[~_holds(kind, values)]
    if wrong.size:
        word = "type" if kind != span.kind else "class"
        return f"is of the {word} {kind}, which cannot hold {wrong[0]:g}", _remedy(kind)
    return None


def _holds(kind: str, values: Float) -> Bool:
    """Mark the values that a class holds, Bool[...]."""
    if kind == "double":
        return np.ones(values.shape, bool)
    if kind == "single":
        return np.asarray(~np.isfinite(values) | (np.abs(values) <= np.finfo(np.float32).max))
    if kind in TRUTHS:
        return np.asarray((values == 0) | (values == 1))
    limits = np.iinfo(kind)
    # a limit of 64 bits is none of double precision, and rounds to a power of two beyond it
    return np.asarray((np.rint(values) == values) & (values >= limits.min) & (values < float(limits.max) + 1))


def _remedy(kind: str) -> str:
    if kind in TRUTHS:
        return "Use 0 or 1."
    return "Use values within its range." if kind == "single" else "Use whole numbers within its range."


def _text(span: NumberSpan, kind: str, values: Float) -> str:
    """Return numbers as the text of a property; numbers that stay are written as they were."""
    old = np.array([float(_TRUTH.get(word, word)) for word in span.words])
    if kind == "single":
        # 0.05 in the file is the number that 0.05 becomes in single precision
        old, values = (each.astype(np.float32).astype(np.float64) for each in (old, values))
    pairs = zip(span.words, old.tolist(), values.tolist(), strict=True)
    return " ".join(word if _same(before, value) else _word(span, value) for word, before, value in pairs)


def _same(first: float, second: float) -> bool:
    """Return True for the same number, NaN and the sign of zero included."""
    if first != first or second != second:
        return first != first and second != second
    return first == second and copysign(1.0, first) == copysign(1.0, second)


def _word(span: NumberSpan, value: float) -> str:
    if span.kind in REAL:
        return _SPECIAL.get(repr(value), repr(value))
    if span.kind in TRUTHS and not _TRUTH.keys().isdisjoint(span.words):
        return "true" if value else "false"
    return str(int(value))
