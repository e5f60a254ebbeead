"""Recognises Simulink models by their first bytes."""

import re

PART_BEGIN = b"__MWOPC_PART_BEGIN__"
CLASSIC = re.compile(rb"\s*(?:#[^\n]*\n\s*)*(?:Model|Library|Subsystem)\s*\{")


def recognises_simulink(raw: bytes) -> bool:
    """Return True if the first bytes look like a Simulink model that is not a zip archive."""
    return bool(CLASSIC.match(raw)) or is_text_package(raw)


def is_text_package(raw: bytes) -> bool:
    """Return True if a text contains the parts of a package."""
    return PART_BEGIN in raw
