"""Finds formulas without saved values, as written by programs that do not compute them."""

import re
import zipfile

from kennfeld.base.archives import iterate_chunks
from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.workbooks.relationships import attributes_of, relationship_targets

_OVERLAP = 20_000  # bytes; more than a cell with the longest formula
_BOOK, _LINKS = "xl/workbook.xml", "xl/_rels/workbook.xml.rels"
_SHEET = re.compile(r"<(?:\w+:)?sheet\s[^>]*>")
# a cell of type str may hold an empty text, which is a value
_CELL = re.compile(
    rb"""<(?:\w+:)?c\s(?![^>]*\bt\s*=\s*["']str)[^>]*?\br\s*=\s*["']([A-Z]{1,3}[0-9]{1,7})["'][^>]*>\s*"""
    rb"""(?:<(?:\w+:)?f\b[^>]*/>|<(?:\w+:)?f\b[^>]*>[^<]*</(?:\w+:)?f>)\s*"""
    rb"""(?:<(?:\w+:)?v\s*/>|<(?:\w+:)?v>\s*</(?:\w+:)?v>)?\s*</(?:\w+:)?c>"""
)


@dataclass(frozen=True)
class UnsavedFormulas:
    """The formulas of a sheet whose values were not saved: how many, and the cell of the first one."""

    sheet: str
    count: int
    first: str
    remedy = "Open the workbook in Excel or LibreOffice, which compute them, and save it."

    def __str__(self) -> str:
        formulas = "formula whose value was" if self.count == 1 else "formulas whose values were"
        others = " and others" if self.count > 1 else ""
        return f"sheet {self.sheet} holds {self.count} {formulas} not saved, in {self.first}{others}"


def find_unsaved(archive: zipfile.ZipFile, sheet: str) -> UnsavedFormulas | None:
    """Return the formulas without values of a sheet of an .xlsx or .xlsm; None if there are none."""
    member = _member(archive, sheet)
    if member not in archive.namelist():
        return None
    cells: dict[str, None] = {}
    for text in iterate_chunks(archive, member, _OVERLAP):
        # a plain search first, as most sheets hold only values
        if b"<f" in text or b":f" in text:
            cells |= dict.fromkeys(cell.decode() for cell in _CELL.findall(text))
    return UnsavedFormulas(sheet, len(cells), next(iter(cells))) if cells else None


def _member(archive: zipfile.ZipFile, sheet: str) -> str:
    """Return the archive member of a sheet; empty if unknown."""
    if not {_BOOK, _LINKS} <= {*archive.namelist()}:
        return ""
    sheets = (attributes for attributes in attributes_of(_SHEET, archive, _BOOK) if attributes.get("name") == sheet)
    link = next((value for key, value in next(sheets, {}).items() if key.endswith(":id")), "")
    return relationship_targets(archive, _LINKS).get(link, "")
