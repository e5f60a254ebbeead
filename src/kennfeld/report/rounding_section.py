"""Report section "What is flashed": the rounding to what a control unit can store."""

from kennfeld.base.markup import MISSING, Html, change, decimal, element, note, table
from kennfeld.optimize.rounding.outcome import ERRORS, RoundingResult

METHODS = {
    "joint": "The values of this result are rounded together, so that they make up for each other.",
    "nearest": "Each value of this result is rounded to the nearest storable one.",
}
SHARES = (
    "The share of a label is the part of the loss that would vanish if it alone were stored without steps. Shares need "
    "not add up to 100 %, as labels make up for each other."
)


def render_rounding(rounding: RoundingResult) -> Html:
    """Return the errors before and after rounding, and what each label contributes."""
    head = ["criterion / dataset", *(f"RMSE {name}" for name in ERRORS), "nearest", "joint"]
    rows = [_cells(rounding, key) for key in rounding.unrounded]
    shift = f"No value is farther than {rounding.max_shift:g} steps from the fit."
    return element(
        "div",
        note(f"{METHODS[rounding.method]} {shift}"),
        table(head, rows, words=1, class_="wide"),
        [element("p", sentence) for sentence in rounding.advice()],
        table(*_labels(rounding), words=1, class_="wide"),
        note(SHARES),
    )


def _cells(rounding: RoundingResult, key: str) -> list[str]:
    before, nearest, joint = (getattr(rounding, name).get(key, float("nan")) for name in ERRORS)
    return [key, decimal(before), decimal(nearest), decimal(joint), change(before, nearest), change(before, joint)]


def _labels(rounding: RoundingResult) -> tuple[list[str], list[list[str]]]:
    head, *rows = rounding.label_table()
    return list(head), [[MISSING if cell == "-" else cell for cell in row] for row in rows]
