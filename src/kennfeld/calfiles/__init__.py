"""Calibration files: one converter per format, chosen by content when reading and by ending when writing."""

from kennfeld.calfiles.comparison import Comparison, Difference, Tolerance, compare
from kennfeld.calfiles.files import (
    CalibrationFile,
    ParameterSummary,
    describe,
    endings,
    losses,
    read,
    read_several,
    recognise,
    unwritable,
    write,
)
from kennfeld.calfiles.flash.description import A2lFile, describe_a2l
from kennfeld.calfiles.merging import Change, Merged, merge
from kennfeld.parameter_set import use_writer

__all__ = [
    "A2lFile",
    "CalibrationFile",
    "Change",
    "Comparison",
    "Difference",
    "Merged",
    "ParameterSummary",
    "Tolerance",
    "compare",
    "describe",
    "describe_a2l",
    "endings",
    "losses",
    "merge",
    "read",
    "read_several",
    "recognise",
    "unwritable",
    "write",
]

use_writer(write)
