"""Datasets and channels as HTML, each channel with a strip."""

from collections.abc import Mapping

import numpy as np

from kennfeld.base.arrays import Float
from kennfeld.base.formatting import count_noun
from kennfeld.base.markup import Html, decimal, element
from kennfeld.base.trace_envelope import Trace, TraceEnvelope
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.notebook.parameter_display import with_unit
from kennfeld.notebook.pictures import line_chart, strip
from kennfeld.notebook.result_display import findings_parts
from kennfeld.notebook.tables import MAX_ROWS, block, caption, text_table

STRIP_POINTS, CHART_POINTS = 300, 1000
_HEADING = ("channel", "unit", "values", "minimum", "mean", "maximum", "missing")


def channel_html(channel: Channel) -> Html:
    """Return the numbers of a channel and a line over its samples."""
    title = [element("b", channel.name), f" ({count_noun(len(channel), 'sample')})"]
    notes = [caption(channel.description)] if channel.description else []
    x, y = reduced(channel.values, CHART_POINTS)
    picture = [line_chart(x, y, "sample", with_unit(channel.name, channel.unit))] if np.isfinite(y).any() else []
    statistics = _statistics(channel)
    numbers = ", ".join(f"{name} {statistics[name]}" for name in _HEADING[3:])
    return block(title, *notes, *picture, caption(numbers))


def dataset_html(data: Dataset) -> Html:
    """Return a row for each channel, with a strip of its values."""
    size = [count_noun(data.samples, "sample"), count_noun(len(data), "channel")]
    if data.piece_starts.size > 1:
        size.append(count_noun(data.piece_starts.size, "piece"))
    if data.time is None:
        size.append("steady-state")
    elif data.samples and data.piece_starts.size == 1:
        size.append(f"{decimal(float(data.time[0]))} to {decimal(float(data.time[-1]))} s")
    title = [element("b", data.name), f" ({', '.join([*size, data.use])})"]
    rows = []
    for number, channel in enumerate(data.channels):
        # an empty row in place of channels that the table leaves out: pictures are expensive
        if MAX_ROWS // 2 <= number < len(data) - MAX_ROWS // 2:
            rows.append(("",) * len(_HEADING))  # not shown
            continue
        picture = element("div", strip(*reduced(channel.values, STRIP_POINTS), channel.name), style="width:220px")
        statistics = _statistics(channel)
        rows.append((channel.name, channel.unit, picture, *(statistics[name] for name in _HEADING[3:])))
    return block(title, text_table(_HEADING, rows, words=3), *findings_parts(data.findings))


def reduced(values: Float, most: int) -> tuple[Float, Float]:
    """Reduce Float[samples] to sample numbers and values of at most `most` points: minima and maxima of neighbours.

    >>> reduced(np.array([0.0, 5, 1, 2]), most=2)
    (array([0., 0.]), array([0., 5.]))
    """
    groups, trace = TraceEnvelope(values.size, most), Trace()
    trace.add(groups, 0, values)
    numbers = groups.firsts(0, values.size).astype(np.float64)
    return numbers if groups.whole else np.repeat(numbers, 2), trace.points(groups)


def _statistics(channel: Channel) -> Mapping[str, str]:
    known = channel.values[np.isfinite(channel.values)]
    empty = np.full(1, np.nan)
    numbers = known if known.size else empty
    with np.errstate(over="ignore"):
        mean = float(numbers.mean())
    return {
        "minimum": decimal(float(numbers.min())),
        "mean": decimal(mean),
        "maximum": decimal(float(numbers.max())),
        "missing": str(len(channel) - known.size),
    }
