"""Automatic smoothness: about as good as the best fixed factor, deviations that hold, and no value runs away."""

import tracemalloc

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import ArgumentError
from tests.draws import mostly_slow

FACTORS = (0.01, 0.1, 1.0, 10.0, 100.0, 1000.0, 1e4)


def noisy(samples, noise, seed=0, function=np.sin, low=0.0):
    rng = np.random.default_rng(seed)
    x = rng.uniform(low, 6, samples)
    return {"x": x, "wanted": function(x) + noise * rng.normal(size=samples)}


def curve(count=25, **attributes):
    return kf.ParameterSet([kf.Curve("C", np.linspace(0, 6, count), np.zeros(count), **attributes)])


def fitted(data, smoothness="auto", start=None, **arguments):
    dense = np.linspace(0.1, 5.9, 400)
    truth = arguments.pop("function", np.sin)
    test = {"x": dense, "wanted": truth(dense)}
    return kf.calibrate(
        "y = C(x)", data, start or curve(), target="wanted", test=test, smoothness=smoothness, **arguments
    )


@pytest.mark.slow
@pytest.mark.parametrize("seeds", [1, pytest.param(4, marks=pytest.mark.slow)])
@pytest.mark.parametrize("noise", mostly_slow([0.02, 0.3], [0.3]))
def test_the_choice_is_about_as_good_as_the_best_fixed_factor(noise, seeds):
    """In the mean over seeds; the best factor is known only afterwards."""
    errors = np.zeros(len(FACTORS) + 1)
    for seed in range(seeds):
        data = noisy(150, noise, seed)
        errors += [fitted(data, factor).quality[1].rmse_after ** 2 for factor in (*FACTORS, "auto")]
    assert errors[-1] <= 1.25**2 * errors[:-1].min()


POINTS = np.linspace(0, 1, 9)
SURFACE = 100 + 30 * np.sin(3 * POINTS[:, None]) * np.cos(2 * POINTS) + 20 * POINTS[:, None] * POINTS


def measured(samples, seed):
    """Points on a map of 81 values with noise of 2."""
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 1, (2, samples))
    truth = kf.ParameterSet([kf.Map("M", POINTS, POINTS, SURFACE)])
    clean = kf.simulate("m = M(x, y)", {"x": x, "y": y}, truth)["m"].values
    return {"x": x, "y": y, "wanted": clean + 2 * rng.normal(size=samples)}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "seeds"),
    [
        (10_000, 1),
        *(pytest.param(10**k * 3, 4, marks=pytest.mark.slow) for k in (2, 3, 4)),
    ],
)
def test_deviations_hold_and_the_error_vanishes_with_the_number_of_samples(samples, seeds):
    """Fits with other factors share their noise: a choice must not be smoother than they are uncertain alike."""
    start = kf.ParameterSet([kf.Map("M", POINTS, POINTS, np.zeros((9, 9)))])
    inside, squares = [], np.zeros(9)
    for seed in range(seeds):
        data = measured(samples, seed)
        for number, factor in enumerate(["auto", *(samples * 10.0 ** np.arange(-6, 2))]):
            result = kf.calibrate("m = M(x, y)", data, start, target="wanted", smoothness=factor)
            error = result.parameters["M"].values - SURFACE
            squares[number] += np.mean(error**2)
            if factor == "auto":
                inside.append(np.mean(np.abs(error) <= 2 * result.trust.deviation["M"]))
    assert np.mean(inside) >= 0.93
    assert squares[0] <= 1.1**2 * squares[1:].min()


def test_values_that_the_data_determine_do_not_depend_on_the_start():
    """A pull towards it that grows with the data would bias the values by many of their deviations."""
    rng = np.random.default_rng(0)
    x = rng.uniform(0, 6, 8_000)
    data = {"x": x, "wanted": 300 + 40 * np.sin(x) + 0.5 * rng.normal(size=x.size)}
    results = [fitted(data, start=kf.ParameterSet([curve(9)["C"].with_values(np.full(9, v))])) for v in (0, 1000)]
    low, high = (result.parameters["C"].values for result in results)
    assert np.abs(high - low).max() < 0.02 * results[0].trust.deviation["C"].min()


