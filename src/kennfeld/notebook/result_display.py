"""Results, trust, cross-validations and findings as HTML."""

from collections.abc import Iterable, Sequence

import numpy as np

from kennfeld.analysis.validation_result import CrossValidation
from kennfeld.base.errors import Finding
from kennfeld.base.formatting import count_noun
from kennfeld.base.markup import Child, Html, decimal, element
from kennfeld.notebook.tables import block, caption, lines, text_table
from kennfeld.optimize.fit.result import Result
from kennfeld.optimize.trust.trust import Trust

MAX_DIRECTIONS = 5
SETTLE = "What would settle the first of them, if anything: kennfeld.design(result, direction=1)"
_COLOURS = {"error": "#d64545", "warning": "#d08700", "remark": "#3b8eea"}  # legible on white and on black
_ORDER = tuple(_COLOURS)


def result_html(result: Result) -> Html:
    """Return status, errors by criterion and dataset, and what the data do not determine."""
    heading, *rows = result.table()
    effort = f"{count_noun(result.free_values, 'value')}, {count_noun(result.iterations, 'iteration')}, "
    starts = []
    if len(result.starts) > 1:
        head, *body = result.starts_table()
        starts = [text_table(head, body, words=2)]
    return block(
        [element("b", result.status), f": {result.message}"],
        text_table(heading, rows, words=3),
        *starts,
        *findings_parts(result.warnings),
        caption(f"{effort}{result.seconds.total:.2f} s"),
        *_undetermined(result.trust),
    )


def trust_html(trust: Trust) -> Html:
    """Return how well the data determine the values of each table."""
    rows = []
    for name, deviation in trust.deviation.items():
        known = deviation[np.isfinite(deviation)]
        samples = trust.samples.get(name, np.zeros(0, dtype=np.int64))
        rows.append(
            (
                name,
                str(deviation.size),
                str(int(np.count_nonzero(np.isinf(deviation)))),
                str(int(np.count_nonzero(trust.by_smoothness.get(name, False)))),
                str(int(samples.min())) if samples.size else "",
                decimal(float(np.median(known)) if known.size else None),
                decimal(float(known.max()) if known.size else None),
            )
        )
    heading = ("parameter", "values", "undetermined", "by smoothness", "fewest samples", "median deviation", "largest")
    noise = ", ".join(f"{name} {decimal(value)}" for name, value in trust.noise.items())
    notes = [caption(f"noise: {noise}")] if noise else []
    return block(element("b", "Trust"), *([text_table(heading, rows)] if rows else []), *notes, *_undetermined(trust))


def _undetermined(trust: Trust) -> list[Html]:
    sentences = [trust.remark] if trust.remark else []
    if trust.null_space.dimension > 1:
        sentences.append(str(trust.null_space))
    directions = [direction for direction in trust.directions if not direction.determined]
    sentences += list(map(str, directions[:MAX_DIRECTIONS]))
    more = len(directions) - MAX_DIRECTIONS
    sentences += [f"and {more} more in trust.directions"] if more > 0 else []
    sentences += [SETTLE] if directions else []
    active = [str(limit) for limit in trust.holdings if limit.samples]
    parts = []
    for title, texts in (("Parameters not determined by the data:", sentences), ("Active output limits:", active)):
        if texts:
            parts += [element("div", title), lines(texts)]
    return parts


def cross_validation_html(validation: CrossValidation) -> Html:
    """Return the folds and the mean of each criterion."""
    heading, *rows = validation.table()
    return block(element("b", "Cross-validation"), text_table(heading, rows, words=3), lines(validation.summary()))


def findings_html(findings: Iterable[Finding]) -> Html:
    """Return findings, errors first."""
    ordered = sorted(findings, key=lambda finding: _ORDER.index(finding.severity))
    counts = [count_noun(n, word) for word in _ORDER if (n := sum(f.severity == word for f in ordered))]
    title = element("b", ", ".join(counts) or "No findings")
    return block(title, *findings_parts(ordered))


def findings_parts(findings: Sequence[Finding]) -> list[Html]:
    """Return a table of findings, none without any."""
    rows: list[tuple[Child, ...]] = []
    for finding in findings:
        word = element("b", finding.severity, style=f"color:{_COLOURS[finding.severity]}")
        message = [element("div", finding.message), element("div", finding.remedy) if finding.remedy else None]
        excerpt = element("pre", finding.excerpt, style="margin:2px 0") if finding.excerpt else None
        rows.append((word, str(finding.location), element("div", message, excerpt, style="white-space:normal")))
    return [text_table(("", "location", "message"), rows, words=3)] if rows else []
