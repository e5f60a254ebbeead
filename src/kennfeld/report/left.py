"""Where surrogates are used outside the data they were trained on, as a table."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from kennfeld.report.markup import Html, table
from kennfeld.report.numbers import MISSING, percent

if TYPE_CHECKING:  # most projects have no surrogates
    from kennfeld.analysis.leaving import Leaving

__all__ = ["left_table"]

HEAD = ("surrogate", "dataset", "use", "farthest outside its data", "samples", "outside", "share")


def left_table(found: "Sequence[Leaving]") -> Html | None:
    """A row for each surrogate and dataset; None where there is none."""
    return table(HEAD, [_row(row) for row in found], words=4, class_="wide") if found else None


def _row(row: "Leaving") -> list[str]:
    counts = (MISSING, MISSING) if row.outside is None else (str(row.outside), percent(row.share))
    farthest = MISSING if row.worst is None else f"{row.place}: {row.worst.sentence}"
    return [row.name, row.dataset, row.use, farthest, str(row.samples), *counts]
