"""Blocks of toolboxes known by their place in a library, against NumPy."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import crossings, imported, run

U = np.random.default_rng(8).normal(size=30)
V = np.sin(np.arange(30))


def linked(source, inputs=1, width=1, **fields):
    """A block of a library that is not at hand, between inports u1, u2, ... of a width and the outport y."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("B", source, source.rpartition("/")[2], ports=(inputs, 1), **fields)
    for at in range(1, inputs + 1):
        drawn.inport(f"u{at}", PortDimensions=str(width))
        drawn.line(f"u{at}", f"B:{at}")
    drawn.outport("y")
    drawn.line("B", "y")
    return drawn


def elements(columns, width):
    """The inputs u1[1], u1[2], ... of a vector."""
    return {f"{name}[{at + 1}]": column[:, at] for name, column in columns.items() for at in range(width)}


@pytest.mark.parametrize(
    ("source", "fields", "rule"),
    [
        ("dspstat3/Mean", {"directionMode": "Each column"}, np.mean),
        ("dspstat3/Mean", {"directionMode": "Specified dimension", "dimension": "1"}, np.mean),
        ("dspstat3/Minimum", {"operateOver": "Entire input"}, np.min),
        ("dspstat3/Maximum", {"operateOver": "Each column"}, np.max),
    ],
)
def test_a_statistic_of_a_vector_is_that_of_its_elements(source, fields, rule, tmp_path):
    x = np.random.default_rng(1).normal(size=(9, 3))
    drawn = linked(source, width=3, InputProcessing="Columns as channels (frame based)", **fields)
    values = run(imported(drawn, tmp_path), elements({"u1": x}, 3))["y"]
    np.testing.assert_allclose(values, rule(x, axis=1), rtol=1e-14)


def test_rows_of_a_vector_are_its_elements(tmp_path):
    x = np.random.default_rng(1).normal(size=(9, 2))
    values = run(imported(linked("dspstat3/Mean", width=2, directionMode="Each row"), tmp_path), elements({"u1": x}, 2))
    np.testing.assert_array_equal(values["y[2]"], x[:, 1])


COUNT = np.arange(1, 31)
WINDOW = np.convolve(U, np.full(4, 0.25))[:30]
WEIGHTS = np.tril(0.8 ** np.subtract.outer(COUNT, COUNT).clip(0))


@pytest.mark.parametrize(
    ("source", "fields", "expected"),
    [
        ("dspstat3/Mean", {"run": "on"}, np.cumsum(U) / COUNT),
        ("dspstat3/Minimum", {"fcn": "Running"}, np.minimum.accumulate(U)),
        ("dspstat3/Maximum", {"fcn": "Running"}, np.maximum.accumulate(U)),
        ("dspstat3/Moving Average", {"WindowLength": "4"}, WINDOW),
        ("dspstat3/Moving Average", {"SpecifyWindowLength": "off"}, np.cumsum(U) / COUNT),
        (
            "dspstat3/Moving Average",
            {"Method": "Exponential weighting", "ForgettingFactor": "0.8"},
            WEIGHTS @ U / WEIGHTS.sum(axis=1),
        ),
    ],
)  # fmt: skip
def test_a_statistic_over_time_is_that_of_the_samples_so_far(source, fields, expected, tmp_path):
    values = run(imported(linked(source, **fields), tmp_path), {"u1": U})["y"]
    np.testing.assert_allclose(values, expected, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize(("trigger", "rises", "falls"), [("Rising edge", 1, 0), ("Falling edge", 0, 1),
                                                         ("Either edge", 1, 1)])  # fmt: skip
def test_a_sample_is_held_until_the_next_event(trigger, rises, falls, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("B", "dspsigops/Sample\nand Hold", "Sample and Hold", trig=trigger, initCond="4.0", latchinput="off")
    drawn.blocks[-1].ports = {"in": 1, "out": 1, "trigger": 1}
    for name, end in (("u", "B:1"), ("v", "B#trigger")):
        drawn.inport(name)
        drawn.line(name, end)
    drawn.outport("y")
    drawn.line("B", "y")
    values = run(imported(drawn, tmp_path), {"u": U, "v": V})["y"]
    rising, falling = crossings(V)
    sample, expected = 4.0, []
    for k, u in enumerate(U):
        sample = u if (rises and rising[k]) or (falls and falling[k]) else sample
        expected.append(sample)
    np.testing.assert_array_equal(values, expected)


def test_a_product_of_quaternions_multiplies_their_matrices(tmp_path):
    q, r = np.random.default_rng(2).normal(size=(2, 6, 4))
    drawn = linked("aerolibutil/Quaternion\nMultiplication", inputs=2, width=4)
    values = run(imported(drawn, tmp_path), elements({"u1": q, "u2": r}, 4))
    a, b, c, d = q.T
    left = np.array([[a, -b, -c, -d], [b, a, -d, c], [c, d, a, -b], [d, -c, b, a]])
    expected = np.einsum("ijk,kj->ik", left, r)
    np.testing.assert_allclose([values[f"y[{at}]"] for at in range(1, 5)], expected, rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize(
    ("drawn", "message"),
    [
        (linked("dspstat3/Mean", width=3, run="on"), "its input is a frame of 3 samples"),
        (linked("dspstat3/Mean", roiEnable="on"), "regions of interest"),
        (linked("dspstat3/Mean", run="on", reset_popup="Rising edge"), "it is reset by an input"),
        (linked("own/Mean"), "it links to the library own, which was not found"),
    ],
)
def test_what_is_not_known_is_refused(drawn, message, tmp_path):
    with pytest.raises(InputError, match=message):
        imported(drawn, tmp_path)


@pytest.mark.parametrize("mode", ["Discrete", "Continuous"])
def test_a_sine_wave_of_the_dsp_library_is_sampled_if_it_is_discrete(mode, tmp_path):
    fields = {"Amplitude": "2", "Frequency": "0.7", "Phase": "0.3", "SampleTime": "0.2", "SampleMode": mode}
    values = run(imported(linked("dspsrcs4/Sine Wave", 0, **fields), tmp_path), samples=20)["y"]
    time = 0.1 * np.arange(20) if mode == "Continuous" else 0.2 * (np.arange(20) // 2)
    np.testing.assert_allclose(values, 2 * np.sin(2 * np.pi * 0.7 * time + 0.3), atol=1e-12)


@pytest.mark.parametrize(
    ("fields", "why"), [({"SamplesPerFrame": "12"}, "a frame of 12"), ({"OutComplex": "Complex"}, "'Complex'")]
)
def test_frames_and_complex_sines_are_refused(fields, why, tmp_path):
    with pytest.raises(InputError, match=why):
        imported(linked("dspsrcs4/Sine Wave", 0, **fields), tmp_path)
