"""Opens spreadsheets safely: limits what a damaged or hostile file may request before a library reads it."""

from kennfeld.workbooks.formulas import Unsaved
from kennfeld.workbooks.workbook import Workbook, column_letters, opened

__all__ = ["Unsaved", "Workbook", "column_letters", "opened"]
