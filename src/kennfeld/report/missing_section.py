"""Report section of terms that the function may lack."""

from kennfeld.analysis.missing.hints import Hints
from kennfeld.base.markup import Html, element, note


def render_missing(hints: Hints, project: str) -> Html:
    """Return what the best term would take off the cost, and what the values themselves would.

    Args:
        hints: of the calibration.
        project: name of the project file.
    """
    method = (
        "Estimated by one linearisation of the function, not by a fit. For proposals that are fitted and judged on "
        f"held-out data, over all recorded channels, run kennfeld propose {project}."
    )
    return element("div", [element("p", line) for line in hints.lines()], note(method) if hints.scored else None)
