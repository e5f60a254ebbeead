"""Writes values into a copy of a data dictionary (`.sldd`): only the numbers of its entries change.

An entry is a variable, a `Simulink.Parameter`, a `Simulink.LookupTable` or a `Simulink.Breakpoint`. A table without an
object has its breakpoints in variables of their own, which the group axes of a calibration are named after.
"""

import io
import re
import sys
import zipfile
from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from kennfeld.base.archives import with_members
from kennfeld.base.arrays import Float
from kennfeld.base.errors import Findings, InputError, Location
from kennfeld.base.formatting import join_names, size_text
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.xml_document import XmlElement, XmlLimits, parse_xml
from kennfeld.calfiles.content import replace_spans
from kennfeld.calfiles.format import WriteResult
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import AXIS_LETTERS, Parameter
from kennfeld.importers.simulink.reader.model_package import is_zip
from kennfeld.importers.simulink.reader.section_tree import MAX_DEPTH, MAX_SECTIONS
from kennfeld.importers.simulink.variables.data_dictionary import is_chunk, read_dictionary
from kennfeld.matlab.values import INTEGERS

_TAG = re.compile(rb"""<(?:[^>"']|"[^"]*"|'[^']*')*>""")
_REAL = ("double", "single")
_NUMBERS = (*_REAL, "logical", "boolean", *INTEGERS)
# the sizes of the chunks have been checked when the dictionary was read
_LIMITS = XmlLimits(sys.maxsize, MAX_DEPTH, MAX_SECTIONS, MAX_SECTIONS)


@dataclass(frozen=True)
class _NumberSpan:
    """The numbers of a property: their place in the text, and the class and size that the text states."""

    begin: int
    end: int
    kind: str
    shape: tuple[int, ...]
    encoded: bool


@dataclass(frozen=True)
class _EntryNumbers:
    """The numbers of one entry: its values, and its breakpoints by axis."""

    values: _NumberSpan | None = None
    axes: tuple[_NumberSpan, ...] = ()


def update_dictionary(parameters: ParameterSet, path: Path) -> WriteResult:
    """Return a copy of a data dictionary with other values.

    Args:
        parameters: the values; those that the dictionary does not have are named in a warning.
        path: the dictionary.

    Raises:
        InputError: it is not a dictionary in the XML format, has none of the parameters, or cannot hold one of them.
    """
    read_dictionary(path, follow=False)  # refuses what is not one
    raw, findings = path.read_bytes(), Findings()
    location = Location(path.name)
    if not is_zip(raw):
        message = "is a data dictionary in the text format, into which values are not written"
        raise InputError.of(location, message, 'Save it with FileFormat = "compressed-binary".')
    with zipfile.ZipFile(io.BytesIO(raw)) as archive:
        chunks = {name: archive.read(name) for name in archive.namelist() if is_chunk(name.lstrip("/"))}
    known: set[str] = set()
    for name, content in chunks.items():
        entries = _entries(content, f"{path.name} {name}")
        known |= entries.keys()
        chunks[name] = _updated(content, entries, parameters, location, findings)
    missing = [name for name in parameters if name not in known]
    if missing and len(missing) == len(parameters):
        findings.error(location, "has none of the parameters", "Check the names; literals are in the model.")
    elif missing:
        findings.warning(location, f"has no entry {join_names(missing)}", "Change them in the model.")
    return WriteResult(with_members(raw, chunks), findings.finish())


def _entries(content: bytes, file: str) -> dict[str, _EntryNumbers]:
    """Return the entries of a chunk by name."""
    entries = {}
    for entry in parse_xml(content, file, _LIMITS).all("Object"):
        name = next((part.text.strip() for part in entry.all("P") if part.get("Name") == "Name"), "")
        if entry.get("Class") == "DD.ENTRY" and name:
            entries[name] = _entry(content, entry)
    return entries


