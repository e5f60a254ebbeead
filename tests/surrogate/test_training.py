import re
from dataclasses import replace

import numpy as np
import pytest

from kennfeld.base.errors import ArgumentError, InputError
from kennfeld.domain.dataset import Channel, Dataset
from kennfeld.surrogate import DynamicSurrogate, StaticSurrogate, dynamic_training
from kennfeld.surrogate.model_selection import _lowest, select_lags
from kennfeld.surrogate.narx_training import TrainingSettings
from kennfeld.surrogate.training import SurrogateSettings, train_surrogate
from kennfeld.surrogate.training_data import split_recordings
from tests.draws import mostly_slow
from tests.surrogate.surrogates import tank_recording


def bench(name, seed, use="training", samples=120):
    rng = np.random.default_rng(seed)
    speed, air = rng.uniform(700, 4000, samples), rng.uniform(10, 100, samples)
    torque = 2 * air - 30 * np.sin(speed / 900) + rng.normal(size=samples)
    units = {"speed": "rpm", "air": "%", "torque": "Nm"}
    return Dataset.of(name, {"speed": speed, "air": air, "torque": torque}, units=units, use=use)


def rows(surrogate):
    return {(line.dataset, line.mode): line for line in surrogate.quality}


@pytest.mark.parametrize("method", mostly_slow(["auto", "sparse", "expansion"], ["auto", "expansion"]))
def test_a_static_surrogate_is_trained_and_tested(method):
    settings = SurrogateSettings("torque", ("speed", "air"), "torque", method=method, centres=40, starts=1)
    surrogate = train_surrogate([bench("a", 0), bench("b", 1, "test")], settings)
    assert isinstance(surrogate, StaticSurrogate)
    assert surrogate.units == ("rpm", "%", "Nm")
    scores = rows(surrogate)
    assert scores["b", "static"].use == "test"
    assert scores["b", "static"].rmse < 3
    assert scores["a", "static"].r2 > 0.99
    if method != "expansion":
        assert scores["all", "leave one out"].rmse < 2.5


def test_missing_values_and_unscored_samples_teach_nothing():
    data = bench("a", 0)
    torque = data["torque"].values.copy()
    torque[:5] = np.nan
    torque[5:10] = 1e6
    spoilt = Dataset.of(
        "a",
        {"speed": data["speed"].values, "air": data["air"].values, "torque": torque},
        scored=np.arange(120) >= 10,
    )
    surrogate = train_surrogate([spoilt], SurrogateSettings("torque", ("speed", "air"), "torque", starts=1))
    assert rows(surrogate)["a", "static"].samples == 110
    assert rows(surrogate)["a", "static"].rmse < 3


def static_settings(**changes):
    return SurrogateSettings("torque", ("speed", "air"), "torque", **({"starts": 1, "kernel": "gaussian"} | changes))


@pytest.mark.parametrize("method", ["auto", "expansion"])
def test_the_plane_stands_beside_the_errors_of_the_model(method):
    data = [bench("a", 0), bench("b", 1, "test")]
    scores = rows(train_surrogate(data, static_settings(method=method, centres=30)))
    design = [np.column_stack([np.ones(120), each["speed"].values, each["air"].values]) for each in data]
    plane = np.linalg.lstsq(design[0], data[0]["torque"].values, rcond=None)[0]
    for each, rows_of in zip(data, design, strict=True):
        residual = rows_of @ plane - each["torque"].values
        assert scores[each.name, "plane"].rmse == pytest.approx(np.sqrt(np.mean(residual**2)))
    assert scores["b", "static"].rmse < 0.3 * scores["b", "plane"].rmse
    assert (("all", "plane left out") in scores) == (method == "auto")


def test_samples_that_are_not_used_are_named():
    data = bench("a", 0)
    torque = data["torque"].values.copy()
    torque[[0, 41]] = np.nan, 1e6
    columns = {"speed": data["speed"].values, "air": data["air"].values, "torque": torque}
    surrogate = train_surrogate([Dataset.of("a", columns)], static_settings())
    assert len(surrogate.remarks) == 1
    assert surrogate.remarks[0].startswith(
        "sample 42 of a is an outlier and was not used: torque is 1e+06, its neighbours"
    )
    assert rows(surrogate)["a", "static"].samples == 118
    assert rows(surrogate)["a", "static"].rmse < 3