def test_a_constant_is_fitted_exactly():
    x = np.random.default_rng(0).uniform(0, 6, 300)
    values = fitted({"x": x, "wanted": np.full(300, 7.0)}, start=curve(9)).parameters["C"].values
    assert values == pytest.approx(np.full(9, 7.0), abs=1e-12)


@pytest.mark.slow
def test_many_values_and_few_points_need_matrices_of_their_blocks_only():
    """Dense matrices of 3600 values would take 100 MB each."""
    points = np.linspace(0, 1, 60)
    x, y = np.random.default_rng(0).uniform(0, 1, (2, 10))
    start = kf.ParameterSet([kf.Map("M", points, points, np.zeros((60, 60)))])
    data = {"x": x, "y": y, "wanted": x + y}
    tracemalloc.start()
    result = kf.calibrate("m = M(x, y)", data, start, target="wanted", smoothness="auto")
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    assert result.quality[0].rmse_after < 1e-3
    assert peak < 80e6


def test_more_noise_leads_to_more_smoothness():
    quiet, loud = (fitted(noisy(150, noise)).smoothness["C"]["x"] for noise in (0.02, 0.5))
    assert loud > 10 * quiet


def test_a_straight_line_under_noise_becomes_one():
    data = noisy(300, 0.3, function=lambda x: 2 * x - 1)
    values = fitted(data, function=lambda x: 2 * x - 1).parameters["C"].values
    assert np.abs(np.diff(values, 2)).max() < 0.05


def test_data_without_noise_are_fitted():
    truth = curve().with_parameters(kf.Curve("C", np.linspace(0, 6, 25), np.cos(np.arange(25.0))))["C"]
    x = np.random.default_rng(1).uniform(0, 6, 400)
    data = {"x": x, "wanted": np.interp(x, truth.axes[0].breakpoints, truth.values)}
    assert fitted(data).parameters["C"].values == pytest.approx(truth.values, abs=1e-3)


def test_each_axis_has_its_own_factor_and_stated_factors_stay():
    rng = np.random.default_rng(3)
    x, y = rng.uniform(0, 6, (2, 300))
    data = {"x": x, "y": y, "wanted": np.sin(2 * x) + 0.5 * y + 0.2 * rng.normal(size=300)}
    start = kf.ParameterSet([kf.Map("M", np.linspace(0, 6, 7), np.linspace(0, 6, 7), np.zeros((7, 7)))])
    for setting, expected in (("auto", None), (("auto", 7.0), 7.0)):
        result = kf.calibrate("z = M(x, y)", data, start, target="wanted", smoothness={"M": setting})
        factors = result.smoothness["M"]
        assert factors["y"] == expected if expected else factors["y"] > 10 * factors["x"]
        assert result.converged
        assert result.as_json()["smoothness"] == {"M": factors}


def test_a_table_without_data_keeps_its_start_and_gets_no_factor():
    data = noisy(100, 0.1) | {"never": np.zeros(100)}
    start = curve().with_parameters(kf.Curve("Other", [1, 2, 3], [4.0, 7.0, 5.0]))
    result = kf.calibrate("y = C(x) + if(never > 1, Other(x), 0)", data, start, target="wanted", smoothness="auto")
    assert result.smoothness["Other"] == {"x": 0.0}
    assert result.smoothness["C"]["x"] > 0
    assert result.parameters["Other"].values.tolist() == [4.0, 7.0, 5.0]


def exchange(count, seed=0, noise=0.3):
    """A product of tables less another, all on one grid, seen in half of it: three changes alter no output."""
    rng = np.random.default_rng(seed)
    x, y, z = rng.uniform(0, 1, (3, 4 * count))
    x, y, z = (channel[x + y < 1][:count] for channel in (x, y, z))
    wanted = (100 + 80 * x + 60 * y) * (1 - 0.3 * (z - 0.3) ** 2) - 20 * x + noise * rng.normal(size=count)
    return {"x": x, "y": y, "z": z, "wanted": wanted}


PRODUCT = "m = A(x, y) * E(z) - B(x, y)"


def tables():
    points, flat = np.linspace(0, 1, 7), np.ones((7, 7))
    maps = [kf.Map("A", points, points, 50 * flat), kf.Map("B", points, points, 10 * flat)]
    return kf.ParameterSet([*maps, kf.Curve("E", points, 1 - 0.1 * points)])


