"""Sources: clocks, waves, and signals whose values are in the model."""

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import alone, imported, run, slopes

COUNT, T = 60, 0.1
TIME = T * np.arange(COUNT)


def source(kind, folder, layout="slx parts", **parameters):
    special = parameters.pop("special", None)
    drawn = alone(kind, 0, special=special, **parameters)
    return run(imported(drawn, folder, layout), samples=COUNT)["y1"]


def test_a_digital_clock_runs_at_its_sample_time(tmp_path):
    np.testing.assert_allclose(source("DigitalClock", tmp_path, SampleTime="0.3"), np.repeat(TIME[::3], 3))
    np.testing.assert_allclose(source("DigitalClock", tmp_path), np.repeat(TIME[::10], 10))


def test_a_sine_wave_may_count_samples(tmp_path):
    output = source("Sin", tmp_path, SineType="Sample based", Samples="8", Offset="2", Amplitude="3", Bias="1",
                   SampleTime="0.2")  # fmt: skip
    hits = np.arange(COUNT) // 2
    np.testing.assert_allclose(output, 3 * np.sin(2 * np.pi * (hits + 2) / 8) + 1, atol=1e-12)
    with pytest.raises(InputError, match="it counts samples, but its sample time is inherited"):
        source("Sin", tmp_path, SineType="Sample based")


def test_a_chirp_is_that_of_scipy(tmp_path):
    output = source("Reference", tmp_path, special="chirp", f1="0.5", f2="3", T="4")
    np.testing.assert_allclose(output, scipy.signal.chirp(TIME, 0.5, 4, 3, phi=-90), atol=1e-11)


@pytest.mark.parametrize(("units", "factor"), [("Hertz", 2 * np.pi), ("rad/sec", 1.0)])
def test_a_generator_makes_sine_waves(units, factor, tmp_path):
    output = source("SignalGenerator", tmp_path, Amplitude="2", Frequency="0.7", Units=units)
    np.testing.assert_allclose(output, 2 * np.sin(0.7 * factor * TIME), atol=1e-12)
    with pytest.raises(
        InputError, match=r"its wave form 'random' is not supported, only sine, square and sawtooth\. Bind it to"
    ):
        source("SignalGenerator", tmp_path, WaveForm="random")


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx parts"]))
def test_a_sequence_repeats_its_lines(layout, tmp_path):
    output = source(
        "Reference", tmp_path, layout, special="Repeating table", rep_seq_t="[0 0.5 2]", rep_seq_y="[1 3 0]"
    )
    expected = np.interp(np.mod(TIME + 1e-10, 2), [0, 0.5, 2], [1, 3, 0])
    np.testing.assert_allclose(output, expected, atol=1e-8)


def test_a_sequence_may_jump(tmp_path):
    output = source("Reference", tmp_path, special="Repeating table", rep_seq_t="[0 1 1 2]", rep_seq_y="[0 0 5 5]")
    np.testing.assert_array_equal(output, np.where(np.mod(np.arange(COUNT), 20) < 10, 0, 5))


SEQUENCE = {"special": "Repeating Sequence Interpolated", "OutValues": "[1 3 0 2]", "TimeValues": "[0 0.4 1 1.2]"}


def sequence_times(sample):
    """Simulink's generated code counts from 0 to the last time over the sample time, and then from 0 again."""
    hits = np.floor(TIME / sample + 1e-6) % (round(1.2 / sample) + 1)
    return hits * sample


@pytest.mark.parametrize("sample", [0.1, 0.2, 0.3])
def test_an_interpolated_sequence_ends_with_its_last_value(sample, tmp_path):
    output = source("Reference", tmp_path, **SEQUENCE, tsamp=str(sample))
    np.testing.assert_allclose(output, np.interp(sequence_times(sample), [0, 0.4, 1, 1.2], [1, 3, 0, 2]), atol=1e-12)


@pytest.mark.parametrize(
    ("method", "choose"),
    [
        ("Use Input Below", lambda t: np.searchsorted([0.4, 1, 1.2], t, "right")),
        ("Use Input Above", lambda t: np.searchsorted([0, 0.4, 1], t, "left")),
        ("Use Input Nearest", lambda t: np.searchsorted([0.2, 0.7, 1.1], t, "right")),
    ],
)
def test_an_interpolated_sequence_may_keep_its_values(method, choose, tmp_path):
    fine = Model(step="0.05", solver="FixedStepDiscrete")
    drawn = alone("Reference", 0, **SEQUENCE, tsamp="0.15", LookUpMeth=method, model=fine)
    output = run(imported(drawn, tmp_path), samples=COUNT)["y1"]
    times = np.floor(0.05 * np.arange(COUNT) / 0.15 + 1e-6) % 9 * 0.15
    np.testing.assert_array_equal(output, np.array([1, 3, 0, 2])[np.clip(choose(times), 0, 3)])


