"""What a file is that no reader of calibrations knows, as far as its beginning or its ending tells."""

import re
from pathlib import Path

from kennfeld.errors import Finding

__all__ = ["foreign_calibration", "look_of"]

_ROOT = re.compile(rb"<([A-Za-z_][\w.:-]{0,60})[\s/>]")
_COMMENT = re.compile(rb"<!--.*?-->", re.DOTALL)
_HEAD = 20_000  # bytes before the root of an XML document
_MARKS = (
    (b"MDF ", "an MDF measurement"),
    (b"UnFinMF ", "an unfinished MDF measurement"),
    (b"PK\x03\x04", "a ZIP archive, such as .xlsx, .slx or .fmu"),
    (b"\x7fELF", "a program (ELF) without the addresses of labels"),
)
_EXPORT = "Export it from that tool as DCM (.dcm) or CDFX (.cdfx)."
_AS_IMAGE = "Convert it to Intel HEX (.hex) or S-records (.s19), and name the A2L file that describes it."
_ENDINGS = {
    ".par": ("a parameter file (.par), such as CANape writes, which cannot be read", _EXPORT),
    ".cdm": ("a calibration data file (.cdm) of INCA, which cannot be read", _EXPORT),
    ".lab": ("a list of labels (.lab), which holds no values", "Name the calibration file with their values."),
    ".bin": ("a plain copy of a memory (.bin), which holds no addresses", _AS_IMAGE),
    ".elf": ("a program (.elf)", _AS_IMAGE),
}


def foreign_calibration(path: Path) -> Finding | None:
    """Return why a file of calibration data cannot be read, by its ending; None if the ending is none of these."""
    known = _ENDINGS.get(path.suffix.lower())
    return None if known is None else Finding(path.name, f"is {known[0]}", known[1])


def look_of(head: bytes) -> str:
    """Return what a file looks like by the beginning of its content; empty if that is not known.

    >>> look_of(b"<?xml version='1.0'?><PaCo/>")
    'XML with the root PaCo'
    """
    start = head.removeprefix(b"\xef\xbb\xbf").lstrip()
    known = next((kind for mark, kind in _MARKS if start.startswith(mark)), "")
    if known or not start.startswith(b"<?xml"):
        return known
    root = _ROOT.search(_COMMENT.sub(b"", start[:_HEAD]))
    return f"XML with the root {root[1].decode('ascii', 'replace')}" if root else "XML"