@pytest.mark.slow
def test_the_last_search_continues_from_the_fit_with_the_chosen_factors():
    """Tables that multiply each other take many steps from their start; the chosen fit has taken them."""
    rng = np.random.default_rng(0)
    x, y = rng.uniform(0, 1, (2, 200))
    data = {"x": x, "y": y, "wanted": np.exp(x) * (1 + np.sin(3 * y)) + 0.05 * rng.normal(size=200)}
    points = np.linspace(0, 1, 7)
    start = kf.ParameterSet([kf.Curve(name, points, np.ones(7)) for name in "AB"])
    result = kf.calibrate("m = A(x) * B(y)", data, start, target="wanted", smoothness="auto")
    stages = [line.stage for line in result.trace]
    assert result.status == "converged"
    assert stages.count("smoothness 1") > 5
    assert stages.count("plain") <= 5


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(
    "pins",
    [pytest.param([], id="free"), pytest.param([kf.Pin("E", (0.3,), 1.0)], id="pinned")],
)
def test_tables_that_can_be_exchanged_stay_near_their_start(seed, pins):
    """Scaling A, dividing E and raising B by A change no output; factors of their own let the scale drift for ever."""
    result = kf.calibrate(
        PRODUCT,
        exchange(400, seed),
        tables(),
        target="wanted",
        test=exchange(1000, seed + 10),
        smoothness="auto",
        pins=pins,
    )
    values = {name: table.values for name, table in result.parameters.items()}
    assert result.quality[1].rmse_after < 0.35
    assert 0.5 < values["E"].min() <= values["E"].max() < 3
    assert 0 < values["A"].min() <= values["A"].max() < 300
    assert np.abs(values["B"]).max() < 100
    for axis in (0, 1):
        assert np.abs(np.diff(values["A"], axis=axis)).max() < 40


@pytest.mark.parametrize(("samples", "seed"), [pytest.param(300, 0, marks=pytest.mark.slow), (100, 2)])
def test_a_plane_through_noise_is_not_twisted_beyond_the_data(samples, seed):
    """Any multiple of x * y is smooth, and data in a narrow band hardly tell it: where they end, it must not grow."""
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, 8, samples)
    y = (x + rng.uniform(-0.5, 0.5, samples)).clip(0, 8)
    start = kf.ParameterSet([kf.Map("M", range(9), range(9), np.zeros((9, 9)))])
    data = {"x": x, "y": y, "wanted": 0.25 * (x + y) + 2 * rng.normal(size=samples)}
    values = kf.calibrate("m = M(x, y)", data, start, target="wanted", smoothness="auto").parameters["M"].values
    assert -1 < values.min() <= values.max() < 5


def test_a_curve_continues_smoothly_beyond_the_data():
    result = fitted(noisy(200, 0.05, low=2.0))
    values = result.parameters["C"].values
    assert np.abs(np.diff(values[:8], 2)).max() < 0.02


def test_bounds_locks_and_pins_hold_while_factors_are_chosen():
    start = curve(lower=-0.5, upper=0.5).with_parameters()
    locked = np.arange(25) == 12
    table = start["C"].with_values(np.where(locked, 0.25, 0.0)).changed(locked=locked)
    pin = kf.Pin("C", (1.1,), 0.3)
    result = fitted(noisy(200, 0.1), start=kf.ParameterSet([table]), pins=[pin])
    values = result.parameters["C"].values
    assert result.converged
    assert values.min() >= -0.5
    assert values.max() <= 0.5
    assert np.any(values == 0.5)
    assert values[12] == 0.25
    assert np.interp(1.1, np.linspace(0, 6, 25), values) == pytest.approx(0.3, abs=1e-9)


