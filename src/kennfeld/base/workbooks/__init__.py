"""Opens spreadsheets safely: limits what a damaged or hostile file may request before a library reads it."""

from kennfeld.base.workbooks.formulas import UnsavedFormulas
from kennfeld.base.workbooks.workbook import Workbook, column_letters, open_workbook

__all__ = ["UnsavedFormulas", "Workbook", "column_letters", "open_workbook"]
