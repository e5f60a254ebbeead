"""Strip charts, scatter plots and histograms."""

from collections.abc import Sequence
from contextlib import suppress

import numpy as np

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.questions.error_split import nearest
from kennfeld.app.session.distributions import common_bins, drawn_samples, histogram
from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.selection import read_selection, read_signal
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SignalName
from kennfeld.app.session.strips import Statistics, describe, statistics, strip
from kennfeld.app.session.view import View
from kennfeld.base.arrays import Bool, Float
from kennfeld.base.errors import KennfeldError

MAX_PIXELS = 8192  # of a screen
MAX_MATRIX_POINTS = 2500  # samples in each plot of a scatter matrix


def strip_chart(session: Session, given: Given) -> Answer:
    """Return `signals` over a stretch of a `dataset`, from `begin` to `end`, as arrays `x`, `0`, `1`, ...

    Samples that `only` does not select are gaps; `lit` is above 0 where `brush` selects one. `missing` gives the reason
    for each signal that the dataset lacks.
    """
    view, recording = _dataset(session, given)
    pixels = max(1, min(int(given["pixels"]), MAX_PIXELS))
    stretch = float(given["begin"]), float(given["end"])
    only, brush = (read_selection(given.get(key)) for key in ("only", "brush"))
    wanted = _signals(given)
    missing = _missing(view, recording, wanted)
    present = [number for number in range(len(wanted)) if number not in missing]
    drawn = strip(view.signals, recording, [wanted[number] for number in present], *stretch, pixels, only, brush)
    lines = {str(number): values for number, values in zip(present, drawn.lines, strict=True)}
    return Answer(
        {"begin": drawn.begin, "raw": drawn.raw, "missing": missing}, {"x": drawn.positions, "lit": drawn.lit, **lines}
    )


def stretch_statistics(session: Session, given: Given) -> Answer:
    """Return statistics of `signals` over the samples of a `dataset` that `brush` selects, or from `begin` to `end`."""
    view, recording = _dataset(session, given)
    chosen, wanted = _mask(view, recording, given, "brush"), _signals(given)
    missing = _missing(view, recording, wanted)

    def row(signal: SignalName) -> Statistics:
        if chosen is not None:
            return describe(view.signals.values(recording, signal)[chosen])
        return statistics(view.signals, recording, signal, float(given["begin"]), float(given["end"]))

    rows = [describe(np.zeros(0)) if number in missing else row(signal) for number, signal in enumerate(wanted)]
    return Answer({"statistics": [{key: finite(value) for key, value in vars(row).items()} for row in rows]})


def cursor(session: Session, given: Given) -> Answer:
    """Return the sample of a `dataset` nearest to `position`, moved on by `step` samples, and `signals` at it."""
    view, recording = _dataset(session, given)
    at = nearest(recording, float(given["position"])) + int(given.get("step", 0))
    at = max(0, min(at, recording.count - 1))
    wanted = _signals(given)
    missing = _missing(view, recording, wanted)
    values = [
        None if number in missing else finite(view.signals.values(recording, signal)[at])
        for number, signal in enumerate(wanted)
    ]
    return Answer({"sample": at, "position": float(recording.position[at]), "values": values})


def scatter(session: Session, given: Given) -> Answer:
    """Return calculated over measured values of a `criterion` on a `dataset`, and histograms of its errors.

    `only` limits the samples, `brush` lights some of them.
    """
    view, recording = _dataset(session, given)
    number = int(given.get("criterion", 0))
    shown, lit = (_mask(view, recording, given, key) for key in ("only", "brush"))
    errors, before = (each.errors[recording.number][number] for each in (view.now, view.start))
    measured = view.signals.values(recording, SignalName("target", str(number)))
    chosen = drawn_samples(errors, shown, lit)
    edges = common_bins([_of(errors, shown), _of(before, shown)] if given.get("both") else [_of(errors, shown)])
    return Answer(
        {},
        {
            "sample": chosen,
            "position": recording.position[chosen] - _begin(recording),
            "measured": measured[chosen],
            "now": measured[chosen] + errors[chosen],
            "start": measured[chosen] + before[chosen],
            "lit": np.zeros(chosen.size) if lit is None else lit[chosen],
            "edges": edges,
            "after": histogram(_of(errors, shown), edges),
            "before": histogram(_of(before, shown), edges),
            "brushed": np.zeros(0) if lit is None else histogram(_of(errors, lit), edges),
        },
    )


def points(session: Session, given: Given) -> Answer:
    """Return `signals` of a `dataset` at samples to draw over each other, as arrays `0`, `1`, ...

    `only` limits the samples; those that `brush` selects are 1 in `lit`. `position` is their place on the time axis,
    counted from `begin`. Signals that the dataset lacks have no array.
    """
    view, recording = _dataset(session, given)
    shown, lit = (_mask(view, recording, given, key) for key in ("only", "brush"))
    errors = view.now.errors[recording.number][int(given.get("criterion", 0))]
    most = min(int(given.get("most", MAX_MATRIX_POINTS)), MAX_MATRIX_POINTS * 4)
    chosen = drawn_samples(errors, shown, lit, most)
    begin = _begin(recording)
    wanted = _signals(given)
    missing = _missing(view, recording, wanted)
    lines = {
        str(number): view.signals.values(recording, signal)[chosen]
        for number, signal in enumerate(wanted)
        if number not in missing
    }
    flags = np.zeros(chosen.size) if lit is None else lit[chosen]
    return Answer({"begin": begin}, {"lit": flags, "position": recording.position[chosen] - begin, **lines})


def _dataset(session: Session, given: Given) -> tuple[View, LiveDataset]:
    view = session.require_view()
    return view, view.model.recordings[int(given["dataset"])]


def _begin(recording: LiveDataset) -> float:
    return float(recording.position[0]) if recording.count else 0.0


def _mask(view: View, recording: LiveDataset, given: Given, key: str) -> Bool | None:
    """Return the samples that a selection of the question selects; None if it has none."""
    selection = read_selection(given.get(key))
    return None if selection is None else view.signals.selected(recording, selection)


def _missing(view: View, recording: LiveDataset, wanted: Sequence[SignalName]) -> dict[int, str]:
    """Return why a dataset lacks some of the signals, by their number."""
    missing = {}
    with suppress(KennfeldError):  # the reason is found again below
        view.signals.prepare(recording, wanted)
    for number, signal in enumerate(wanted):
        try:
            view.signals.envelope(recording, signal)
        except (KeyError, IndexError, ValueError):
            missing[number] = f"{recording.name} has no {signal.kind} {signal.name}"
        except KennfeldError as error:
            missing[number] = str(error)
    return missing


def _of(values: Float, chosen: Bool | None) -> Float:
    return values if chosen is None else values[chosen]


def _signals(given: Given) -> list[SignalName]:
    return [read_signal(each) for each in given["signals"]]
