"""Report section of a cross-validation."""

from collections.abc import Sequence

from kennfeld.analysis.validation_result import CrossValidation, FoldQuality
from kennfeld.base.markup import MISSING, Html, decimal, element, note, table

EXPLANATION = (
    "Each fold was held out once: the other folds were calibrated from the same start, and the result was scored on it."
)
SPREAD = "The spread is the standard deviation over the folds."


def render_validation(validation: CrossValidation) -> Html:
    """Return the conclusions and the errors of each fold, a table for each criterion."""
    several = len(validation.criteria) > 1
    parts = [[element("h3", name) if several else None, _fold_table(validation, name)] for name in validation.criteria]
    conclusions = [element("li", text) for text in validation.conclusions()]
    return element("div", note(EXPLANATION), element("ul", conclusions, class_="remarks"), parts, note(SPREAD))


def _fold_table(validation: CrossValidation, criterion: str) -> Html:
    head = ["fold", "held out", "status", "samples", "RMSE training", "RMSE held out", "ratio"]
    rows = [_cells(row) for row in validation.folds if row.criterion == criterion]
    mean, training = validation.mean(criterion), validation.training(criterion)
    rows.append(["mean", "", "", "", decimal(training), decimal(mean), _ratio(mean, training)])
    rows.append(["spread", "", "", "", "", decimal(validation.spread(criterion)), ""])
    return table(head, rows, words=3, class_="wide")


def _cells(row: FoldQuality) -> Sequence[str]:
    errors = decimal(row.rmse_training), decimal(row.rmse_held), _ratio(row.rmse_held, row.rmse_training)
    return [str(row.fold), row.held, row.status, str(row.samples), *errors]


def _ratio(held: float, training: float) -> str:
    return decimal(held / training, 3) if training > 0 else MISSING
