"""Which kind of image a file is."""

import re

from kennfeld.calfiles.format import Notes
from kennfeld.calfiles.images.image import Image
from kennfeld.calfiles.images.intel_hex import read_intel_hex
from kennfeld.calfiles.images.s_records import read_s_records

__all__ = ["read_image", "recognises_image"]

_INTEL = re.compile(rb"\s*:[0-9A-Fa-f]{10}")
_MOTOROLA = re.compile(rb"\s*S[0-9][0-9A-Fa-f]{6}")


def recognises_image(head: bytes) -> bool:
    """Whether a file begins like Intel HEX or S-records."""
    return _INTEL.match(head) is not None or _MOTOROLA.match(head) is not None


def read_image(raw: bytes, name: str, notes: Notes) -> Image:
    """The image in a file; notes an error for each line that is wrong.

    Whoever reads on calls `notes.settle()` first.
    """
    if _MOTOROLA.match(raw):
        return read_s_records(raw, name, notes)
    if raw.lstrip().startswith(b":"):
        return read_intel_hex(raw, name, notes)
    notes.error(0, "", "is neither Intel HEX nor a file of S-records" if raw.strip() else "is empty")
    return Image(name, "", raw, ())
