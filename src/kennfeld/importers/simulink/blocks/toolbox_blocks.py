"""Blocks of toolboxes that are plain arithmetic, known by their place in a library whose file need not be at hand."""

from collections.abc import Callable, Sequence

import numpy as np

from kennfeld.importers.simulink.lowering import BlockContext, UnsupportedError, block
from kennfeld.importers.simulink.reader.model_tree import ModelBlock
from kennfeld.importers.simulink.signals import Signal, SignalOrBus, apply, select
from kennfeld.models.imperative.node_arrays import Nodes

_DIRECTIONS = ("Each column", "Each row", "Entire input", "Specified dimension")
_FRAMES = "Columns as channels (frame based)"


@block("dspstat3/Mean", linked=True, run="off", directionMode="Each column", dimension="1", roiEnable="off",
       reset_popup="None", InputProcessing=_FRAMES)  # fmt: skip
def mean(block: BlockContext) -> SignalOrBus:
    """Compute the mean of the elements of an array, or of all samples so far."""
    if not block.is_on("run"):
        return _over_lines(block, "directionMode", "dimension", lambda u: block.reduce("add", u) / float(len(u)))
    u = _sample(block, "reset_popup")
    return _running_mean(block, u)


@block("dspstat3/Minimum", "dspstat3/Maximum", linked=True, fcn="Value", operateOver="Each column", Dimension="1",
       roiEnable="off", reset="None", InputProcessing=_FRAMES)  # fmt: skip
def extreme(block: BlockContext) -> SignalOrBus:
    """Compute the least or greatest element of an array, or the least or greatest sample so far."""
    op = "min" if block.flat.type == "dspstat3/Minimum" else "max"
    if block.option("fcn", "Value", "Running") == "Value":
        return _over_lines(block, "operateOver", "Dimension", lambda u: block.reduce(op, u))
    u = _sample(block, "reset")
    nothing = block.constant(np.inf if op == "min" else -np.inf)
    return block.feedback(nothing, lambda before: apply(op, before, u))


@block("dspstat3/Moving Average", linked=True, Method="Sliding window", SpecifyWindowLength="on", WindowLength="4",
       ForgettingFactorPort="off", ForgettingFactor="0.9")  # fmt: skip
def moving_average(block: BlockContext) -> SignalOrBus:
    """Compute the mean of the last samples, those before the first being 0, or of all with weights that decay."""
    u = _sample(block)
    if block.option("Method", "Sliding window", "Exponential weighting") == "Sliding window":
        if not block.is_on("SpecifyWindowLength"):
            return _running_mean(block, u)
        length = block.integer_field("WindowLength", 1)
        oldest = block.discrete_state(block.constant(0.0), lambda _: u, latency=length)
        total = block.feedback(block.constant(0.0), lambda before: before + (u - oldest))
        return total / float(length)
    if block.is_on("ForgettingFactorPort"):
        raise UnsupportedError("its forgetting factor is an input, which is not supported")
    factor = block.parameter("ForgettingFactor")
    # w = lambda w' + 1, y = (1 - 1 / w) y' + u / w
    weight = block.feedback(block.constant(0.0), lambda before: factor * before + 1.0)
    return block.feedback(block.constant(0.0), lambda before: (1.0 - 1.0 / weight) * before + u / weight)


def _sample_of_sine(block: ModelBlock) -> str:
    return "" if block.is_set_to("SampleMode", "Continuous") else "SampleTime"


@block("dspsrcs4/Sine Wave", linked=True, sample=_sample_of_sine, Amplitude="1", Frequency="100", Phase="0",
       SampleMode="Discrete", OutComplex="Real", SampleTime="1/1000", SamplesPerFrame="1")  # fmt: skip
def sine_wave(block: BlockContext) -> SignalOrBus:
    """Compute the sine of a frequency in Hz and a phase in rad, at the sample hits if it is discrete."""
    block.option("OutComplex", "Real")
    frames = block.integer_field("SamplesPerFrame", 1)
    discrete = block.option("SampleMode", "Discrete", "Continuous") == "Discrete"
    if frames != 1 and discrete:
        raise UnsupportedError(f"its output is a frame of {frames} samples, which is not supported")
    angle = 2 * np.pi * (block.parameter("Frequency") * block.time) + block.parameter("Phase")
    return block.parameter("Amplitude") * apply("sin", angle)


@block("dspsigops/Sample and Hold", linked=True, sample="", trig="Rising edge", initCond="0", latchinput="off")
def sample_and_hold(block: BlockContext) -> SignalOrBus:
    """Return the input of the last trigger event, before the first one the initial condition."""
    kinds = {"Rising edge": "rising", "Falling edge": "falling", "Either edge": "either"}
    kind = kinds[block.option("trig", *kinds)]
    u = block.hold_in_minor_steps(block.input())
    if block.is_on("latchinput"):
        raise UnsupportedError("it buffers its input, which is not supported")
    event = block.zero_crossing(block.hold_in_minor_steps(block.input(1)), kind)
    return block.feedback(block.parameter("initCond"), lambda before: select(event, u, before))


def _over_lines(
    block: BlockContext, direction: str, dimension: str, rule: Callable[[Sequence[Signal]], Signal]
) -> Signal:
    """Reduce the columns or rows of the input, or all its elements; a vector is a column."""
    _refuse_regions(block)
    u = block.input(frames=True)
    block.warn_of_unknown_width(u)
    way = block.option(direction, *_DIRECTIONS)
    if way == "Specified dimension":
        way = _DIRECTIONS[block.integer_field(dimension, 1, 2) - 1]
    lines: Nodes = {"Each column": u.matrix.T, "Each row": u.matrix}.get(way, u.matrix.T.reshape(1, -1))
    nodes = [rule([block.signal([node], u.period) for node in line]).flat[0] for line in lines]
    shape = (1, len(nodes)) if way == "Each column" else (len(nodes), 1)
    return block.signal(nodes, u.period, shape if len(nodes) > 1 else None)


def _sample(block: BlockContext, reset: str = "") -> Signal:
    """Return the input of a statistic over time; rows of it would be successive samples."""
    _refuse_regions(block)
    if reset and not block.is_set_to(reset, "None"):
        raise UnsupportedError("it is reset by an input, which is not supported")
    u = block.hold_in_minor_steps(block.input())
    if u.matrix.shape[0] > 1:
        raise UnsupportedError(f"its input is a frame of {u.matrix.shape[0]} samples, which is not supported")
    return u


def _running_mean(block: BlockContext, u: Signal) -> Signal:
    count = block.feedback(block.constant(0.0), lambda before: before + 1.0)
    return block.feedback(block.constant(0.0), lambda before: before + u) / count


def _refuse_regions(block: BlockContext) -> None:
    if block.is_on("roiEnable"):
        raise UnsupportedError("it computes for regions of interest, which is not supported")
