"""Formats of files that describe others: databases of bus messages, and what control units store."""

import re

from kennfeld.files.file_format import FileFormat, Recogniser, Role, has_root, holds_line, matches
from kennfeld.files.foreign import DATABASE
from kennfeld.files.head import HEAD_SIZE

_A2L_BLOCK = re.compile(
    r"/begin\s+(PROJECT|MODULE|MOD_PAR|MOD_COMMON|CHARACTERISTIC|AXIS_PTS|MEASUREMENT|COMPU_METHOD|COMPU_TAB|COMPU_VTAB"
    r"|COMPU_VTAB_RANGE|RECORD_LAYOUT|FUNCTION|GROUP|FRAME|UNIT|USER_RIGHTS|VARIANT_CODING|INSTANCE|TYPEDEF_\w+|BLOB"
    r"|TRANSFORMER|IF_DATA|A2ML)\b"
)
_DBC_VERSION = matches(re.compile(r"\s*VERSION\s+\""))
_DBC_LINE = holds_line(r"NS_\s*:|BU_\s*:|BO_\s+\d+\s")
_SYM_TITLE = re.compile(r"\s*FormatVersion\s*=", re.IGNORECASE)
_DESCRIBE_A2L = "kennfeld.calfiles.file_info:describe_a2l_file"
_BY_CANMATRIX = "needs the extra `bus`"
_HOW_TO_DECODE = "Name a bus log and the database that decodes it: `kennfeld info drive.mf4 --dbc engine.dbc`."


def recognises_a2l(text: str) -> bool:
    """Return whether a text begins like an A2L file or a part of one, after comments."""
    return "ASAP2_VERSION" in text or _A2L_BLOCK.search(text) is not None


def fragment_of_a2l(text: str) -> tuple[str, str] | None:
    """Return what is wrong with a part of an A2L file, and the remedy; None for any other text."""
    text = text[:HEAD_SIZE]
    first = _A2L_BLOCK.search(text)
    if first is None or "ASAP2_VERSION" in text or first[1] in ("PROJECT", "MODULE"):
        return None
    message = f"is a fragment of an A2L file: it starts with {first[1]}, without an enclosing PROJECT and MODULE"
    return message, "Pass the A2L file that includes it."


def _database(name: str, ending: str, phrase: str, recognises: Recogniser, notes: str) -> FileFormat:
    return FileFormat(
        name,
        (ending,),
        recognises,
        role=Role.DATABASE,
        description=f"{phrase}, {DATABASE}",
        remedy=_HOW_TO_DECODE,
        notes=notes,
    )


A2L_FRAGMENT = FileFormat(
    "A2L fragment",
    (),
    lambda head: fragment_of_a2l(head.text) is not None,
    role=Role.DESCRIPTION,
    describe=_DESCRIBE_A2L,
    description="a fragment of an A2L description, which says where the control unit keeps values and holds none",
    remedy="Name the recording, or the image with the A2L file that includes it.",
)
A2L = FileFormat(
    "A2L",
    (".a2l",),
    lambda head: recognises_a2l(head.text),
    role=Role.DESCRIPTION,
    describe=_DESCRIBE_A2L,
    description="an A2L description, which contains no values",
    remedy="Pass the image that it describes (.hex, .s19), with --a2l if needed.",
)
DBC = _database(
    "CAN database",
    ".dbc",
    "a CAN database (DBC)",
    lambda head: _DBC_VERSION(head) or _DBC_LINE(head),
    "needs no extra",
)
ARXML = _database("AUTOSAR description", ".arxml", "an AUTOSAR description (ARXML)", has_root("AUTOSAR"), _BY_CANMATRIX)
KCD = _database("Kayak database", ".kcd", "a Kayak database (KCD)", has_root("NetworkDefinition"), _BY_CANMATRIX)
SYM = _database(
    "PEAK database", ".sym", "a PEAK database (SYM)", matches(_SYM_TITLE), f"versions 5 and 6; {_BY_CANMATRIX}"
)
