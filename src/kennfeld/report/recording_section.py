"""Report section of the errors by recording, for datasets of several files."""

from collections.abc import Sequence

from kennfeld.base.formatting import count_noun
from kennfeld.base.markup import MISSING, Html, change, decimal, details, element, note, table
from kennfeld.optimize.quality.recording_quality import (
    LEAST_SECONDS,
    SHARE,
    RecordingQuality,
    of_several_files,
    worst_first,
)
from kennfeld.report.report_data import ReportData

SHOWN = 10  # rows that are not folded
MOST = 1000  # rows of a criterion; more would make the page slow
EXPLANATION = (
    f"The worst recordings first. The worst stretch is the part of 1/{SHARE} of a recording, at least "
    f"{LEAST_SECONDS:g} s, with the largest RMSE after the calibration; its times are those of the file."
)


def render_recordings(report: ReportData) -> Html | None:
    """Return a table of the files of each criterion; None if no dataset has several files."""
    rows = worst_first(of_several_files(report.recordings))
    if not rows:
        return None
    criteria = list(dict.fromkeys(row.criterion for row in rows))
    parts = [
        [element("h3", name) if len(criteria) > 1 else None, _folded(report, [r for r in rows if r.criterion == name])]
        for name in criteria
    ]
    return element("div", note(EXPLANATION), parts)


def _folded(report: ReportData, rows: Sequence[RecordingQuality]) -> list[Html | None]:
    """Return the first rows, and the others behind a heading that unfolds them."""
    # to fold one or two rows would save no room
    shown = len(rows) if len(rows) <= SHOWN + 2 else SHOWN
    rest, hidden = rows[shown:MOST], rows[MOST:]
    text = f"{count_noun(len(hidden), 'further recording')} with smaller errors; result.json has all of them."
    return [
        _table(report, rows[:shown]),
        details(count_noun(len(rest), "more recording"), _table(report, rest)) if rest else None,
        note(text) if hidden else None,
    ]


def _table(report: ReportData, rows: Sequence[RecordingQuality]) -> Html:
    is_calibrated = report.result is not None
    head = ["file", "dataset", "use", "samples"]
    head += ["RMSE before", "RMSE after", "change"] if is_calibrated else ["RMSE"]
    cells = [_cells(row, is_calibrated=is_calibrated) for row in rows]
    return table([*head, "max |error|", "worst stretch", "RMSE there"], cells, words=3, class_="wide")


def _cells(row: RecordingQuality, *, is_calibrated: bool) -> list[str]:
    before, after = row.rmse_before, row.rmse_after
    errors = [decimal(before), decimal(after), change(before, after)] if is_calibrated else [decimal(after)]
    worst = (MISSING, MISSING) if row.worst is None else (str(row.worst), decimal(row.worst.rmse))
    return [row.file or MISSING, row.dataset, row.use, str(row.samples), *errors, decimal(row.max_abs_after), *worst]