@pytest.mark.slow
def test_a_model_with_memory_is_smoothed():
    rng = np.random.default_rng(5)
    time = np.arange(3000) * 0.1
    x = 3 + 2.8 * np.sin(time / 7) * np.cos(time / 31)
    truth = {"C": kf.Curve("C", np.linspace(0, 6, 13), np.sin(np.linspace(0, 6, 13))), "T": kf.Scalar("T", 2.0)}
    text = "y = PT1(C(x), T)"
    moving = kf.Dataset.of("drive", {"x": x}, time=time)
    clean = kf.simulate(text, moving, kf.ParameterSet(truth.values()))["y"].values
    data = moving.with_channels(kf.Channel("wanted", clean + 0.1 * rng.normal(size=time.size)))
    start = kf.ParameterSet([truth["C"].with_values(np.zeros(13)), kf.Scalar("T", 1.0)])
    result = kf.calibrate(text, data, start, target="wanted", smoothness={"C": "auto"})
    assert result.smoothness["C"]["x"] > 0
    assert result.parameters["T"].value == pytest.approx(2.0, abs=0.2)
    assert result.parameters["C"].values == pytest.approx(truth["C"].values, abs=0.2)


def drives(count, seed=0, resembling=0.3, samples=600):
    """Recordings whose errors last for seconds and are others in each."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        x = 3 + 2.9 * np.sin(np.cumsum(rng.normal(0, 0.15, samples)))
        error = np.zeros(samples)
        for k in range(1, samples):
            error[k] = 0.97 * error[k - 1] + rng.normal(0, resembling * np.sqrt(1 - 0.97**2))
        yield kf.Dataset.of(f"drive {i}", {"x": x, "wanted": np.sin(x) + error}, time=0.1 * np.arange(samples))


@pytest.mark.slow
def test_stretches_are_held_out_if_errors_persist_and_the_result_says_so():
    lasting = fitted(list(drives(2, samples=200)), start=curve(9))
    assert "by 20 held-out blocks of the recordings: the factors with the least predicted" in lasting.message
    quick = kf.Dataset.of("d", noisy(600, 0.2), time=0.1 * np.arange(600))
    for result in (fitted(quick), fitted(noisy(150, 0.1))):
        assert (
            "Smoothness was chosen by generalised cross-validation: the factors with the least predicted"
            in result.message
        )


@pytest.mark.slow
def test_persistent_errors_are_not_fitted():
    """On data with such errors, the choice is about as good as the best fixed factor, and far smoother than most."""
    ratios = []
    for seed in range(4):
        data = list(drives(4, seed))
        best = min(fitted(data, factor).quality[-1].rmse_after for factor in FACTORS)
        result = fitted(data)
        assert result.smoothness["C"]["x"] > 1e3
        ratios.append((result.quality[-1].rmse_after ** 2 + 0.3**2) / (best**2 + 0.3**2))
    assert np.mean(ratios) <= 1.2


def levels(count, seed=0):
    """Recordings with a level of their own, as of a sensor that is mounted anew."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        x = 3 + 2.9 * np.sin(np.cumsum(rng.normal(0, 0.15, 400)))
        yield kf.Dataset.of(
            f"level {i}", {"x": x, "wanted": np.sin(3 * x) + rng.normal(0, 0.2)}, time=0.1 * np.arange(400)
        )


@pytest.mark.parametrize("seeds", [1, pytest.param(4, marks=pytest.mark.slow)])
def test_blocks_decide_alone_if_errors_persist_as_long_as_recordings(seeds):
    """Hardly a sample is independent of the others, too few for generalised cross-validation of 25 values."""
    factors = (*FACTORS[::3], "auto")
    errors = np.zeros(len(factors))
    for seed in range(1, 1 + seeds):
        data = list(levels(4, seed))
        results = [fitted(data, factor, function=lambda x: np.sin(3 * x)) for factor in factors]
        errors += [result.quality[-1].rmse_after ** 2 for result in results]
        assert "Smoothness was chosen by 20 held-out blocks of the recordings" in results[-1].message
    assert errors[-1] <= 1.05**2 * errors[:-1].min()


def few(samples, scalars, seed=9):
    """A straight line under noise on few points, beside scalars that take most of them."""
    rng = np.random.default_rng(seed)
    x, others = rng.uniform(0, 6, samples), rng.normal(size=(scalars, samples))
    names = [f"z{i}" for i in range(scalars)]
    data = {"x": x, "wanted": x + 0.3 * rng.normal(size=samples)} | dict(zip(names, others, strict=True))
    formula = " + ".join(["y = C(x)", *(f"a{name} * {name}" for name in names)])
    start = kf.ParameterSet(
        [kf.Curve("C", np.linspace(0, 6, 9), np.zeros(9)), *(kf.Scalar(f"a{z}", 0.0) for z in names)]
    )
    return kf.calibrate(formula, data, start, target="wanted", smoothness={"C": "auto"})


