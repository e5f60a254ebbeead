"""Calibration files: one converter per format, chosen by content when reading and by ending when writing."""

from typing import TYPE_CHECKING

from kennfeld.base.lazy_names import lazy_names
from kennfeld.calfiles.files import (
    CalibrationFile,
    ParameterSummary,
    describe,
    endings,
    losses,
    read,
    read_several,
    read_with_findings,
    recognise,
    unwritable,
    write,
)
from kennfeld.domain.parameter_set import use_writer

if TYPE_CHECKING:
    from kennfeld.calfiles.a2l.image_files import A2lFile, describe_a2l
    from kennfeld.calfiles.comparison import Comparison, Difference, Tolerance, changed, compare
    from kennfeld.calfiles.merging import Change, Merged, merge

__all__ = [
    "A2lFile",
    "CalibrationFile",
    "Change",
    "Comparison",
    "Difference",
    "Merged",
    "ParameterSummary",
    "Tolerance",
    "changed",
    "compare",
    "describe",
    "describe_a2l",
    "endings",
    "losses",
    "merge",
    "read",
    "read_several",
    "read_with_findings",
    "recognise",
    "unwritable",
    "write",
]

__getattr__ = lazy_names(
    __name__,
    {
        "comparison": "Comparison Difference Tolerance changed compare",
        "a2l.image_files": "A2lFile describe_a2l",
        "merging": "Change Merged merge",
    },
)
# for `ParameterSet.save`, as the domain cannot import this package
use_writer(write)