def test_an_interpolated_sequence_of_a_variable_is_calibrated(tmp_path):
    drawn = alone("Reference", 0, **SEQUENCE | {"OutValues": "Wave"}, tsamp="0.1")
    model = imported(drawn, tmp_path, parameters=[{"Wave": [1.0, 3.0, 0.0, 2.0]}])
    assert model.values["Wave"].axes[0].breakpoints.tolist() == [0, 0.4, 1, 1.2]
    exact, differences = slopes(model, {"unused": TIME[:6]}, "Wave", "y1")
    assert exact[-1].tolist() == pytest.approx([0, 5 / 6, 1 / 6, 0])
    np.testing.assert_allclose(exact, differences, atol=1e-6)


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"tsamp": "0.5"}, r"its last time, 1\.2 s, must be a multiple of its sample time, 0\.5 s\. Change tsamp"),
        ({"TimeValues": "[0 1 1 1.2]"}, "its TimeValues: .* increas"),
        ({"TimeValues": "[0 1]"}, "OutValues"),
        ({"tsamp": "[0.1 0.05]"}, "its tsamp must be scalar"),
        ({"tsamp": "-1", "TimeValues": "[0 1 1.1 1.25]"}, "must be a multiple of its sample time, 0.1 s"),
    ],
)
def test_an_interpolated_sequence_that_cannot_be_run_is_refused(fields, message, tmp_path):
    with pytest.raises(InputError, match=message):
        source("Reference", tmp_path, **SEQUENCE | {"tsamp": "0.1"} | fields)


POINTS = "[0 1; 1 3; 1 -2; 3 4]"


@pytest.mark.parametrize("last", ["Extrapolation", "Setting to zero", "Holding final value"])
def test_a_matrix_in_the_model_is_a_signal_over_time(last, tmp_path):
    output = source("FromWorkspace", tmp_path, VariableName=POINTS, OutputAfterFinalValue=last)
    t = TIME
    after = t > 1 - 1e-9
    expected = np.where(after, -2 + 3 * (t - 1), 1 + 2 * t)
    beyond = {"Extrapolation": -2 + 3 * (t - 1), "Setting to zero": 0 * t, "Holding final value": 0 * t + 4}[last]
    np.testing.assert_allclose(output, np.where(t > 3 + 1e-6, beyond, expected), atol=1e-12)


def test_values_are_held_where_they_are_not_interpolated(tmp_path):
    output = source("FromWorkspace", tmp_path, VariableName="[0 1; 1 3; 2 -2]", Interpolate="off")
    np.testing.assert_array_equal(output, np.select([TIME + 1e-9 < 1, TIME + 1e-9 < 2], [1, 3], -2))


def test_a_matrix_may_have_several_signals_and_come_from_a_variable(tmp_path):
    drawn = alone("FromWorkspace", 0, VariableName="recorded")
    model = imported(drawn, tmp_path, parameters=[{"recorded": np.array([[0, 1, 5], [6, 7, -1.0]])}])
    outputs = run(model, samples=COUNT)
    np.testing.assert_allclose(outputs["y1[1]"], 1 + TIME, atol=1e-12)
    np.testing.assert_allclose(outputs["y1[2]"], 5 - TIME, atol=1e-12)


