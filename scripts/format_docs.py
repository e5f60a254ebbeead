"""Write what the documentation shows of the formats of files: the tables of `formats.md`, and the one of the README.

    python scripts/format_docs.py docs
    python scripts/format_docs.py

Without a folder, it prints the tables with the formats of other packages that are installed.
"""

import re
import sys
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

from kennfeld.files.file_format import CalibrationConverter, FileFormat, Role
from kennfeld.files.formats import calibration_formats, formats_of, recording_formats
from kennfeld.files.plugins import formats_of_plugins

__all__ = ["ASPECTS", "FUNCTIONS", "documents", "table"]

_TABLE = re.compile(r"(<!-- formats: ([^>]*) -->\n).*?(<!-- end of formats -->)", re.DOTALL)
FUNCTIONS = (Role.FUNCTION, Role.PROGRAM)
_EXPORTED = "formula text; C99, FMU 2.0 and 3.0, MATLAB with the calibrated values"
_RESULTS = "HTML report, Parquet, CSV, JSON"
# for each aspect that a record may lack or refuse: what it is, and what becomes of it if it is lacked
ASPECTS = {
    "group units": ("units, also of axes", "yes; a group axis has one unit in all tables"),
    "descriptions": ("descriptions", "no"),
    "inputs": ("input quantities of axes", "no"),
    "extrapolation": ("linear extrapolation", "no"),
    "falling axes": ("falling axes", "no"),
    "kinds": ("enumerations and booleans", "told by their words"),
    "line breaks": ("line breaks in units and descriptions", "become spaces"),
    "cubes": ("cubes, blocks with more than two dimensions", "no"),
    "missing values": ("missing values (NaN)", "no"),
    "columns": ("blocks of a single column", "become blocks of one dimension"),
    "infinities": ("infinite values", "become missing values"),
    "bounds": ("bounds", "no"),
    "locks": ("locks", "no"),
    "free axes": ("free breakpoints", "no"),
}
Rows = list[tuple[str, ...]]  # the heading first


def documents(folder: Path) -> dict[Path, str]:
    """Return the pages that list formats, filled in with those of Kennfeld itself."""
    pages = (folder / "formats.md", folder.parent / "README.md")
    return {page: _TABLE.sub(_fill, page.read_text(encoding="utf-8")) for page in pages}


def table(name: str, others: Sequence[FileFormat] = ()) -> str:
    """Return a table of formats as Markdown, with these formats of other packages."""
    heading, *rows = _TABLES[name](lambda formats: [known for known in formats if _is_listed(known, others)])
    return "\n".join([_row(heading), "|---" * len(heading) + "|", *map(_row, rows)])


def _fill(match: re.Match[str]) -> str:
    return f"{match[1]}\n{table(match[2])}\n\n{match[3]}"


def _is_listed(known: FileFormat, others: Sequence[FileFormat]) -> bool:
    return known not in formats_of_plugins() or known in others


Choice = Callable[[Iterable[FileFormat]], list[FileFormat]]


def _recordings(choose: Choice) -> Rows:
    readers = [(known, known.recording) for known in choose(recording_formats())]
    rows = [(known.name, _endings(known.endings), reader.notes) for known, reader in readers if reader is not None]
    return [("format", "files", "notes"), *sorted(rows, key=_by_name)]


def _calibrations(choose: Choice) -> Rows:
    rows = [
        (converter.label or known.name, _endings(known.endings), _written(converter), converter.notes)
        for known, converter in _converters(choose)
    ]
    return [("format", "files", "written", "notes"), *sorted(rows, key=_by_name)]


def _losses(choose: Choice) -> Rows:
    new = sorted(
        ((known.name, each) for known, each in _converters(choose) if each.write and not each.copies), key=_by_name
    )
    if unknown := {aspect for _, each in new for aspect in (*each.lacks, *each.refuses)} - ASPECTS.keys():
        raise ValueError(f"the page has no words for {unknown}")
    rows = [
        (content, *(_fate(converter, aspect, lost) for _, converter in new))
        for aspect, (content, lost) in ASPECTS.items()
    ]
    return [("", *(name for name, _ in new)), *rows]


def _functions(choose: Choice) -> Rows:
    rows = [(known.name, _endings(known.endings), known.notes) for known in _noted(choose, *FUNCTIONS, Role.COMPANION)]
    return [("format", "files", "notes"), *sorted(rows, key=_by_name)]


def _databases(choose: Choice) -> Rows:
    rows = [(known.name, _endings(known.endings), known.notes) for known in _noted(choose, Role.DATABASE)]
    return [("format", "files", "notes"), *sorted(rows, key=_by_name)]


def _overview(choose: Choice) -> Rows:
    recordings = [known.recording.label or known.name for known in choose(recording_formats()) if known.recording]
    databases = ", ".join(_endings(known.endings) for known in _noted(choose, Role.DATABASE))
    values = sorted((converter.label or known.name for known, converter in _converters(choose)), key=str.casefold)
    functions = [
        f"{known.name} ({_endings(known.endings)})" for known in _noted(choose, *FUNCTIONS) if not known.remedy
    ]
    measured = (
        f"{', '.join(recordings)}; frames of buses, by databases ({databases}); units converted, plateaus averaged"
    )
    return [
        ("", "read", "write"),
        ("measurements", f"{measured} to steady points", ""),
        ("calibrations", ", ".join(values), "the same"),
        ("functions", ", ".join(functions), _EXPORTED),
        ("results", "", _RESULTS),
    ]


_TABLES: dict[str, Callable[[Choice], Rows]] = {
    "overview": _overview,
    "measurements": _recordings,
    "databases": _databases,
    "calibrations": _calibrations,
    "losses": _losses,
    "functions": _functions,
}


def _converters(choose: Choice) -> list[tuple[FileFormat, CalibrationConverter]]:
    formats = choose(calibration_formats())
    return [(known, known.calibration) for known in formats if known.calibration is not None]


def _noted(choose: Choice, *roles: Role) -> list[FileFormat]:
    """Return the formats of these roles that have an ending of their own; the others are variants of them."""
    return [known for known in choose(formats_of(*roles)) if known.endings]


def _written(converter: CalibrationConverter) -> str:
    if not converter.write:
        return "no"
    if converter.copies:
        return "into a copy of such a file"
    return f"as {_endings(converter.endings)}" if converter.endings else "yes"


def _fate(converter: CalibrationConverter, aspect: str, lost: str) -> str:
    return "rejected" if aspect in converter.refuses else lost if aspect in converter.lacks else "yes"


def _by_name(row: tuple[Any, ...]) -> str:
    name: str = row[0]
    return name.casefold()


def _endings(endings: Sequence[str]) -> str:
    return ", ".join(f"`{ending}`" for ending in endings)


def _row(cells: Iterable[str]) -> str:
    return "|" + "|".join(f" {cell.replace('|', chr(92) + '|')} " if cell else " " for cell in cells) + "|"


if __name__ == "__main__":
    if len(sys.argv) > 1:
        for path, text in documents(Path(sys.argv[1])).items():
            path.write_text(text, encoding="utf-8", newline="\n")
    else:
        print("\n\n".join(table(name, formats_of_plugins()) for name in _TABLES))