def _entry(content: bytes, entry: XmlElement) -> _EntryNumbers:
    own = [(path, numbers) for path, numbers in _spans(content, entry) if path[0] == "Value" and path[-1] == "Value"]
    axes = tuple(numbers for path, numbers in own if "Breakpoints" in path)
    values = [numbers for path, numbers in own if "Breakpoints" not in path]
    # a breakpoint object has no other numbers
    first = values[0] if values else axes[0] if len(axes) == 1 else None
    return _EntryNumbers(first, axes if values else ())


def _spans(
    content: bytes, element: XmlElement, outer: tuple[str, ...] = ()
) -> Iterator[tuple[tuple[str, ...], _NumberSpan]]:
    """Yield the numbers within an element, each with the names of the properties around it."""
    for part in element.children:
        path = (*outer, part.get("Name")) if part.tag == "P" and part.get("Name") else outer
        if part.tag == "P" and part.get("Class") in _NUMBERS and (tag := _TAG.match(content, part.begin)):
            end = content.index(b"<", tag.end())
            shape = _shape(part.attributes, content[tag.end() : end])
            yield path, _NumberSpan(tag.end(), end, part.get("Class"), shape, bool(part.get("Encoding")))
        yield from _spans(content, part, path)


def _shape(attributes: Mapping[str, str], text: bytes) -> tuple[int, ...]:
    if "Dimension" in attributes:
        return tuple(int(n) for n in attributes["Dimension"].split("*"))
    return (1, len(text.split()))


def _updated(
    content: bytes,
    entries: Mapping[str, _EntryNumbers],
    parameters: ParameterSet,
    location: Location,
    findings: Findings,
) -> bytes:
    """Return a chunk with other numbers."""
    changes: dict[tuple[int, int], bytes] = {}
    for name, parameter in parameters.items():
        if name in entries:
            for numbers, values, label in _places(parameter, entries, location, findings):
                text = _text_of(numbers, values, label, location, findings)
                if text is not None:
                    changes[numbers.begin, numbers.end] = text
    return replace_spans(content, changes)


def _places(
    parameter: Parameter, entries: Mapping[str, _EntryNumbers], location: Location, findings: Findings
) -> Iterator[tuple[_NumberSpan, Float, str]]:
    """Yield the numbers of a parameter with their new values: of the table, then of its axes."""
    entry = entries[parameter.name]
    if entry.values is None:
        findings.error(location, f"{parameter.name} holds no numbers", "Check the name.")
        return
    yield entry.values, parameter.values, parameter.name
    for direction, axis in enumerate(parameter.axes):
        own = entries.get(axis.name) if axis.name else None
        if direction < len(entry.axes):
            yield entry.axes[direction], axis.breakpoints, f"{parameter.name}.{AXIS_LETTERS[direction]}"
        elif own is not None and own.values is not None:
            yield own.values, axis.breakpoints, axis.name
        else:
            message = f"the breakpoints of {parameter.name}.{AXIS_LETTERS[direction]} are not written"
            findings.remark(location, f"{message}: no entry is known to hold them")


def _text_of(numbers: _NumberSpan, values: Float, label: str, location: Location, findings: Findings) -> bytes | None:
    """Return values as the text of a property, by columns; None, with a finding, if it cannot hold them."""
    if numbers.encoded:
        findings.error(location, f"{label} is stored as bytes, into which values are not written", "Enter it by hand.")
        return None
    own, new = ([n for n in shape if n != 1] for shape in (numbers.shape, values.shape))
    if own != new:
        message = f"{label} has the size {size_text(numbers.shape)}, the new values {size_text(values.shape)}"
        findings.error(location, message, "Change the size in the dictionary.")
        return None
    flat = np.ravel(values, order="F")
    if numbers.kind in _REAL:
        flat = flat.astype(np.float32).astype(np.float64) if numbers.kind == "single" else flat
        words = [repr(float(x)) for x in flat]
        return " ".join({"inf": "Inf", "-inf": "-Inf", "nan": "NaN"}.get(word, word) for word in words).encode()
    if not np.array_equal(np.rint(flat), flat):
        at = float(flat[np.rint(flat) != flat][0])
        findings.error(
            location, f"{label} is of the class {numbers.kind}, which cannot hold {at:g}", "Round the values."
        )
        return None
    return " ".join(str(int(x)) for x in flat).encode()
