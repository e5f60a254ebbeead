"""The errors of each file, and its worst stretch: the window of about 1/20 of the file with the greatest RMSE."""

import math
from collections.abc import Sequence
from typing import Any, Literal

import numpy as np

from kennfeld.base.lazy_dataclass import dataclass
from kennfeld.base.numeric import finite_or_none

SHARE = 20  # windows in a file
LEAST_SECONDS = 5.0  # of a window
_DIGITS = 3  # of the length of a stretch that its times are rounded to


@dataclass(frozen=True)
class WorstStretch:
    """The stretch of a recording with the greatest RMSE.

    Attributes:
        begin: time stamp of its first sample in s, as recorded; of data without time the number of the sample, from 1.
        end: the same of its last sample.
        rmse: after the calibration, in the unit of the target.
        unit: of `begin` and `end`.
    """

    begin: float
    end: float
    rmse: float
    unit: Literal["s", "samples"]

    def __str__(self) -> str:
        """Return the place; times are rounded to about 1/1000 of the length.

        >>> str(WorstStretch(12.0, 17.0, 0.5, "s")), str(WorstStretch(3, 7, 0.5, "samples"))
        ('12 to 17 s', 'samples 3 to 7')
        >>> str(WorstStretch(1700068.4603, 1700098.7603, 0.5, "s"))
        '1700068.5 to 1700098.8 s'
        """
        if self.unit == "samples":
            return f"samples {self.begin:.0f} to {self.end:.0f}"
        length = self.end - self.begin
        # as many decimals as 1/1000 of the length has
        decimals = _DIGITS - math.ceil(math.log10(length)) if length > 0 else _DIGITS
        begin, end = (f"{round(time, max(decimals, 0)):.15g}" for time in (self.begin, self.end))
        return f"{begin} to {end} s"


@dataclass(frozen=True)
class RecordingQuality:
    """Errors of one criterion on one file of a dataset, in the unit of its target, before and after the calibration.

    Attributes:
        criterion: its node.
        dataset: name of the dataset.
        file: its name, with as much of its folder as distinguishes it; None for data without a file.
        use: "training" or "test".
        samples: number of scored samples; the errors are NaN if there are none.
        rmse_before: root mean square error with the start values.
        rmse_after: with the calibrated values.
        max_abs_after: largest absolute error.
        worst: the worst stretch of the file; None if there are no samples.

    >>> from kennfeld import calibrate
    >>> result = calibrate("y = k * x", {"x": [1.0, 2.0, 3.0], "m": [2.0, 4.0, 6.0]}, {"k": 0.0}, target="m")
    >>> [(row.dataset, row.file, row.samples) for row in result.recordings]
    [('training', None, 3)]
    """

    criterion: str
    dataset: str
    file: str | None
    use: str
    samples: int
    rmse_before: float
    rmse_after: float
    max_abs_after: float
    worst: WorstStretch | None

    def as_json(self) -> dict[str, Any]:
        """Return an entry of "recordings" in `result.json`."""
        worst = None if self.worst is None else {k: finite_or_none(v) for k, v in vars(self.worst).items()}
        return {name: finite_or_none(value) for name, value in vars(self).items()} | {"worst": worst}


def worst_first(rows: Sequence[RecordingQuality]) -> list[RecordingQuality]:
    """Return the rows with samples, by criterion, the largest RMSE first; an unknown one is the largest."""
    criteria = list(dict.fromkeys(row.criterion for row in rows))
    scored = (row for row in rows if row.samples)
    return sorted(scored, key=lambda row: (criteria.index(row.criterion), -np.nan_to_num(row.rmse_after, nan=np.inf)))


def of_several_files(rows: Sequence[RecordingQuality]) -> list[RecordingQuality]:
    """Return the rows of datasets that consist of several files; those of others say what their dataset does."""
    files: dict[str, set[str | None]] = {}
    for row in rows:
        files.setdefault(row.dataset, set()).add(row.file)
    return [row for row in rows if len(files[row.dataset]) > 1]


def recordings_table(rows: Sequence[RecordingQuality], *, before: bool = True) -> list[tuple[str, ...]]:
    """Return the rows with samples as text with a heading, the worst first.

    Criterion, dataset and use are omitted if there is only one, and the errors before the calibration on request.
    """
    shown = worst_first(rows)
    words = [name for name in ("criterion", "dataset", "use") if len({getattr(row, name) for row in shown}) > 1]
    errors = {"RMSE before": "rmse_before", "RMSE after" if before else "RMSE": "rmse_after"}
    errors["max |error|"] = "max_abs_after"
    errors = errors if before else {title: name for title, name in errors.items() if name != "rmse_before"}
    table = [("file", *words, "samples", *errors, "worst stretch", "RMSE there")]
    for row in shown:
        stretch = ("-", "-") if row.worst is None else (str(row.worst), error_text(row.worst.rmse))
        texts = (error_text(getattr(row, name)) for name in errors.values())
        table.append((row.file or "-", *(getattr(row, name) for name in words), str(row.samples), *texts, *stretch))
    return table


def error_text(error: float) -> str:
    """Return an error as text for a table.

    >>> error_text(1234.5), error_text(0.1)
    ('1234', '0.1000')
    """
    # `#` keeps zeros at the end, but also a point behind four whole digits
    return f"{error:#.4g}".rstrip(".")