@pytest.mark.slow
def test_a_duplicate_dataset_is_reported_and_does_not_change_the_errors():
    once = train_surrogate([bench("a", 0)], static_settings())
    twice = train_surrogate([bench("a", 0), bench("b", 0)], static_settings())
    message = "120 of 240 rows repeat the inputs of another row; they count as one point with less noise"
    assert (once.remarks, twice.remarks) == ((), (message,))
    figures = [rows(surrogate)["all", "leave one out"].rmse for surrogate in (once, twice)]
    assert figures[1] == pytest.approx(figures[0], rel=1e-6)


def drive(name, seed, use="training", samples=300):
    """A recording over time whose output has a slow part that is not a function of the inputs."""
    time = np.arange(samples) * 0.1
    rng = np.random.default_rng(seed)
    speed = 2000 + 800 * np.interp(time, np.arange(0, 40, 2.0), rng.normal(size=20))
    air = 50 + 20 * np.interp(time, np.arange(0, 40, 1.0), rng.normal(size=40))
    slow = 5 * np.interp(time, np.arange(0, 40, 4.0), rng.normal(size=10))
    torque = 2 * air - 30 * np.sin(speed / 900) + slow
    return Dataset.of(name, {"speed": speed, "air": air, "torque": torque}, time=time, use=use)


@pytest.mark.slow
def test_of_a_recording_whole_blocks_are_left_out():
    data = [drive("a", 0), drive("b", 1, "test")]
    surrogate = train_surrogate(data, static_settings())
    scores = rows(surrogate)
    assert ("all", "leave one out") not in scores
    assert scores["all", "blocks left out"].rmse == pytest.approx(scores["b", "static"].rmse, rel=0.6)
    assert scores["a", "static"].rmse < 0.8 * scores["all", "blocks left out"].rmse
    points = np.column_stack([data[1]["speed"].values, data[1]["air"].values])
    error = np.abs(surrogate(points) - data[1]["torque"].values)
    assert np.mean(error < 2 * surrogate.deviation(points)) > 0.85


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kernel": "cosine"}, "kernel='cosine' of static surrogate torque must be auto or gaussian or matern52"),
        ({"noise": "cauchy"}, "noise='cauchy' of static surrogate torque must be auto or gaussian or student"),
        ({"kernel": "matern52", "kind": "dynamic"}, "kernel='matern52' of dynamic surrogate torque must be auto or"),
        ({"noise": "student", "method": "expansion"}, "noise='student' of surrogate torque is not possible with"),
        ({"centres": 0}, "centres=0 of surrogate torque must be >= 1"),
    ],
)
def test_kernel_noise_and_centres_that_do_not_fit_are_refused(changes, message):
    with pytest.raises(ArgumentError, match=re.escape(message)):
        static_settings(**changes)


def test_without_an_uncertainty_the_deviation_is_unknown():
    surrogate = train_surrogate([bench("a", 0)], static_settings(method="expansion", centres=5))
    assert np.isnan(surrogate.deviation(np.array([[1000.0, 50.0], [2000.0, 20.0]]))).tolist() == [True, True]


def tank_settings(**changes):
    attributes = {"kind": "dynamic", "lags": {"u": (1,)}, "output_lags": (1,), "centres": 15, "starts": 1, "hold": 1.0}
    return SurrogateSettings("tank", ("u",), "level", **(attributes | changes))


@pytest.mark.slow
def test_a_dynamic_surrogate_predicts_another_recording_in_free_run():
    data = [tank_recording("a", 0), tank_recording("b", 1, noise=0.0, use="test")]
    progress = []
    surrogate = train_surrogate(data, tank_settings(), progress.append)
    assert isinstance(surrogate, DynamicSurrogate)
    assert (surrogate.step, surrogate.output_lags, surrogate.lags) == (1.0, (1,), ((1,),))
    scores = rows(surrogate)
    assert scores["b", "free run"].rmse < 0.02
    assert scores["b", "one step"].samples == 399
    assert "All 48 free runs" in surrogate.stability
    assert any("free run over 30 samples, step 1" in line for line in progress)
    u, level = data[1]["u"].values[:, None], data[1]["level"].values
    assert surrogate.outside(u, level).mean() < 0.1
    assert surrogate.outside(u + 40, level).all()


@pytest.mark.slow
def test_training_for_free_run_helps_where_one_step_is_misled_by_noise():
    data = [tank_recording("a", 0, samples=600, noise=0.1), tank_recording("b", 1, noise=0.0, use="test")]
    one_step = rows(train_surrogate(data, tank_settings(free_run=False)))
    free_run = rows(train_surrogate(data, tank_settings()))
    assert free_run["b", "free run"].rmse < 0.6 * one_step["b", "free run"].rmse


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "centres", "most"), [(80, 5, 0.04), pytest.param(130, 8, 0.03, marks=pytest.mark.slow)]
)
def test_the_strength_of_the_hold_is_chosen_on_blocks_left_out(samples, centres, most):
    """Held a hundred times as firmly, the error is 0.07 with few samples."""
    progress = []
    data = [
        tank_recording("a", 0, samples=samples),
        tank_recording("b", 1, samples=samples, noise=0.0, use="test"),
    ]
    surrogate = train_surrogate(data, tank_settings(hold=None, centres=centres), progress.append)
    assert sum("blocks left out" in line for line in progress) >= 3
    assert rows(surrogate)["b", "free run"].rmse < most