def test_few_samples_with_many_values_lead_to_larger_factors():
    """At equal weight of roughness and data no residual would be left to judge by."""
    assert np.abs(np.diff(few(9, 4).parameters["C"].values, 2)).max() < 0.01


def test_factors_that_no_sample_can_judge_are_reported():
    result = few(8, 7)
    assert "Smoothness could not be chosen, because too few samples are independent" in result.message


@pytest.mark.parametrize("count", [1, 2])
def test_factors_that_no_sample_can_judge_leave_the_fit_at_equal_weight(count):
    """A single point moved a map to values 40 times its own, through a corner of its cell that it hardly sees."""
    rng, axis = np.random.default_rng(0), np.linspace(0.0, 8.0, 9)
    x, y = rng.uniform(0, 8, (2, count))
    data = {"x": x, "y": y, "t": 5 + 2 * x - y + 0.3 * x * y}
    values = []
    for smoothness in ("auto", 1.0):
        start = kf.ParameterSet([kf.Map("M", axis, axis, np.zeros((9, 9)))])
        result = kf.calibrate("z = M(x, y)", data, start, target="t", node="z", smoothness=smoothness)
        values.append(result.parameters["M"].values)
    assert np.abs(values[0] - values[1]).max() < 0.3 * np.abs(values[1]).max()


def test_a_table_that_matters_only_after_others_is_smoothed():
    """Behind a map of zeros a time constant has no effect, so it has no derivative at the start."""
    rng = np.random.default_rng(2)
    time = np.arange(2000) * 0.1
    load = 3 + 2.9 * np.sin(np.cumsum(rng.normal(0, 0.3, time.size)))
    points = np.linspace(0, 6, 9)
    truth = kf.ParameterSet([kf.Curve("C", points, np.cos(points)), kf.Curve("T", points, 1 + points / 6)])
    text = "y = PT1(C(load), T(load))"
    data = kf.Dataset.of("drive", {"load": load}, time=time)
    clean = kf.simulate(text, data, truth)["y"].values
    data = data.with_channels(kf.Channel("wanted", clean + 0.2 * rng.normal(size=time.size)))
    start = kf.ParameterSet([truth["C"].with_values(np.zeros(9)), truth["T"].with_values(np.full(9, 2.0))])
    result = kf.calibrate(text, data, start, target="wanted", smoothness="auto", bounds={"T": (0.05, 20.0)})
    assert result.smoothness["T"]["x"] > 0
    assert result.parameters["T"].values == pytest.approx(truth["T"].values, abs=0.3)


def test_stopping_keeps_the_best_values_so_far():
    def stop(line):
        raise kf.Stop

    result = fitted(noisy(100, 0.1), progress=stop)
    assert result.status == "stopped"
    assert result.cost_after < result.cost_before


def test_several_starts_share_the_factors_and_their_times_add_up():
    result = fitted(noisy(100, 0.1), options=kf.Options(starts=3, workers=1))
    spent = result.seconds
    assert len(result.starts) == 3
    assert result.smoothness["C"]["x"] > 0
    assert spent.total == pytest.approx(spent.read + spent.compile + spent.optimize)
    assert spent.optimize > 0
    assert {line.stage for line in result.trace} >= {"smoothness 1", "plain"}


def test_a_sequence_uses_the_factors_in_every_step():
    steps = [kf.Step(name="coarse", grid_reduction=2), kf.Step(name="fine")]
    result = fitted(noisy(150, 0.1), options=kf.Options(steps=steps))
    assert result.status == "converged"
    assert result.quality[1].rmse_after < 0.1
    assert result.smoothness["C"]["x"] > 0


def stepwise(*steps, seed=0, smoothness=0.0, **options):
    return fitted(noisy(150, 0.1, seed), smoothness, options=kf.Options(steps=steps, **options))


