"""Identifies files that are not supported as calibrations, by their ending or first bytes."""

import re
from pathlib import Path

from kennfeld.errors import Finding, Location

_ROOT = re.compile(rb"<([A-Za-z_][\w.:-]{0,60})[\s/>]")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_HEAD = 20_000  # bytes before the root of an XML document
_MARKS = (
    (b"MDF ", "an MDF measurement"),
    (b"UnFinMF ", "an unfinished MDF measurement"),
    (b"PK\x03\x04", "a ZIP archive, such as .xlsx, .slx or .fmu"),
)
_EXPORT_REMEDY = "Export it from that tool as DCM (.dcm) or CDFX (.cdfx)."
_IMAGE_REMEDY = "Convert it to Intel HEX (.hex) or S-records (.s19), and pass the A2L file that describes it."
_ENDINGS = {
    ".par": ("a parameter file (.par) that does not begin as those of CANape, which cannot be read", _EXPORT_REMEDY),
    ".cdm": ("an INCA calibration data file (.cdm), which cannot be read", _EXPORT_REMEDY),
    ".sldd": (
        "a Simulink data dictionary (.sldd): which axes its tables have is stated in the model",
        "Convert the model: `kennfeld convert engine.slx engine.kf` writes its values to engine.json.",
    ),
    ".lab": ("a list of labels (.lab), which contains no values", "Pass the calibration file with their values."),
    ".bin": ("a raw memory dump (.bin), which contains no addresses", _IMAGE_REMEDY),
    ".elf": ("a program (.elf)", _IMAGE_REMEDY),
}


def explain_unsupported(path: Path) -> Finding | None:
    """Return why calibration data of an unsupported ending cannot be read; None for other endings."""
    known = _ENDINGS.get(path.suffix.lower())
    return None if known is None else Finding(Location(path.name), f"is {known[0]}", known[1])


def identify_content(head: bytes) -> str:
    """Return the kind of a file by its first bytes; empty if unknown.

    >>> identify_content(b"<?xml version='1.0'?><PaCo/>")
    'XML with the root PaCo'
    """
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    known = next((kind for mark, kind in _MARKS if start.startswith(mark)), "")
    if known or not start.startswith(b"<?xml"):
        return known
    root = _ROOT.search(_COMMENT.sub(b"", start[:_HEAD]))
    return f"XML with the root {root[1].decode('ascii', 'replace')}" if root else "XML"