class After:
    """Tells to stop once it has been asked a number of times."""

    def __init__(self, times):
        self.left = times

    def __call__(self):
        self.left -= 1
        return self.left < 0


@pytest.mark.parametrize(
    ("method", "times"), [("exact", 0), ("sparse", 1), ("exact", 3), ("sparse", 8), ("exact", 30), ("sparse", 30)]
)
def test_a_stopped_static_training_returns_the_best_so_far(method, times):
    settings = SurrogateSettings("torque", ("speed", "air"), "torque", method=method, centres=40)
    stopped = train_surrogate([bench("a", 0), bench("b", 1, "test")], settings, stopped=After(times))
    assert np.isfinite(rows(stopped)["b", "static"].rmse)
    assert rows(stopped)["b", "static"].rmse < 60


@pytest.mark.slow
def test_a_training_that_is_stopped_at_once_is_shorter_than_a_whole_one():
    whole, asked = After(10**6), After(0)
    settings = tank_settings(hold=None, lags="auto", output_lags="auto", centres=3, longest_lag=1)
    data = [tank_recording("a", 0, samples=45), tank_recording("b", 1, samples=45, noise=0.0, use="test")]
    progress = []
    model = train_surrogate(data, settings, progress.append, asked)
    assert (model.output_lags, model.lags) == ((1,), ((1,),))
    assert progress[0] == "stopped before the training for free run; the model predicts one step ahead"
    assert all(line.startswith("Remark: ") for line in progress[1:])
    assert np.isfinite(rows(model)["b", "one step"].rmse)
    train_surrogate(data, settings, progress.append, whole)
    assert len(progress) > 10


@pytest.mark.parametrize("words", mostly_slow(["blocks left out", "free run over 30 samples, step 2"], 1))
def test_a_stop_ends_the_selection_and_the_training_for_free_run(words):
    progress = []
    data = [tank_recording("a", 0, samples=90), tank_recording("b", 1, samples=90, noise=0.0, use="test")]
    model = train_surrogate(
        data, tank_settings(hold=None, centres=4), progress.append, lambda: any(words in line for line in progress)
    )
    assert sum(words in line for line in progress) == 1
    later = progress[[words in line for line in progress].index(True) + 1 :]
    assert later == ([] if "free run" in words else [later[0]])
    assert np.isfinite(rows(model)["b", "free run"].rmse)


def test_a_single_low_among_high_ones_is_not_chosen():
    table = np.array([[9.0, 1.9, 9.0, 9.0, np.inf], [9.0, 2.1, 2.0, 2.1, 9.0]])
    assert _lowest(table) == (1, 2)


def test_a_dead_time_is_identified_among_the_lags():
    rng = np.random.default_rng(0)
    u = np.repeat(rng.uniform(-1, 1, 10), 6)
    y = np.zeros(60)
    for k in range(3, 60):
        y[k] = 0.7 * y[k - 1] + u[k - 3]
    data = Dataset.of("delayed", {"u": u, "y": y + 0.01 * rng.normal(size=60)}, time=0.1 * np.arange(60))
    lags = select_lags(split_recordings(data, ("u",), "y", 0.1), 1, TrainingSettings(), longest=4, output_lags=(1,))
    assert lags.output == (1,)
    assert 3 in lags.inputs[0]


def test_a_gap_ends_a_run_and_a_short_one_is_bridged():
    u, level = np.arange(40.0), np.arange(40.0)
    level[10], level[20:25] = np.nan, np.nan
    data = Dataset.of("gaps", {"u": u, "level": level}, time=np.arange(40.0), max_gap=2.5)
    runs = split_recordings(data, ("u",), "level", 1.0)
    assert [len(run) for run in runs] == [20, 15]
    assert runs[0].y[10] == 10.0
    assert (
        len(split_recordings(Dataset.of("gaps", {"u": u, "level": level}, time=np.arange(40.0)), ("u",), "level", 1.0))
        == 3
    )


