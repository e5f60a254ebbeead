"""Label lists (.lab) of INCA, MDA and CANape: names that select labels, without values.

INCA divides a list into sections: `[RAMCELL]` are measured variables, `[LABEL]` calibrated ones, and `[FUNCTION]` and
`[GROUP]` name what contains labels. A line is a name, perhaps followed by a raster and a comment behind semicolons
(ETAS, "LAB File for INCA - Description", V1.2). CANape writes a name a line, without a section or under any other.
"""

import re
from collections.abc import Iterable
from pathlib import Path

from kennfeld.base.errors import Finding, Findings, InputError, Location
from kennfeld.base.file_errors import convert_errors
from kennfeld.base.formatting import count_noun, join_names
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.calfiles.format import CalibrationSource

ENDING = ".lab"
VALUES = ".changed"  # in place of an ending: the labels that have changed, with their values
_SECTION = re.compile(r"\[([^\[\]]+)\]\s*;*\s*\Z")
_MEASURED, _FUNCTIONS = ("ramcell",), ("function", "functions")
_OTHERS = ("settings", "group", "groups")  # sections that name no labels
_COMMENTS = ("#", "//")
_HEAD = "[SETTINGS]\r\nVersion;V1.1\r\nMultiRasterSeparator;&\r\n\r\n[LABEL]\r\n"
_UNWRITABLE = re.compile(r"[;\r\n]|\A\s|\s\Z|\A\[|\A#|\A//")
_MOST_BYTES = 50_000_000


@dataclass(frozen=True)
class LabelList:
    """The names in a label list, without duplicates, in their order.

    Attributes:
        labels: calibrated labels, and those under no section or one of another name.
        measured: measured variables.
        functions: functions, which stand for all their labels.
    """

    labels: tuple[str, ...]
    measured: tuple[str, ...] = ()
    functions: tuple[str, ...] = ()


def parse_label_list(text: str) -> LabelList:
    r"""Return the names in the text of a label list.

    >>> parse_label_list("[RAMCELL]\nn;10ms\n[Label]\nKfTrq\nKlEta;;a comment\n").labels
    ('KfTrq', 'KlEta')
    """
    names: dict[str, dict[str, None]] = {kind: {} for kind in ("label", "measured", "function", "other")}
    kind = "label"
    for line in map(str.strip, text.splitlines()):
        section = _SECTION.match(line)
        if section is not None:
            heading = section[1].strip().casefold()
            kinds = {"measured": _MEASURED, "function": _FUNCTIONS, "other": _OTHERS}
            kind = next((kind for kind, headings in kinds.items() if heading in headings), "label")
            continue
        name = line.partition(";")[0].strip()
        if name and not name.startswith(_COMMENTS):
            names[kind][name] = None
    return LabelList(tuple(names["label"]), tuple(names["measured"]), tuple(names["function"]))


def read_label_list(path: Path) -> LabelList:
    """Read a label list; the encoding is that of a calibration file.

    Raises:
        InputError: the file cannot be read, or is not a text.
    """
    with convert_errors(path, "cannot be read", missing="file not found"):
        size = path.stat().st_size
        # too large a file counts as a binary one
        raw = path.read_bytes() if size <= _MOST_BYTES else b"\0"
    source = CalibrationSource(path.name, raw, path)
    if source.is_binary:
        remedy = "Write a text file with a name a line."
        raise InputError.of(Location(path.name), "is not a label list", remedy)
    return parse_label_list(source.text)


def write_label_list(names: Iterable[str], file: str) -> tuple[str, tuple[Finding, ...]]:
    """Return the text of a label list, as INCA and CANape read it, and warnings.

    Text beyond ASCII begins with a byte order mark, without which INCA takes it for a national code page.

    Args:
        names: the labels; a name that the format cannot represent, as it has a semicolon, is left out.
        file: the name of the file, for warnings.
    """
    findings = Findings()
    chosen = list(dict.fromkeys(names))
    odd = [name for name in chosen if _UNWRITABLE.search(name)]
    if odd:
        message = f"{count_noun(len(odd), 'name')} left out, as a label list cannot hold them: {join_names(odd, 6)}"
        findings.warning(Location(file), message)
    lines = [name for name in chosen if name not in odd]
    text = _HEAD + "".join(f"{name}\r\n" for name in lines)
    return text if text.isascii() else f"\ufeff{text}", tuple(findings)