@pytest.mark.parametrize(
    ("parameters", "reason"),
    [
        ({"VariableName": "[1 2; 3 4]"}, "its points must begin at 0 s, got 1 s"),
        ({"VariableName": "[0 2; 3 4; 2 1]"}, "its times must increase"),
        ({"VariableName": "[0 2; 3 4]", "OutputAfterFinalValue": "Cyclic repetition"}, "'Cyclic repetition'"),
        ({"VariableName": "[1 2 3]"}, "its signal is not a matrix"),
    ],
)
def test_signals_without_a_meaning_are_refused(parameters, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        source("FromWorkspace", tmp_path, **parameters)


@pytest.mark.parametrize("kind", ["RandomNumber", "UniformRandomNumber"])
def test_random_signals_are_refused_and_can_be_bound(kind, tmp_path):
    drawn = alone(kind, 0)
    with pytest.raises(InputError, match=r"random and not part of the model\. Bind it to a measured channel"):
        imported(drawn, tmp_path)
    model = imported(drawn, tmp_path, bind={"B": "2 * noise"})
    assert run(model, {"noise": [1.0, 2.0]})["y1"].tolist() == [2.0, 4.0]


def test_a_signal_of_the_model_may_drive_continuous_states(tmp_path):
    drawn = Model(solver="ode4", step="0.1")
    drawn.block("FromWorkspace", "F", ports=(0, 1), VariableName="[0 0; 10 20]")
    drawn.block("Integrator", "I", ports=(1, 1))
    drawn.outport("y")
    drawn.chain("F", "I", "y")
    np.testing.assert_allclose(run(imported(drawn, tmp_path), samples=COUNT)["y"], TIME**2, atol=1e-7)


def test_sources(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    blocks = [
        ("Clock", {}),
        ("Step", {"Time": "0.5", "Before": "1", "After": "4"}),
        ("Sin", {"Amplitude": "2", "Frequency": "3", "Phase": "0.5", "Bias": "1"}),
        ("DiscretePulseGenerator", {"PulseType": "Time based", "Period": "0.6", "PulseWidth": "50", "PhaseDelay": "0.2",
                                    "Amplitude": "5"}),
        ("DiscretePulseGenerator", {"Period": "4", "PulseWidth": "1", "SampleTime": "0.1"}),
    ]  # fmt: skip
    for number, (kind, parameters) in enumerate(blocks):
        drawn.block(kind, f"B{number}", ports=(0, 1), **parameters)
        drawn.outport(f"y{number}")
        drawn.line(f"B{number}", f"y{number}")
    drawn.link("R", "simulink/Sources/Ramp", "Ramp", ports=(0, 1), slope="2", start="0.5", InitialOutput="1")
    drawn.outport("r")
    drawn.line("R", "r")
    outputs = run(imported(drawn, tmp_path), samples=14)
    k = np.arange(14)
    np.testing.assert_allclose(outputs["y0"], 0.1 * k)
    np.testing.assert_array_equal(outputs["y1"], np.where(k >= 5, 4, 1))
    np.testing.assert_allclose(outputs["y2"], 2 * np.sin(0.3 * k + 0.5) + 1)
    np.testing.assert_array_equal(outputs["y3"], np.where((k >= 2) & ((k - 2) % 6 < 3), 5, 0))
    np.testing.assert_array_equal(outputs["y4"], k % 4 < 1)
    np.testing.assert_allclose(outputs["r"], 1 + 2 * np.maximum(0.1 * k - 0.5, 0), atol=1e-12)


@pytest.mark.parametrize(("width", "step"), [("35", 0.05), ("50", 0.5)])
def test_a_variable_step_hits_the_edges_of_pulses(width, step, tmp_path):
    drawn = Model(solver="VariableStepDiscrete")
    drawn.block("DiscretePulseGenerator", "P", ports=(0, 1), PulseType="Time based", Period="1", PulseWidth=width)
    drawn.outport("y")
    drawn.chain("P", "y")
    model = imported(drawn, tmp_path)
    assert model.step == pytest.approx(step)
    high = int(width) / 100
    np.testing.assert_array_equal(run(model, samples=40)["y"], (np.arange(40) * step + 1e-9) % 1 < high)


@pytest.mark.parametrize("units", ["Hertz", "rad/sec"])
def test_a_signal_generator_makes_sines_squares_and_sawteeth(units, tmp_path):
    drawn = Model(step="0.01", solver="FixedStepDiscrete")
    scale = 1.0 if units == "Hertz" else 2 * np.pi
    for form in ("sine", "square", "sawtooth"):
        drawn.block("SignalGenerator", form, ports=(0, 1), WaveForm=form, Amplitude="A", Frequency=str(3.1 * scale),
                    Units=units)  # fmt: skip
        drawn.outport(f"y {form}")
        drawn.line(form, f"y {form}")
    model = imported(drawn, tmp_path, parameters=[{"A": 2.5}])
    outputs, turns = run(model, samples=200), 3.1 * 0.01 * np.arange(200)
    np.testing.assert_allclose(outputs["y sine"], 2.5 * np.sin(2 * np.pi * turns), atol=1e-12)
    np.testing.assert_array_equal(outputs["y square"], np.where(turns % 1 >= 0.5, 2.5, -2.5))
    np.testing.assert_allclose(outputs["y sawtooth"], 2.5 * (1 - 2 * (turns % 1)), atol=1e-12)
    exact, differences = slopes(model, {"t": 0.01 * np.arange(200)}, "A", "y square")
    np.testing.assert_allclose(exact, differences, atol=1e-8)