def test_a_recording_on_another_raster_is_brought_onto_the_step():
    time = 0.5 * np.arange(81)
    data = Dataset.of("fine", {"u": 0.1 * time, "level": 2.0 * time + 0.25}, time=time)
    (run,) = split_recordings(data, ("u",), "level", 2.0)
    np.testing.assert_allclose(run.y, 4.0 * np.arange(21) + 0.25)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "transient"}, "kind='transient' of surrogate tank must be static or dynamic"),
        ({"method": "exact"}, "method='exact' of dynamic surrogate tank must be auto or sparse"),
        ({"lags": {"v": (1,)}}, "lags of 'v', which is not an input of tank"),
        ({"lags": {}}, "lags of input 'u' of surrogate tank are missing"),
        ({"centres": 0}, "centres=0 of surrogate tank must be >= 1"),
        ({"step": -1.0}, "step=-1.0 of surrogate tank"),
        ({"hold": -1.0}, "hold=-1.0 of surrogate tank"),
        ({"limits": (2.0, 1.0)}, r"limits=\(2.0, 1.0\) of surrogate tank"),
        ({"held": ("w",)}, r"held=\('w',\) of surrogate tank: w is not an input"),
    ],
)
def test_settings_that_cannot_be_used_are_named(changes, message):
    with pytest.raises(ArgumentError, match=message):
        tank_settings(**changes)


def test_all_missing_channels_are_reported_at_once():
    settings = SurrogateSettings("torque", ("sped", "air"), "trq")
    with pytest.raises(InputError) as caught:
        train_surrogate([bench("a", 0, "test")], settings)
    message = str(caught.value)
    assert "dataset a: channel sped is missing. Did you mean speed?" in message
    assert "channel trq is missing" in message
    assert "there is no training dataset" in message


def test_points_without_time_stamps_are_not_a_recording():
    with pytest.raises(InputError, match="dataset a: a dynamic model requires time stamps"):
        train_surrogate([bench("a", 0)], SurrogateSettings("x", ("speed",), "torque", kind="dynamic"))


def test_channels_that_never_change_are_named():
    time = np.arange(60.0)
    data = Dataset.of("still", {"u": np.sin(time), "v": np.full(60, 3.0), "y": np.zeros(60)}, time=time)
    with pytest.raises(InputError) as caught:
        train_surrogate([data], SurrogateSettings("x", ("u", "v"), "y", kind="dynamic"))
    assert "channel v: is 3 in all training data" in str(caught.value)
    assert "channel y: is 0 in all training data" in str(caught.value)


def test_a_constant_output_is_learnt_as_one():
    rng = np.random.default_rng(0)
    data = Dataset.of("flat", {"u": rng.normal(size=30), "y": np.full(30, 7.0)})
    surrogate = train_surrogate([data], SurrogateSettings("x", ("u",), "y", starts=1))
    assert surrogate(np.array([0.3])) == pytest.approx(7.0)
    assert np.isnan(rows(surrogate)["flat", "static"].r2)


def test_too_short_recordings_are_reported():
    time = np.arange(6.0)
    data = Dataset.of("short", {"u": np.sin(time), "y": np.cos(time)}, time=time)
    with pytest.raises(InputError, match="no piece without gaps that is long enough"):
        train_surrogate([data], SurrogateSettings("x", ("u",), "y", kind="dynamic"))


