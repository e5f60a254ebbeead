"""The sections of a report, each from what it tells about to markup and pictures."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from kennfeld.analysis import Residuals, WorstSample, output_ranges, pressing
from kennfeld.analysis.series import Series
from kennfeld.arrays import Bool
from kennfeld.optimize import Equality
from kennfeld.parameters import Parameter
from kennfeld.report import figures
from kennfeld.report.facts import sources
from kennfeld.report.left import left_table
from kennfeld.report.markup import Child, Html, details, element, table
from kennfeld.report.numbers import MISSING, percent, recorded, shown, with_unit
from kennfeld.report.settings import settings
from kennfeld.report.subject import Change, Score, Subject
from kennfeld.report.verdict import pooled, remarks, verdict

__all__ = ["Pictures", "sections"]

OPEN_PARTS = 4  # how many datasets, and parameters, are unfolded at first
MOST_LISTED = 8
MOST_TEXT = 60_000  # characters of a formula or project file


class Pictures:
    """The pictures of a page by number; each leaves a place where the page draws it."""

    def __init__(self) -> None:
        self.data: list[figures.Figure] = []

    def place(self, figure: figures.Figure | None, caption: str, label: str) -> Html | None:
        """A place for a picture, with a caption and, for those who cannot see it, a label."""
        if figure is None:
            return None
        self.data.append(figure)
        number = str(len(self.data) - 1)
        drawn = element("div", class_="plot", data_figure=number, role="img", aria_label=label)
        return element("figure", drawn, element("figcaption", caption) if caption else None, class_=figure["kind"])


Section = tuple[str, str, Html, Sequence[tuple[str, str]]]  # anchor, title, content, entries of the table of contents


def sections(subject: Subject, pictures: Pictures) -> Iterator[Section]:
    """Anchor, title, content and entries of each section."""
    yield "result", "Result", _result(subject), ()
    yield "fit", "Measured and calculated", _fit(subject, pictures), ()
    yield "residuals", "Residuals", _residuals(subject, pictures), ()
    content, entries = _parameters(subject, pictures)
    yield "parameters", "Parameters", content, entries
    if subject.result is not None:
        yield "undetermined", "What the data do not determine", _undetermined(subject), ()
        yield "limits", "Limits that hold", _limits(subject), ()
        yield "search", "Search", _search(subject, pictures), ()
    yield "messages", "Messages of the check", _messages(subject), ()
    yield "settings", "Settings and files", _settings(subject), ()


def _note(text: str) -> Html:
    return element("p", text, class_="note")


# Result


def _result(subject: Subject) -> Html:
    points = [element("li", remark.text, class_=remark.kind) for remark in remarks(subject)]
    return element(
        "div",
        element("p", verdict(subject), class_="verdict"),
        element("div", [_tile(*tile) for tile in _tiles(subject)], class_="tiles"),
        _score_table(subject),
        element("ul", points, class_="remarks") if points else None,
    )


def _tiles(subject: Subject) -> Iterator[tuple[str, str, str]]:
    """Label, number, and what stands below it."""
    done = subject.result is not None
    for number in dict.fromkeys(score.number for score in subject.scores):
        mine = [score for score in subject.scores if score.number == number]
        name = f"{mine[0].criterion}, " if len(subject.problem.criteria) > 1 else ""
        for use in ("training", "test"):
            if part := [score for score in mine if score.use == use]:
                score = pooled(part)
                below = f"before {with_unit(score.rmse[0], score.unit, 4)}" if done else f"{score.samples} samples"
                yield f"{name}RMSE, {use}", with_unit(score.rmse[1], score.unit, 4), below
                if number == 0:
                    below = f"before {with_unit(score.largest[0], score.unit, 4)}" if done else use
                    yield f"{name}largest error, {use}", with_unit(score.largest[1], score.unit, 4), below
    if subject.result is not None:
        result = subject.result
        count = len(subject.changes)
        yield "values", str(result.free_values), f"of {count} parameter{'s' * (count != 1)}"
        yield "time", f"{shown(result.seconds.total, 3)} s", f"{result.iterations} iterations"


def _tile(label: str, number: str, below: str) -> Html:
    value, _, unit = number.partition(" ")
    large = element("b", value, [" ", element("small", unit)] if unit else None)
    return element("div", element("span", label, class_="label"), large, element("span", below), class_="tile")


def _score_table(subject: Subject) -> Html:
    done = subject.result is not None
    head = ["criterion", "dataset", "use", "samples", "unit"]
    head += ["RMSE before", "RMSE after", "change", "R2 before", "R2 after", "max |error| before", "max |error| after"]
    if not done:
        head = [*head[:5], "RMSE", "R2", "max |error|"]
    return table(head, [_score_row(score, done=done) for score in subject.scores], words=3, class_="wide")


def _score_row(score: Score, *, done: bool) -> list[str]:
    first = [score.criterion, score.dataset, score.use, str(score.samples), score.unit or MISSING]
    if not done:
        return [*first, *(shown(pair[1]) for pair in (score.rmse, score.r2, score.largest))]
    before, after = score.rmse
    change = percent(after / before - 1.0) if np.isfinite(before) and before > 0 else MISSING
    return [
        *first,
        *(shown(before), shown(after), change if change.startswith(("-", MISSING)) else f"+{change}"),
        *(f"{value:.4f}" if np.isfinite(value) and abs(value) < 1e4 else shown(value) for value in score.r2),
        *(shown(value) for value in score.largest),
    ]


# Measured and calculated


def _fit(subject: Subject, pictures: Pictures) -> Html:
    pairs = list(zip(subject.before, subject.after, strict=True))
    parts = []
    for i, (before, after) in enumerate(pairs):
        of = dict(subject.numbered)[after.criterion]
        data = after.bound.dataset
        summary = [element("b", data.name), f" {of.criterion} against {of.target}, {_samples(after)}, {data.use}"]
        parts.append(
            details(summary, _pictures(before, after, of, len(pairs), pictures), open_=i < OPEN_PARTS, class_="part")
        )
    return element("div", parts or _note("No sample is scored."))


def _samples(series: Series) -> str:
    scored, kept = int(series.scored.sum()), series.bound.count
    dropped = series.bound.dataset.samples - kept
    said = f"{scored} sample{'s' * (scored != 1)}" + (f" scored of {kept}" if kept != scored else "")
    return said + (f", {dropped} left out for lack of an input" if dropped else "")


def _pictures(before: Series, after: Series, of: Residuals, count: int, pictures: Pictures) -> list[Html | None]:
    name = after.bound.dataset.name
    strip = figures.strip(before, after, count)
    drawn = "" if strip["whole"] else f" {after.model.size} samples are drawn as an envelope of least and greatest."
    zoom = "Drag to zoom, double-click to go back; click a name to hide or show it."
    worst = [w.sample for w in of.worst if w.dataset == name]
    scatter = figures.scatter(before, after, count, worst)
    dots = len(scatter["number"])
    some = f" {dots} of {scatter['samples']} samples, the worst among them." if dots < scatter["samples"] else ""
    return [
        pictures.place(strip, zoom + drawn, f"measured and calculated {of.criterion} on {name}"),
        element(
            "div",
            pictures.place(scatter, f"Calculated over measured.{some}", f"calculated over measured, {name}"),
            pictures.place(figures.histograms(before, after), "How the errors are spread.", f"errors on {name}"),
            class_="row two",
        ),
    ]


# Residuals


def _residuals(subject: Subject, pictures: Pictures) -> Html:
    return element("div", [_of_criterion(subject, number, of, pictures) for number, of in subject.numbered])


def _of_criterion(subject: Subject, number: int, of: Residuals, pictures: Pictures) -> Html:
    several = len(subject.problem.criteria) > 1
    memories = [
        pictures.place(
            figures.autocorrelation(of, row.dataset),
            f"{row.dataset}: correlation of the error with itself later. Errors without memory stay in the grey band; "
            f"{row.samples} samples tell as much as {shown(row.autocorrelation.independent, 3)} independent ones.",
            f"autocorrelation of the errors on {row.dataset}",
        )
        for row in of.summaries
        if row.autocorrelation is not None
    ]
    maps = [
        pictures.place(
            figures.cells([c for c in of.cells if c.parameter == name], subject.parameters[name], of.unit, inputs),
            f"Mean error by cell of {name}; point at a cell for its RMSE and its samples.",
            f"errors by cell of {name}",
        )
        for name, inputs in {c.parameter: subject.inputs(c.parameter) for c in of.cells}.items()
    ]
    return element(
        "div",
        element("h3", f"{of.criterion} against {of.target}") if several else None,
        element("h4", "By dataset"),
        _summary_table(of),
        _note(_how_scaled(of)),
        [element("h4", "In time"), element("div", memories, class_="row two")] if memories else None,
        [element("h4", "By cell of a table"), _folded(maps)] if maps else None,
        element("h4", "The worst samples"),
        _note("Of neighbours in time whose errors have one sign, only the worst is listed.") if memories else None,
        _worst_table(of),
    )


def _folded(maps: Sequence[Html | None]) -> list[Child]:
    """The first pictures, and the others folded away."""
    first, rest = maps[:6], maps[6:]
    shown_first = element("div", first, class_="row two")
    return (
        [shown_first, details(f"{len(rest)} more tables", element("div", rest, class_="row two"))]
        if rest
        else [shown_first]
    )


def _how_scaled(of: Residuals) -> str:
    s = with_unit(of.deviation, of.unit)
    if of.scaling == "studentized":
        return (
            f"Errors are model minus measurement. Scaled errors are studentized: divided by s sqrt(1 - h), where "
            f"s = {s} is their standard deviation over the training data and h the leverage of the sample. "
            "Of normal errors, 0.27 % are beyond 3."
        )
    return (
        f"Errors are model minus measurement. Scaled errors are standardised: divided by {s}, their root mean square "
        "over the training data. Of normal errors, 0.27 % are beyond 3."
    )


def _summary_table(of: Residuals) -> Html:
    head = ["dataset", "use", "samples", "mean error", "std deviation", "RMSE", "median |error|", "95 % below"]
    head += ["max |error|", "median relative", "scaled beyond 3"]
    rows = [
        [
            *(row.dataset, row.use, str(row.samples)),
            # a mean that is rounding noise would look like a finding
            shown(0.0 if abs(row.mean) < 1e-4 * row.rmse else row.mean),
            *(shown(x) for x in (row.deviation, row.rmse, row.median, row.percentile_95, row.largest)),
            *(percent(row.relative), percent(row.beyond)),
        ]
        for row in of.summaries
    ]
    return table(head, rows, words=2, class_="wide")


def _worst_table(of: Residuals) -> Html:
    timed = any(w.time is not None for w in of.worst)
    inputs = list(dict.fromkeys(name for w in of.worst for name in w.inputs))
    head = ["dataset", "use", "sample", *(["recording", "time [s]"] if timed else [])]
    head += ["measured", "calculated", "error", "relative", "scaled", *inputs]
    return table(head, [_worst_row(w, inputs, timed=timed) for w in of.worst], words=2, class_="wide")


def _worst_row(worst: WorstSample, inputs: Sequence[str], *, timed: bool) -> list[str]:
    place = [str(worst.piece + 1), recorded(worst.time)] if timed else []
    return [
        *(worst.dataset, worst.use, str(worst.sample), *place, recorded(worst.measured), shown(worst.model, 5)),
        *(shown(worst.error), percent(worst.relative), shown(worst.scaled, 3)),
        *(recorded(worst.inputs[name]) for name in inputs),
    ]


# Parameters


def _parameters(subject: Subject, pictures: Pictures) -> tuple[Html, list[tuple[str, str]]]:
    scalars = [c for c in subject.changes if c.after.size == 1]
    tables = [c for c in subject.changes if c.after.size > 1]
    cards = [_card(i, c, pictures, subject) for i, c in enumerate(tables)]
    entries = [(f"parameter-{i}", c.name) for i, c in enumerate(tables)]
    fixed = [n for n in subject.problem.model.graph.parameters if n not in subject.problem.free_names]
    content = element(
        "div",
        _note(
            "The parameters that are free to be fitted."
            if subject.result is None
            else "The parameters that were fitted, the greatest change first. The relative change is the root mean "
            "square of the change over that of the values."
        ),
        _overview(tables) if tables else None,
        [element("h4", "Scalars"), _scalar_table(scalars)] if scalars else None,
        _breakpoints(subject),
        cards,
        details(f"{len(fixed)} parameters were kept", _fixed_table(subject, fixed)) if fixed else None,
    )
    return content, entries


def _overview(changes: Sequence[Change]) -> Html:
    head = ["parameter", "kind", "unit", "values", "relative change", "largest change", "without data", "at a bound"]
    head += ["median std deviation"] if any(c.deviation is not None for c in changes) else []
    rows = []
    for i, c in enumerate(changes):
        size = "x".join(map(str, c.after.values.shape))
        row = [
            element("a", c.name, href=f"#parameter-{i}"),
            *(c.after.kind, c.after.unit or MISSING, size, percent(c.size), shown(float(np.max(np.abs(c.difference))))),
            *(_count(c.uncovered), _count(c.bound != 0)),
        ]
        if c.deviation is not None:
            row.append(_deviation(float(np.median(c.deviation))))
        rows.append(row if len(row) == len(head) else [*row, MISSING])
    return table(head, rows, words=3, class_="wide")


def _count(marked: Bool) -> str:
    count = int(np.count_nonzero(marked))
    return str(count) if count else MISSING


def _scalar_table(changes: Sequence[Change]) -> Html:
    known = any(c.deviation is not None for c in changes)
    head = [
        "parameter",
        "unit",
        "before",
        "after",
        "change",
        *(["std deviation"] if known else []),
        "lower",
        "upper",
        "",
    ]
    rows = []
    for c in changes:
        before, after = float(c.before.values.item()), float(c.after.values.item())
        lower, upper = float(c.after.lower.item()), float(c.after.upper.item())
        deviation = [] if not known else [MISSING if c.deviation is None else _deviation(float(c.deviation.item()))]
        rows.append(
            [
                *(c.name, c.after.unit or MISSING, shown(before, 7), shown(after, 7), shown(after - before)),
                *(*deviation, shown(lower), shown(upper), _state(c)),
            ]
        )
    return table(head, rows, words=2, class_="wide")


def _breakpoints(subject: Subject) -> list[Html] | None:
    """Those that were fitted, with how far they can be trusted."""
    trust, rows = subject.trust, []
    for key, axis in subject.problem.free_axes.items() if subject.result is not None else ():
        name = f"axis {key}" if str(key) in subject.problem.parameters else str(key)
        place, which = axis.places[0]
        after = subject.parameters[place].axes[which].breakpoints
        if after.size != len(axis.axis):
            continue
        deviation, samples = trust.deviation.get(name), trust.samples.get(name)
        for i, (old, new) in enumerate(zip(axis.axis.breakpoints, after, strict=True)):
            known = deviation is not None and np.size(deviation) == after.size
            rows.append(
                [
                    *(name, str(i + 1), axis.axis.unit or MISSING, shown(old, 6), shown(new, 6), shown(new - old)),
                    _deviation(float(deviation[i])) if known and deviation is not None else MISSING,
                    MISSING if samples is None or np.size(samples) != after.size else str(int(samples[i])),
                ]
            )
    head = ["axis", "breakpoint", "unit", "before", "after", "change", "std deviation", "samples"]
    return [element("h4", "Breakpoints"), table(head, rows, words=1, class_="wide")] if rows else None


def _deviation(value: float) -> str:
    return "not determined" if np.isinf(value) else shown(value, 3)


def _state(change: Change) -> str:
    """What holds a scalar."""
    if change.after.locked.any():
        return "locked"
    if change.informed is not None and not change.informed.all():
        return "no data: kept"
    return {-1: "at the lower bound", 1: "at the upper bound", 0: ""}[int(change.bound.item())]


def _card(number: int, change: Change, pictures: Pictures, subject: Subject) -> Html:
    after = change.after
    unit = f" [{after.unit}]" if after.unit not in ("", "-") else ""
    parts = [element("b", change.name), f"{unit} {after.kind} of {'x'.join(map(str, after.values.shape))}"]
    parts.append(f", changed by {percent(change.size)}" if subject.result is not None else "")
    words = [after.description] if after.description else []
    if change.moved:
        words.append("Breakpoints have moved; the values before are interpolated at the new ones.")
    return details(
        parts,
        _note(". ".join(word.rstrip(".") for word in words) + ".") if words else None,
        pictures.place(figures.parameter(change, subject.inputs(change.name)), "", f"{change.name} before and after"),
        open_=number < OPEN_PARTS,
        class_="part card",
        id=f"parameter-{number}",
    )


def _fixed_table(subject: Subject, names: Sequence[str]) -> Html:
    rows = []
    for name in names:
        p = subject.parameters[name]
        size = "x".join(map(str, p.values.shape)) or "1"
        rows.append([name, p.kind, p.unit or MISSING, size, _range(p)])
    return table(["parameter", "kind", "unit", "values", "value"], rows, words=3)


def _range(parameter: Parameter) -> str:
    low, high = float(parameter.values.min()), float(parameter.values.max())
    return shown(low, 6) if low == high else f"{shown(low)} to {shown(high)}"


# Trust, limits, search, messages


def _undetermined(subject: Subject) -> Html:
    trust = subject.trust
    lines = [element("li", element("b", d.sentence), f" {d.remedy}") for d in trust.directions]
    rows = [
        [c.name, str(c.after.size), *(_known_count(x) for x in _states_of(c))]
        for c in subject.changes
        if any(x is not None and np.any(x) for x in _states_of(c))
    ]
    head = ["parameter", "values", "without training data", "held by smoothness alone", "held by nothing: start kept"]
    nothing = "Every value is informed by training data." if not rows else None
    return element(
        "div",
        _note(trust.remark) if trust.remark else None,
        element("ul", lines, class_="directions") if lines else None,
        table(head, rows, class_="wide") if rows else None,
        _note(nothing) if nothing else None,
        left_table(subject.left),
    )


def _states_of(change: Change) -> tuple[Bool, Bool | None, Bool | None]:
    kept = None if change.informed is None else ~change.informed
    return change.uncovered, change.by_smoothness, kept


def _known_count(marked: Bool | None) -> str:
    return MISSING if marked is None else str(int(np.count_nonzero(marked)))


def _limits(subject: Subject) -> Html:
    rows = []
    for c in subject.changes:
        for side, word in ((-1, "lower"), (1, "upper")):
            at = np.argwhere(c.bound == side)
            if len(at):
                limit = (c.after.lower if side < 0 else c.after.upper)[c.bound == side]
                text = shown(float(limit[0])) if limit.min() == limit.max() else "of each value"
                rows.append([c.name, f"{word} bound {text}", str(len(at)), _places(c.after, at)])
        if c.after.locked.any():
            at = np.argwhere(c.after.locked)
            rows.append([c.name, "locked", str(len(at)), _places(c.after, at)])
    rows += _linear(subject)
    outputs = _outputs(subject)
    held = [element("li", sentence) for sentence in subject.trust.holdings]
    if not rows and not outputs and not held:
        return _note("No value lies at a bound, and nothing is locked or pinned.")
    linear = table(["parameter", "limit", "values", "where"], rows, words=4, class_="where") if rows else None
    return element("div", linear, outputs, element("ul", held, class_="directions") if held else None)


def _linear(subject: Subject) -> Iterator[list[str]]:
    """Pins, and the shapes and equalities that press."""
    for pin in subject.problem.pins:
        where = ", ".join(recorded(x) for x in pin.at)
        yield [pin.parameter, f"pinned to {recorded(pin.value)}", "1", f"at {where}" if where else ""]
    for held in pressing(subject.problem, subject.parameters):
        constraint = held.constraint
        if isinstance(constraint, Equality):
            names = ", ".join(dict.fromkeys(term.parameter for term in constraint.terms))
            yield [names, f"equality {constraint}", "", ""]
        elif held.active:
            axis = "xyzw"[constraint.axis]
            ends = f"from {recorded(constraint.lower)} to {recorded(constraint.upper)}"
            prefix = f"{constraint.kind} of {constraint.parameter} along {axis} "
            listed = "; ".join(name.removeprefix(prefix) for name in held.active[:MOST_LISTED])
            more = f" and {len(held.active) - MOST_LISTED} more" if len(held.active) > MOST_LISTED else ""
            limit = f"{constraint.kind} along {axis} {ends}"
            yield [constraint.parameter, limit, f"{len(held.active)} of {held.rows}", listed + more]


def _outputs(subject: Subject) -> Html | None:
    """How far the limited outputs come to their limits."""
    before = output_ranges(subject.problem, subject.problem.parameters)
    after = output_ranges(subject.problem, subject.parameters)
    rows = [
        [
            new.limit.node,
            f"{recorded(new.limit.lower)} to {recorded(new.limit.upper)}",
            new.limit.where or "everywhere",
            str(new.samples),
            *(f"{shown(one.least)} to {shown(one.greatest)}" for one in (old, new)),
            *(str(one.beyond) for one in (old, new)),
        ]
        for old, new in zip(before, after, strict=True)
    ]
    head = ["output", "limit", "where", "samples", "range before", "range after", "beyond before", "beyond after"]
    return table(head, rows, words=3, class_="wide") if rows else None


def _places(parameter: Parameter, at: Any) -> str:
    """Coordinates of grid points, the first few."""
    axes = parameter.index_axes
    listed = [", ".join(recorded(float(a.breakpoints[i])) for a, i in zip(axes, point, strict=True)) for point in at]
    if not axes:
        return ""
    more = f" and {len(listed) - MOST_LISTED} more" if len(listed) > MOST_LISTED else ""
    return "; ".join(listed[:MOST_LISTED]) + more


def _search(subject: Subject, pictures: Pictures) -> Html:
    result = subject.result
    assert result is not None
    picture = pictures.place(
        figures.convergence(subject),
        "Cost over the accepted steps, a colour a stage. Smoothed stages have another cost than the exact model.",
        "cost over the steps",
    )
    rows = [
        ("status", result.status),
        ("how it ended", result.message),
        ("cost before, after", f"{shown(result.cost_before, 6)}, {shown(result.cost_after, 6)}"),
        ("iterations, evaluations", f"{result.iterations}, {result.evaluations}"),
        ("values free, fixed", f"{result.free_values}, {result.fixed_values}"),
        ("time", ", ".join(f"{name} {shown(value, 3)} s" for name, value in vars(result.seconds).items())),
    ]
    return element("div", picture, table(["", ""], rows, words=2, class_="facts"), _starts(subject))


def _starts(subject: Subject) -> Html | None:
    """A row for each of several starts."""
    starts = subject.result.starts if subject.result else ()
    if len(starts) < 2:
        return None
    head = ["start", "status", "how it ended", "cost before", "cost after", "distance", "iterations"]
    rows = [
        [
            *(str(row.start), row.status, row.message),
            *(shown(row.cost_before, 6), shown(row.cost_after, 6), shown(row.distance, 3), str(row.iterations)),
        ]
        for row in starts
    ]
    note = "The distance is from the values of the best start, each parameter relative to its size there."
    return element("div", table(head, rows, words=3, class_="where"), _note(note))


def _messages(subject: Subject) -> Html:
    if not subject.findings:
        return _note("The check of the project found nothing to remark.")
    return element("ul", [element("li", str(f), class_=f.severity) for f in subject.findings], class_="remarks")


# Settings and files


def _settings(subject: Subject) -> Html:
    project = subject.project
    files = sources(project)
    rows = [[f.role, f.name, _size(f.size), f.changed or MISSING, element("code", f.digest or MISSING)] for f in files]
    function = project.file.folder / project.file.model.file
    return element(
        "div",
        table(["file", "", "size", "changed", "SHA-256"], rows, words=5, class_="wide files"),
        details("Settings", table(["section", "key", "value"], settings(project), words=3), open_=True),
        details(f"The project file, {project.path.name}", _text(_read(project.path))),
        details(f"The function, {function.name}", _text(_read(function))) if function.suffix == ".kf" else None,
    )


def _read(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8", errors="replace")
    except OSError as error:
        return f"cannot be read: {error.strerror}"


def _text(text: str) -> Html:
    cut = text if len(text) <= MOST_TEXT else text[:MOST_TEXT] + "\n..."
    return element("pre", cut)


def _size(count: int) -> str:
    """A file size as people read it.

    >>> _size(123), _size(123456)
    ('123 B', '123 kB')
    """
    for unit, scale in (("GB", 1e9), ("MB", 1e6), ("kB", 1e3)):
        if count >= scale:
            return f"{shown(count / scale, 3)} {unit}"
    return f"{count} B"
