"""Strip charts, scatter plots and histograms."""

from kennfeld.app.answer import Answer, Given, finite
from kennfeld.app.session.distributions import common_bins, histogram, thin
from kennfeld.app.session.session import Session
from kennfeld.app.session.signals import SignalName
from kennfeld.app.session.strips import statistics, strip

MAX_PIXELS = 8192  # of a screen


def strip_chart(session: Session, given: Given) -> Answer:
    """Return `signals` over a stretch of a `dataset`, from `begin` to `end`, as arrays `x`, `0`, `1`, ..."""
    view = session.require_view()
    recording = view.model.recordings[int(given["dataset"])]
    pixels = max(1, min(int(given["pixels"]), MAX_PIXELS))
    drawn = strip(view.signals, recording, _signals(given), float(given["begin"]), float(given["end"]), pixels)
    lines = {str(number): values for number, values in enumerate(drawn.lines)}
    return Answer({"begin": drawn.begin, "raw": drawn.raw}, {"x": drawn.positions, **lines})


def stretch_statistics(session: Session, given: Given) -> Answer:
    """Return statistics of `signals` over a stretch of a `dataset`."""
    view = session.require_view()
    recording = view.model.recordings[int(given["dataset"])]
    stretch = float(given["begin"]), float(given["end"])
    rows = [statistics(view.signals, recording, signal, *stretch) for signal in _signals(given)]
    return Answer({"statistics": [{key: finite(value) for key, value in vars(row).items()} for row in rows]})


def scatter(session: Session, given: Given) -> Answer:
    """Return calculated over measured values of a `criterion` on a `dataset`, and histograms of its errors."""
    view, number = session.require_view(), int(given.get("criterion", 0))
    recording = view.model.recordings[int(given["dataset"])]
    errors, before = (each.errors[recording.number][number] for each in (view.now, view.start))
    measured = view.signals.envelope(recording, SignalName("target", str(number))).values
    chosen = thin(recording.count, errors)
    edges = common_bins([errors, before] if given.get("both") else [errors])
    return Answer(
        {},
        {
            "sample": chosen,
            "measured": measured[chosen],
            "now": measured[chosen] + errors[chosen],
            "start": measured[chosen] + before[chosen],
            "edges": edges,
            "after": histogram(errors, edges),
            "before": histogram(before, edges),
        },
    )


def _signals(given: Given) -> list[SignalName]:
    return [SignalName(each["kind"], str(each["name"])) for each in given["signals"]]
