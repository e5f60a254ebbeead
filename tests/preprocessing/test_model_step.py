"""Data on a model's own step, in Python as in projects."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError, Location
from kennfeld.domain.dataset import Dataset
from kennfeld.preprocessing.model_step import refine_step
from tests.importers.simulink.simulink_files import Model


def recording(time, starts=(0,), **columns):
    return Dataset.of("d", columns, time=np.asarray(time, dtype=float), piece_starts=np.asarray(starts))


def test_a_finer_step_interpolates_inputs_and_scores_the_data_alone():
    data = refine_step(recording([0, 0.2, 0.4], u=[0.5, 1.5, 2.5], y=[1.5, 2.5, 3.5]), 0.1, {"u"}, Location("here"))
    np.testing.assert_allclose(data.time, [0, 0.1, 0.2, 0.3, 0.4])
    np.testing.assert_allclose(data["u"].values, [0.5, 1.0, 1.5, 2.0, 2.5])
    np.testing.assert_allclose(data["y"].values, [1.5, np.nan, 2.5, np.nan, 3.5])
    assert data.scored.tolist() == [True, False, True, False, True]


def test_a_finer_step_keeps_pieces_apart():
    data = refine_step(
        recording([0, 1, 0, 1, 2], starts=[0, 2], u=[0.5, 1.5, 9.5, 8.5, 7.5]), 0.5, {"u"}, Location("here")
    )
    assert data.piece_starts.tolist() == [0, 3]
    np.testing.assert_allclose(data["u"].values, [0.5, 1.0, 1.5, 9.5, 9.0, 8.5, 8.0, 7.5])
    np.testing.assert_allclose(data.time, [0, 0.5, 1, 0, 0.5, 1, 1.5, 2])


def test_the_same_step_changes_nothing():
    data = recording([0, 0.1, 0.2], u=[1.0, 2.0, 3.0])
    assert refine_step(data, 0.1, {"u"}, Location("here")) is data


@pytest.mark.parametrize(
    ("time", "expected"),
    [
        (
            [0, 0.25, 0.5],
            "the data's step of 0.25 s is not a whole multiple of the model's step, 0.1 s. "
            "Resample the data to an even step of 0.2 s",
        ),
        (
            [0, 0.01, 0.02],
            "the data's step of 0.01 s is not a whole multiple of the model's step, 0.1 s. "
            "Resample the data to an even step of 0.1 s",
        ),
        ([0, 0.1, 0.3], "the samples are 0.1 to 0.2 s apart. Resample the data to an even step of "),
    ],
)
def test_a_step_that_does_not_fit_is_a_finding(time, expected):
    with pytest.raises(InputError, match=expected):
        refine_step(recording(time, u=[1.0, 2.0, 3.0]), 0.1, {"u"}, Location("here"))


@pytest.fixture
def counter(tmp_path):
    """Y counts Gain * u, a step of 1 s each."""
    drawn = Model("counter", step="1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "Times", Gain="Slope")
    drawn.block("DiscreteIntegrator", "Sum", SampleTime="1", InitialCondition="0")
    drawn.outport("y")
    drawn.chain("u", "Times", "Sum", "y")
    return kf.simulink(drawn.write(tmp_path, "slx parts"), parameters=[{"Slope": 1.0}])


def ramp(step, count=13, **further):
    time = step * np.arange(count)
    return {"time": time, "u": np.ones(count), "z": 3 * time} | further


@pytest.mark.guests
def test_data_at_the_step_of_the_model_are_simulated(counter):
    simulation = kf.simulate(counter, ramp(1.0), {})
    np.testing.assert_allclose(simulation["y"].values, simulation.time)


@pytest.mark.guests
def test_a_finer_step_of_the_model_gives_values_at_the_samples_of_the_data(counter):
    simulation = kf.simulate(counter, ramp(3.0), {})
    assert simulation.time.tolist() == ramp(3.0)["time"].tolist()
    np.testing.assert_allclose(simulation["y"].values, simulation.time)


@pytest.mark.guests
def test_a_finer_step_of_the_model_gives_the_right_gain(counter):
    with pytest.warns(kf.InputWarning, match="13 of 20 test samples"):
        result = kf.calibrate(counter, ramp(3.0), {"Slope": 1.0}, "z", test=ramp(3.0, 20))
    assert result.parameters["Slope"].value == pytest.approx(3)
    assert [row.samples for row in result.quality] == [13, 20]


@pytest.mark.guests
@pytest.mark.parametrize("step", [0.01, 0.3])
def test_data_that_the_step_of_the_model_does_not_meet_are_refused(counter, step):
    expected = (
        f"the data's step of {step:g} s is not a whole multiple of the model's step, 1 s. "
        "Resample the data to an even step of 1 s; kennfeld.read does so with raster=1."
    )
    with pytest.raises(InputError) as error:
        kf.simulate(counter, ramp(step), {})
    assert str(error.value) == f"dataset data: {expected}"
    with pytest.raises(InputError) as error:
        kf.calibrate(counter, ramp(1.0), {"Slope": 1.0}, "z", test=[ramp(step), ramp(step)])
    assert str(error.value).splitlines() == [f"dataset test: {expected}", f"dataset test1: {expected}"]


def test_the_step_that_a_formula_declares_counts_too():
    formula = "step 0.5\ny = prev(y, 0) + u"
    assert kf.simulate(formula, ramp(1.0, 3), {})["y"].values.tolist() == [1, 3, 5]
    with pytest.raises(InputError, match=r"the data's step of 0\.2 s is not a whole multiple"):
        kf.simulate(formula, ramp(0.2), {})


def test_a_step_means_nothing_to_a_function_without_memory():
    assert kf.simulate("step 0.5\ny = 2 * u", ramp(0.2, 3), {})["y"].values.tolist() == [2, 2, 2]


@pytest.mark.guests
def test_a_shift_is_not_sought_between_samples_of_the_data(counter):
    with pytest.raises(InputError, match="cannot estimate a shift: the model's step of 1 s is finer"):
        kf.calibrate(counter, ramp(3.0), {"Slope": 1.0}, "z", shift={"u": "auto"})


def test_simulated_pieces_stay_apart_on_a_finer_step():
    data = recording([0, 1, 0, 1, 2], starts=[0, 2], u=[1.0, 1, 1, np.nan, 1])
    with pytest.warns(kf.InputWarning, match=r"1 of 5 samples is not simulated: u has no value at sample 4 \(1 s\)"):
        simulation = kf.simulate("step 0.5\ny = prev(y, 0) + u", data, {})
    assert simulation.time.tolist() == [0, 1, 0, 2]
    assert simulation.piece_starts.tolist() == [0, 2, 3]
    assert simulation["y"].values.tolist() == [1, 3, 1, 1]
