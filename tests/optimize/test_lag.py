"""Lags of recorded channels: whole samples of a bench log, fractions in time, and lags that do not exist."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.optimize.tuning.shift_estimation import WIDEST, Minimum, _find_doubtful
from kennfeld.preprocessing.time_shift import shift_channels
from kennfeld.project.demo import torque
from tests.draws import mostly_slow

TRANSIENT = Path(__file__).resolve().parents[3] / "shared" / "data" / "engine_transient" / "gengine1_m10.csv.gz"


def walk(count, low, high, rng, step=0.06):
    """A random walk between two walls."""
    x = (low + high) / 2 + np.cumsum(rng.normal(0, step * (high - low), count))
    folded = np.mod(x - low, 2 * (high - low))
    return low + np.minimum(folded, 2 * (high - low) - folded)


def bench(late, seed=0, use="training", samples=1200):
    """Operating points in the order of a random walk, the torque recorded some samples late."""
    rng = np.random.default_rng(seed)
    speed, air, spark = (walk(samples, *span, rng) for span in (torque.SPEED, torque.AIR, torque.IGNITION))
    noise = rng.normal(0, torque.NOISE, samples)
    values = np.roll(torque.torque(speed, air, spark) + noise, late)
    values[:late] = np.nan
    columns = {"Speed": speed, "Rel_Airmass": air, "Ignition": spark, "Torque": values}
    return kf.Dataset.of(f"{use} {seed}", columns, use=use)


def calibrated(data, shift, **arguments):
    return kf.calibrate(
        torque.FORMULA,
        data,
        torque.start(),
        target="Torque",
        shift=shift,
        smoothness=torque.SMOOTHNESS,
        bounds=torque.BOUNDS,
        pins=[kf.Pin(*torque.PIN)],
        options=kf.Options(continuation="off"),
        **arguments,
    )


@pytest.mark.slow
def test_a_torque_recorded_one_sample_late_is_moved_back():
    data = bench(1)
    blurred, result = calibrated(data, None), calibrated(data, {"Torque": "auto"})
    assert result.shifts == {"training 0": {"Torque": -1.0}}
    assert result.quality[0].rmse_after < 1.1 * torque.NOISE < 0.4 * blurred.quality[0].rmse_after
    assert result.parameters["MapDragTorque"] == calibrated(data, {"Torque": -1.0}).parameters["MapDragTorque"]
    assert result.as_json()["shifts"] == {"training 0": {"Torque": -1.0}}


@pytest.mark.slow
def test_synchronous_channels_of_a_torque_bench_are_not_moved():
    result = calibrated(bench(0), {"Torque": "auto", "Speed": "auto"})
    assert result.shifts == {"training 0": {"Torque": 0, "Speed": 0}}


@pytest.mark.slow
def test_an_input_of_a_torque_bench_may_be_late():
    data = bench(0)
    late = shift_channels(data, {"Ignition": 2.0})
    assert calibrated(late, {"Ignition": "auto"}).shifts == {"training 0": {"Ignition": -2.0}}


@pytest.fixture
def narrow_window(monkeypatch):
    monkeypatch.setattr("kennfeld.optimize.tuning.shift_estimation.WINDOW", 6)


def moving(noise=0.02, samples=1500):
    rng = np.random.default_rng(4)
    time = np.arange(samples) * 0.1
    load = np.interp(time, np.arange(0, samples * 0.1 + 5, 5), rng.uniform(0, 6, samples // 50 + 1))
    text, truth = (
        "y = PT1(C(load), T)",
        {"C": kf.Curve("C", range(7), np.sin(np.arange(7.0))), "T": kf.Scalar("T", 1.5)},
    )
    data = kf.Dataset.of("drive", {"load": load}, time=time)
    clean = kf.simulate(text, data, kf.ParameterSet(truth.values()))["y"].values
    start = kf.ParameterSet([truth["C"].with_values(np.zeros(7)), kf.Scalar("T", 1.0)])
    return text, data.with_channels(kf.Channel("wanted", clean + noise * rng.normal(size=samples))), start


@pytest.mark.parametrize("late", mostly_slow([0.0, 3.4, 0.5, -2.7, 7.0], [3.4]))
def test_fractions_of_a_sample_are_found_in_time_data(late):
    text, data, start = moving()
    delayed = shift_channels(data, {"wanted": late * 0.1})
    result = kf.calibrate(text, delayed, start, target="wanted", shift={"wanted": "auto"})
    assert result.shifts["drive"]["wanted"] == pytest.approx(-late * 0.1, abs=0.015)
    assert result.parameters["T"].value == pytest.approx(1.5, abs=0.05)


def noisy(delay, samples=800):
    """A signal of random steps, rounded by a lag, and its double that comes later, with noise of 10 %."""
    rng = np.random.default_rng(1)
    steps = np.repeat(rng.uniform(-1, 1, samples // 20), 20)
    u = np.convolve(steps, np.exp(-np.arange(50) / 5) / 5.5, "full")[:samples]
    data = kf.Dataset.of("drive", {"u": u, "m": 2 * u + 0.1 * rng.normal(size=samples)}, time=np.arange(samples) * 0.1)
    return shift_channels(data, {"m": delay})


def line(data):
    return kf.calibrate("y = k * u", data, {"k": 1.0}, target="m", shift={"m": "auto"})


@pytest.mark.slow
@pytest.mark.usefixtures("narrow_window")
def test_the_search_continues_from_the_edge_of_a_narrow_window():
    assert line(noisy(0.9, 300)).shifts["drive"]["m"] == pytest.approx(-0.9, abs=0.03)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [3.5, 2.0, -5.0])
def test_the_search_continues_from_the_edge_of_the_window(delay):
    result = line(noisy(delay))
    assert result.shifts["drive"]["m"] == pytest.approx(-delay, abs=0.02)
    assert not result.warnings


@pytest.mark.slow
def test_a_shift_at_the_edge_of_the_widest_window_is_a_warning():
    """The window is at most a quarter of the recording, 30 samples."""
    time = np.arange(120) * 0.1
    data = kf.Dataset.of("drive", {"u": np.sin(time / 3), "m": np.sin((time - 5) / 3)}, time=time)
    result = line(data)
    assert "The estimated shift of m in drive is at the edge of the search window (30 samples)." in result.message
    [warning] = result.as_json()["warnings"]
    assert "is at the edge of the search window, 3 s to either side" in warning["sentence"]
    assert "shift = { m = ... }" in warning["remedy"]


@pytest.mark.parametrize(
    ("most", "step", "unit", "remedy"),
    [
        (WIDEST - 1, 0.1, "s", "A longer recording has a wider window, up to a quarter of it."),
        (WIDEST, 0.1, "s", "A coarser raster, such as raster = 1, has a wider window."),
        (WIDEST, 1.0, "samples", f"More than {WIDEST} samples are not searched."),
    ],
)
def test_a_shift_at_the_edge_of_its_window_has_a_remedy(most, step, unit, remedy):
    costs = {float(lag): 1.0 + lag for lag in range(most + 1)}
    edge = Minimum("m", "drive", most * step, step, unit, float(most), most, costs, scored=1000)
    [finding] = _find_doubtful([edge])
    assert finding.remedy == f"If it is known, write it as a number, shift = {{ m = ... }}. {remedy}"


@pytest.mark.slow
@pytest.mark.skipif(not TRANSIENT.is_file(), reason=f"the measurement of the engine is not at {TRANSIENT}")
def test_a_shift_added_to_a_real_engine_is_found_with_its_own():
    """The recording has a lag of its own; one more moves the answer by as much."""
    data = kf.read(TRANSIENT, channels=["speed", "load", "NOx"])
    axes = [np.linspace(-1.5, 1.9, 7), np.linspace(-1.16, 2.3, 7)]
    start = kf.ParameterSet([kf.Map("M", *axes, np.zeros((7, 7))), kf.Scalar("T", 2.0, lower=0.01)])

    def estimated(late):
        model = "y = PT1(M(speed, load), T)"
        delayed = shift_channels(data, {"NOx": late * 0.1})
        result = kf.calibrate(model, delayed, start, target="NOx", smoothness={"M": 10.0}, shift={"NOx": "auto"})
        return result.shifts[data.name]["NOx"], result.quality[0].rmse_after

    (own, error), (more, _) = estimated(0.0), estimated(3.4)
    assert own - more == pytest.approx(0.34, abs=0.015)
    without = kf.calibrate("y = PT1(M(speed, load), T)", data, start, target="NOx", smoothness={"M": 10.0})
    assert error < 0.9 * without.quality[0].rmse_after


GRID = np.arange(6.0)
FLAT = {name: kf.Curve(name, GRID, np.ones(6)) for name in "AB"}
SHAPES = {
    "line": ("m = a + b*u + c*v", {"a": 0.0, "b": 0.0, "c": 0.0}, lambda u, v: 3 + 2 * u - v),
    "curve": ("m = A(u)", {"A": FLAT["A"]}, lambda u, v: np.sin(u)),
    "bump": ("m = A(u)", {"A": FLAT["A"]}, lambda u, v: np.exp(-4 * (u - 2.5) ** 2)),
    "sum": ("m = A(u) + B(v)", FLAT, lambda u, v: np.sin(u) + np.cos(v)),
    "product": ("m = A(u) * B(v)", FLAT, lambda u, v: (2 + np.sin(u)) * (2 + np.cos(v))),
    "zeros": ("m = A(u) * b", {"A": kf.Curve("A", GRID, np.zeros(6)), "b": 0.0}, lambda u, v: np.cos(u)),
    "map": ("m = M(u, v)", {"M": kf.Map("M", GRID, GRID, np.zeros((6, 6)))}, lambda u, v: np.sin(u) * np.cos(v)),
}


def recorded(shape, late, seed=0, noise=0.1, samples=300, **attributes):
    """Points in no order: a channel that is late by a sample has nothing to do with the others."""
    text, start, truth = SHAPES[shape]
    rng = np.random.default_rng(seed)
    u, v = rng.uniform(0, 5, (2, samples))
    t = truth(u, v)
    data = kf.Dataset.of("d", {"u": u, "v": v, "t": t + noise * t.std() * rng.normal(size=samples)}, **attributes)
    return text, shift_channels(data, {"t": late * 0.1 if "time" in attributes else late}), start


def search(text, data, start, **arguments):
    return kf.calibrate(
        text, data, start, "t", shift={"t": "auto"}, options=kf.Options(continuation="off"), **arguments
    )


@pytest.mark.parametrize(
    ("shape", "late", "noise"),
    [
        ("line", 3.0, 0.02),
        ("map", 15.0, 0.02),
        *(
            pytest.param(*case, marks=pytest.mark.slow)
            for case in (
                ("curve", -7.0, 0.3),
                ("bump", 15.0, 0.3),
                ("sum", 3.0, 0.3),
                ("product", -7.0, 0.02),
                ("zeros", 11.0, 0.1),
                ("map", 0.0, 0.3),
            )
        ),
    ],
)
def test_the_shift_of_steady_points_in_any_order_is_found(shape, late, noise):
    result = search(*recorded(shape, late, noise=noise))
    assert result.shifts == {"d": {"t": -late}}
    assert f"The estimated shift of t in d is {0 - late:g} samples: the error is" in result.message


@pytest.mark.slow
@pytest.mark.parametrize("late", mostly_slow([0.0, 4.0, -9.0], [4.0]))
def test_the_shift_of_signals_that_change_with_every_sample_is_found(late):
    result = search(*recorded("sum", late, noise=0.02, samples=600, time=0.1 * np.arange(600)))
    assert result.shifts["d"]["t"] == pytest.approx(-0.1 * late, abs=0.006)


def test_a_shift_that_the_data_do_not_determine_is_reported():
    text, data, start = recorded("curve", 0.0)
    unrelated = data.with_channels(kf.Channel("t", np.random.default_rng(9).normal(size=300)))
    result = search(text, unrelated, start)
    assert "The estimated shift of t in d is ambiguous: the error is" in result.message
    assert "Set it to a number." in result.message
    assert "is ambiguous" in str(result.warnings[0])


def walked(late):
    """Points of a random walk: a channel that is late by a sample resembles itself in time."""
    rng = np.random.default_rng(0)
    text, start, truth = SHAPES["sum"]
    u, v = (walk(300, 0, 5, rng) for _ in range(2))
    data = kf.Dataset.of("d", {"u": u, "v": v, "t": truth(u, v) + 0.08 * rng.normal(size=300)})
    return text, shift_channels(data, {"t": late}), start


@pytest.mark.slow
@pytest.mark.usefixtures("narrow_window")
def test_synchronous_channels_are_not_moved():
    assert kf.calibrate(*walked(0.0), "t", shift={"t": "auto", "u": "auto"}).shifts == {"d": {"t": 0.0, "u": 0.0}}


@pytest.mark.usefixtures("narrow_window")
def test_a_channel_recorded_one_sample_late_is_moved_back():
    late, shifted = kf.calibrate(*walked(1.0), "t"), kf.calibrate(*walked(1.0), "t", shift={"t": -1.0})
    result = search(*walked(1.0))
    assert result.shifts == result.as_json()["shifts"] == {"d": {"t": -1.0}}
    assert result.quality[0].rmse_after < 1.1 * 0.08 < 0.4 * late.quality[0].rmse_after
    assert result.parameters["A"].values == pytest.approx(shifted.parameters["A"].values, abs=1e-6)


@pytest.mark.slow
@pytest.mark.usefixtures("narrow_window")
def test_each_dataset_has_its_own_shift_and_test_data_take_their_median():
    def dataset(seed, late, use="training"):
        text, data, start = recorded("line", late, seed, samples=60)
        return text, replace(data, name=f"{use} {seed}", use=use), start

    (text, first, start), *others, (_, test, _) = (dataset(0, 1), dataset(1, 3), dataset(2, 3), dataset(9, 5, "test"))
    result = search(text, [first, *(data for _, data, _ in others)], start, test=test)
    assert [shift["t"] for shift in result.shifts.values()] == [-1.0, -3.0, -3.0, -3.0]


@pytest.mark.slow
@pytest.mark.usefixtures("narrow_window")
def test_two_late_channels_are_found():
    text, data, start = recorded("sum", 0.0, samples=200)
    late = shift_channels(data, {"u": 4.0, "v": -3.0})
    result = kf.calibrate(text, late, start, "t", shift={"u": "auto", "v": "auto"})
    assert result.shifts == {"d": {"u": -4.0, "v": 3.0}}


def test_a_channel_without_a_role_cannot_be_shifted():
    with pytest.raises(kf.KennfeldError, match=r"unknown channel Torqe\. Did you mean Torque"):
        calibrated(bench(0), {"Torqe": "auto"})
    data = bench(0).with_channels(kf.Channel("Lambda", np.ones(1200)))
    with pytest.raises(kf.InputError, match="Lambda is neither an input of the function nor a target"):
        calibrated(data, {"Lambda": "auto"})
    with pytest.raises(kf.KennfeldError, match="shift='late' of Torque must be a finite number or \"auto\""):
        calibrated(data, {"Torque": "late"})


def test_a_number_moves_the_channel_as_in_a_project():
    assert calibrated(bench(2, samples=600), {"Torque": -2.0}).quality[0].rmse_after < 1.1 * torque.NOISE


def test_datasets_of_the_same_name_are_refused():
    data = [bench(1, 0, samples=300), bench(1, 0, samples=300)]
    with pytest.raises(
        kf.InputError,
        match=r"dataset training 0.*2 training datasets of this name.*a unique name",
    ):
        calibrated(data, {"Torque": "auto"})
