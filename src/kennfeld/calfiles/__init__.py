"""Calibration files: one converter a format, told apart by content when reading and by ending when writing."""

from kennfeld.calfiles.files import CalibrationFile, ParameterSummary, describe, endings, read, write
from kennfeld.parameters import use_writer

__all__ = ["CalibrationFile", "ParameterSummary", "describe", "endings", "read", "write"]

use_writer(write)