def test_a_step_may_choose_its_factors():
    whole = fitted(noisy(150, 0.1))
    single = stepwise(kf.Step(smoothness="auto"))
    assert single.status == "converged"
    assert single.smoothness["C"]["x"] == pytest.approx(whole.smoothness["C"]["x"], rel=0.1)
    assert single.parameters["C"].values == pytest.approx(whole.parameters["C"].values, abs=0.02)
    assert any("step 1: smoothness 1" in line.stage for line in single.trace)


@pytest.mark.slow
def test_a_factor_chosen_on_a_coarse_grid_is_reported_for_the_full_one():
    """The same surface has the same penalty, so that the factors of both grids compare."""
    coarse = stepwise(kf.Step(grid_reduction=2, smoothness="auto"))
    fine = stepwise(kf.Step(smoothness="auto"))
    ratio = coarse.smoothness["C"]["x"] / fine.smoothness["C"]["x"]
    assert 1 / 3 < ratio < 3  # on the coarse grid itself it would be 1/15


@pytest.mark.slow
def test_a_step_on_the_full_grid_chooses_like_the_first_one():
    fine = stepwise(kf.Step(smoothness="auto"))
    again = stepwise(kf.Step(grid_reduction=2, smoothness="auto"), kf.Step(smoothness={"C": "auto"}))
    assert again.smoothness["C"]["x"] == pytest.approx(fine.smoothness["C"]["x"], rel=0.2)
    assert again.quality[1].rmse_after < 1.1 * fine.quality[1].rmse_after


def test_a_step_does_not_pass_its_factors_to_the_next():
    """The next step smooths by what the problem says, here not at all."""
    two = stepwise(kf.Step(smoothness="auto"), kf.Step())
    plain = fitted(noisy(150, 0.1), 0.0)
    assert two.parameters["C"].values == pytest.approx(plain.parameters["C"].values, abs=1e-4)


def test_a_step_with_a_stated_factor_makes_no_choice():
    result = fitted(noisy(150, 0.1), options=kf.Options(steps=[kf.Step(smoothness=5.0)]))
    five = fitted(noisy(150, 0.1), 5.0)
    assert result.parameters["C"].values == pytest.approx(five.parameters["C"].values, abs=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("workers", mostly_slow([1, 2], 1))
def test_every_start_makes_its_own_reproducible_choice(workers):
    first, second = (
        stepwise(kf.Step(smoothness="auto"), workers=number, starts=2, spread=2.0) for number in (1, workers)
    )
    assert first.smoothness == second.smoothness != {}
    assert np.array_equal(first.parameters["C"].values, second.parameters["C"].values)


def test_a_step_stopped_while_factors_are_chosen_keeps_its_best_values():
    def stop(line):
        raise kf.Stop

    data, steps = noisy(100, 0.1), [kf.Step(smoothness="auto")]
    result = fitted(data, 0.0, options=kf.Options(steps=steps), progress=stop)
    assert result.status == "stopped"
    assert result.cost_after < result.cost_before


@pytest.mark.parametrize("factor", ["automatic", -1.0, {"C": "many"}, {"C": (1.0, -2.0)}, float("nan"), True])
def test_an_invalid_factor_of_a_step_is_refused(factor):
    with pytest.raises(ArgumentError, match="smoothness of a step must be >= 0"):
        kf.Step(smoothness=factor)


def test_limits_of_outputs_hold_while_factors_are_chosen():
    data = noisy(200, 0.1, function=lambda x: np.sqrt(x))
    rising = kf.calibrate("y = C(x)", data, curve(), target="wanted", smoothness="auto", limits={"y": (-9.0, 2.0)})
    values = rising.parameters["C"].values
    assert np.interp(data["x"], np.linspace(0, 6, 25), values).max() <= 2.0 + 1e-6
    assert rising.smoothness["C"]["x"] > 0


@pytest.mark.slow
def test_the_same_choice_comes_from_the_same_data():
    data = noisy(100, 0.1)
    assert fitted(data).smoothness == fitted(data).smoothness


@pytest.mark.parametrize("factor", ["automatic", {"C": ("auto", 1.0)}, {"C": -1.0}, {"C": "many"}, {"C": None}])
def test_an_invalid_factor_is_refused(factor):
    with pytest.raises(ArgumentError, match=r'must be >= 0 or "auto", or one such value for each of its 1 axes'):
        fitted(noisy(10, 0.1), factor)
