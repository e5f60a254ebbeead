"""Recognises images and A2L files by their first bytes."""

import re

from kennfeld.calfiles.format import HEAD_SIZE, CalibrationSource

IMAGE_ENDINGS = (".hex", ".s19", ".s37", ".srec", ".mot", ".ihex", ".s28")
_A2L_BLOCK = re.compile(
    r"/begin\s+(PROJECT|MODULE|MOD_PAR|MOD_COMMON|CHARACTERISTIC|AXIS_PTS|MEASUREMENT|COMPU_METHOD|COMPU_TAB|COMPU_VTAB"
    r"|COMPU_VTAB_RANGE|RECORD_LAYOUT|FUNCTION|GROUP|FRAME|UNIT|USER_RIGHTS|VARIANT_CODING|INSTANCE|TYPEDEF_\w+|BLOB"
    r"|TRANSFORMER|IF_DATA|A2ML)\b"
)


def recognises_flash(source: CalibrationSource) -> bool:
    """Check whether a file begins like Intel HEX or S-records."""
    head = source.raw[:HEAD_SIZE].lstrip()
    if head[:1] not in (b":", b"S"):
        return False
    from kennfeld.calfiles.flash.records import recognises_image

    return recognises_image(head)


def recognises_a2l(head: str) -> bool:
    """Check whether a text begins like an A2L file or a part of one, after comments."""
    head = head[:HEAD_SIZE]
    return "ASAP2_VERSION" in head or _A2L_BLOCK.search(head) is not None


def fragment_of_a2l(head: str) -> tuple[str, str] | None:
    """Return what is wrong with a part of an A2L file, and the remedy; None for any other text."""
    head = head[:HEAD_SIZE]
    first = _A2L_BLOCK.search(head)
    if first is None or "ASAP2_VERSION" in head or first[1] in ("PROJECT", "MODULE"):
        return None
    message = f"is a fragment of an A2L file: it starts with {first[1]}, without an enclosing PROJECT and MODULE"
    return message, "Pass the A2L file that includes it."