def overflowing(name, seed, use="training", samples=250):
    """A level that is measured up to 1.2 only, where the tank overflows."""
    rng = np.random.default_rng(seed)
    u, level = np.repeat(rng.uniform(0.2, 1.6, samples // 10), 10), np.full(samples, 0.5)
    for k in range(samples - 1):
        level[k + 1] = min(level[k] + 0.2 * (u[k] - np.sqrt(level[k])), 1.2)
    return Dataset.of(name, {"u": u, "level": level}, time=np.arange(float(samples)), use=use)


def test_a_saturated_output_gets_its_limit_and_a_remark():
    model = train_surrogate([overflowing("a", 0)], tank_settings())
    assert model.limits == (-np.inf, 1.2)
    (remark,) = model.remarks
    assert "level stays at its maximum 1.2" in remark
    assert "limits = [-inf, 1.2] are used" in remark


@pytest.mark.slow
def test_a_saturated_output_is_predicted_better_with_its_limit():
    data = [overflowing("a", 0), overflowing("b", 1, "test")]
    model, free = (train_surrogate(data, tank_settings(**limits)) for limits in ({}, {"limits": (-np.inf, np.inf)}))
    assert free.remarks == ()
    assert free.limits == (-np.inf, np.inf)
    assert rows(model)["b", "free run"].rmse < 0.5 * rows(free)["b", "free run"].rmse


@pytest.mark.slow
def test_a_plane_and_a_linear_model_stand_beside_the_errors():
    errors = rows(train_surrogate([tank_recording("a", 0), tank_recording("b", 1, use="test")], tank_settings()))
    for name in "ab":
        assert errors[name, "free run"].rmse < errors[name, "ARX"].rmse < errors[name, "plane"].rmse


def test_a_better_linear_model_is_reported():
    """A model for each sample far away from its training data."""
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=400), np.zeros(400)
    for k in range(1, 400):
        y[k] = 0.8 * y[k - 1] + u[k - 1]
    time = np.arange(200.0)
    data = [
        Dataset.of("a", {"u": u[:200], "level": y[:200] + 0.3 * rng.normal(size=200)}, time=time),
        Dataset.of("far", {"u": 5 * u[200:], "level": 5 * y[200:]}, time=time, use="test"),
    ]
    model = train_surrogate(data, tank_settings(free_run=False, centres=60))
    (remark,) = model.remarks
    assert "the free run over far (test) has RMSE" in remark
    assert "a linear ARX model has" in remark


@pytest.mark.slow
def test_a_linear_system_is_modelled_as_well_as_by_a_linear_model():
    rng = np.random.default_rng(0)
    u, y = rng.normal(size=600), np.zeros(600)
    for k in range(2, 600):
        y[k] = 1.2 * y[k - 1] - 0.4 * y[k - 2] + u[k - 1]
    time = np.arange(300.0)
    data = [
        Dataset.of("a", {"u": u[:300], "level": y[:300] + 0.1 * rng.normal(size=300)}, time=time),
        Dataset.of("b", {"u": u[300:], "level": y[300:]}, time=time, use="test"),
    ]
    settings = tank_settings(lags="auto", output_lags="auto", hold=None, longest_lag=4)
    errors = rows(train_surrogate(data, settings))
    assert errors["b", "free run"].rmse <= 1.05 * errors["b", "ARX"].rmse


def test_a_channel_that_hardly_changes_is_remarked_on():
    data = tank_recording("a", 0)
    switch = np.zeros(400)
    switch[200:203] = 1.0
    columns = {"u": data["u"].values, "switch": switch, "level": data["level"].values}
    settings = SurrogateSettings(
        "tank",
        ("u", "switch"),
        "level",
        kind="dynamic",
        lags={"u": (1,), "switch": (0,)},
        output_lags=(1,),
        centres=9,
        starts=1,
        hold=1.0,
        iterations=1,
    )
    model = train_surrogate([Dataset.of("a", columns, time=np.arange(400.0))], settings)
    assert model.remarks == ("switch is 0 except at 3 samples of 400; the model can hardly know its effect",)


@pytest.mark.parametrize("held", [(), ("u",)])
def test_piecewise_constant_inputs_are_not_interpolated(held):
    time, u = 1.0 * np.arange(20), np.sin(np.arange(20.0))
    (run,) = split_recordings(Dataset.of("a", {"u": u, "y": time}, time=time), ("u",), "y", 0.5, held)
    expected = np.repeat(u, 2)[:-1] if held else np.interp(0.5 * np.arange(39), time, u)
    np.testing.assert_allclose(run.u[:, 0], expected)


@pytest.mark.slow
def test_a_model_that_runs_away_is_limited_beyond_its_training_data(monkeypatch):
    monkeypatch.setattr(
        dynamic_training, "train_over_horizons", lambda start, *rest: replace(start, slopes=1.5 * start.slopes)
    )
    data = [tank_recording("a", 0)]
    model = train_surrogate(data, tank_settings())
    level = data[0]["level"].values
    span = np.ptp(level)
    assert model.limits == pytest.approx((level.min() - span, level.max() + span), abs=1e-3 * span)
    assert "free runs left the training data far behind" in model.remarks[0]
    assert np.isfinite(model.simulate(np.full((10_000, 1), 9.0))).all()


@pytest.mark.parametrize("sampling", [0.01, 0.1, 1.0])
def test_a_mask_applies_to_the_raster_by_the_nearest_sample(sampling):
    time = np.arange(0.0, 12.0, sampling)
    channels = [Channel("u", np.sin(time)), Channel("y", np.cos(time))]
    dataset = Dataset("drive", channels, time, scored=time >= 5.0 - 1e-9)
    [recording] = split_recordings(dataset, ["u"], "y", 0.1)
    raster = 0.1 * np.arange(recording.scored.size)
    begin = 5.0 if sampling < 0.5 else 4.5
    assert raster[recording.scored][0] == pytest.approx(begin, abs=1e-6)
