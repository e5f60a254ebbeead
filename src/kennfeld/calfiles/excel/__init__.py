"""Calibrations as Excel workbooks."""
