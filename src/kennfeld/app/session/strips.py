"""Data of a strip chart: samples where they fit, else the extremes of each pixel."""

from collections.abc import Sequence

import numpy as np

from kennfeld.app.session.live_model import LiveDataset
from kennfeld.app.session.signals import SampleSelection, SignalName, Signals
from kennfeld.base.arrays import Float
from kennfeld.base.lazy_dataclass import dataclass


@dataclass(frozen=True, eq=False)
class Strip:
    """Signals over one stretch of a dataset.

    Attributes:
        begin: position of the left edge; positions are relative to it, so that 32 bits hold them.
        raw: True if each point is a sample; otherwise points come in pairs, minimum and maximum of a pixel.
        positions: Float[points].
        lines: Float[points] for each signal.
        lit: Float[points], above 0 where a sample is selected; empty without a selection.
    """

    begin: float
    raw: bool
    positions: Float
    lines: tuple[Float, ...]
    lit: Float


def strip(
    signals: Signals,
    recording: LiveDataset,
    chosen: Sequence[SignalName],
    begin: float,
    end: float,
    pixels: int,
    only: SampleSelection | None = None,
    lit: SampleSelection | None = None,
) -> Strip:
    """Return signals between two positions.

    Args:
        signals: where the values come from.
        recording: the dataset.
        chosen: what to draw.
        begin: position at the left edge.
        end: position at the right edge.
        pixels: width of the plot.
        only: the samples to draw; None for all.
        lit: the samples to light up.
    """
    position = recording.position
    first = max(int(np.searchsorted(position, begin)) - 1, 0)  # the line begins outside
    last = min(int(np.searchsorted(position, end, side="right")) + 1, position.size)
    envelopes = [signals.envelope(recording, signal, only) for signal in chosen]
    lights = [] if lit is None else [signals.lit(recording, lit)]
    # extremes would be as many points as the samples themselves
    if last - first <= 2 * pixels:
        here = slice(first, last)
        lines = [envelope.values[here] for envelope in (*envelopes, *lights)]
        drawn = position[here] - begin
    else:
        edges = np.searchsorted(position, np.linspace(begin, end, pixels + 1))
        # one sample beyond the right edge, so that the line does not end before it
        edges[-1] = last
        middle = (np.arange(pixels) + 0.5) * (end - begin) / pixels
        pairs = [envelope.extremes(edges) for envelope in (*envelopes, *lights)]
        # minimum and maximum of each pixel in turn
        drawn, lines = np.repeat(middle, 2), [np.ravel(pair, order="F") for pair in pairs]
    own = lines[: len(envelopes)]
    return Strip(begin, last - first <= 2 * pixels, drawn, tuple(own), lines[-1] if lights else np.zeros(0))


@dataclass(frozen=True)
class Statistics:
    """Numbers on a signal over a stretch."""

    samples: int
    least: float
    mean: float
    greatest: float
    rms: float


def statistics(signals: Signals, recording: LiveDataset, signal: SignalName, begin: float, end: float) -> Statistics:
    """Compute statistics of a signal from one position up to another, in the unit of the signal."""
    here = slice(*np.searchsorted(recording.position, [begin, end], side="left"))
    return describe(signals.values(recording, signal)[here])


def describe(values: Float) -> Statistics:
    """Compute least, mean, greatest and root mean square of the values, Float[samples], that are numbers."""
    values = values[np.isfinite(values)]
    if not values.size:
        return Statistics(0, *[float("nan")] * 4)
    rms = float(np.sqrt(np.mean(values**2)))
    return Statistics(values.size, float(values.min()), float(values.mean()), float(values.max()), rms)
