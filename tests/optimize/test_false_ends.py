"""Starts far from the truth from which a descent used to stop, and call it converged."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.criteria import ROBUST_LOSSES
from tests.draws import mostly_slow

X = np.linspace(0, 10, 100)
POWERS, SPEEDS, KELVIN, VOLTS = (
    np.linspace(1, 50, 100),
    np.linspace(800, 6500, 100),
    np.linspace(250, 400, 100),
    np.linspace(0, 0.8, 60),
)

EXACT = {
    "exponential": ("y = a*exp(b*x)", X, 2 * np.exp(0.3 * X), {"a": 1.0, "b": 2.0}, {"a": 2.0, "b": 0.3}),
    "power": ("y = a*x^n", POWERS, 3 * POWERS**0.7, {"a": 1.0, "n": 8.0}, {"a": 3.0, "n": 0.7}),
    "friction": (
        "y = a + b*x^n",
        SPEEDS,
        5 + 1e-5 * SPEEDS**1.9,
        {"a": 1.0, "b": 1.0, "n": 3.0},
        {"a": 5.0, "b": 1e-5, "n": 1.9},
    ),
    "NTC": (
        "y = R*exp(B*(1/x - 1/298.15))",
        KELVIN,
        1e4 * np.exp(3500 * (1 / KELVIN - 1 / 298.15)),
        {"R": 1.0, "B": 30000.0},
        {"R": 1e4, "B": 3500.0},
    ),
    "diode": (
        "y = I*(exp(x/n) - 1)",
        VOLTS,
        1e-9 * (np.exp(VOLTS / 0.04) - 1),
        {"I": 1e-7, "n": 0.02},
        {"I": 1e-9, "n": 0.04},
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", mostly_slow(EXACT, ["power"]))
def test_a_long_step_that_shrinks_all_columns_does_not_stop_the_search(case):
    formula, x, y, start, truth = EXACT[case]
    result = kf.calibrate(formula, {"x": x, "m": y}, start, target="m")
    assert result.converged
    assert {name: result.parameters[name].value for name in truth} == pytest.approx(truth, rel=1e-6)


def test_a_value_that_moved_to_where_it_has_no_effect_is_searched_again_from_its_start():
    y = 17 * np.exp(-0.87 * X) + 9
    result = kf.calibrate("y = a*exp(b*x) + c", {"x": X, "m": y}, {"a": 57.0, "b": -69.0, "c": 75.0}, target="m")
    assert result.converged
    assert result.parameters["b"].value == pytest.approx(-0.87, rel=1e-6)


def test_a_column_that_shrinks_alone_leaves_the_other_values_their_steps():
    # from this start, the first step saturates the exponential: its rate hardly matters until the curve is right
    random = np.random.default_rng(3)
    n, z = random.uniform(0, 7, 400), random.uniform(0, 5, 400)
    truth = np.array([22.0, 114.0, 35.0, 76.0, 80.0, 99.0, 202.0, 125.0])
    target = np.interp(n, np.arange(8), truth) * (1 - np.exp(-2.5 * z))
    start = kf.ParameterSet(
        [kf.Curve("C", np.arange(8.0), [0.9, 21.0, 1.3, 4.0, 149.0, 8.4, 45.0, 8290.0]), kf.Scalar("k", 80.0)]
    )
    result = kf.calibrate("y = C(n)*(1 - exp(-k*z))", {"n": n, "z": z, "m": target}, start, target="m")
    assert result.converged
    np.testing.assert_allclose(result.parameters["C"].values, truth, rtol=1e-6)


def test_an_end_worse_than_the_mean_has_a_warning_with_a_remedy():
    kelvin = np.linspace(400, 900, 100)
    target = 2.4e5 * np.exp(-68_000 / (8.314 * kelvin))
    start = {"A": 1.2e6, "E": 2.7e6}  # the output underflows
    result = kf.calibrate("y = A*exp(-E/(8.314*T))", {"T": kelvin, "m": target}, start, target="m")
    assert result.quality[0].r2_after < 0
    messages = [f"{warning} {warning.remedy}" for warning in result.warnings]
    assert result.status != "converged" or any("worse than by the mean" in m and "starts = 10" in m for m in messages)


@pytest.mark.parametrize("loss", ROBUST_LOSSES)
def test_a_robust_fit_beside_outliers_names_them_before_other_starts(loss):
    x = np.linspace(0, 1, 60)
    target = np.where(np.arange(60) % 9 == 0, 40.0, 0.1 * x)
    criterion = kf.Criterion("y", "m", loss=loss, delta=0.01)
    result = kf.calibrate("y = a * x", {"x": x, "m": target}, {"a": 0.0}, criteria=[criterion])
    (warning,) = (each for each in result.warnings if "worse than by the mean" in each.message)
    assert warning.remedy.startswith("If the largest errors are outliers")


def test_a_poor_end_that_limits_enforce_names_them():
    start = kf.ParameterSet([kf.Curve("C", [0.0, 1.0, 2.0], [0.0, 0.0, 0.0])])
    data = {"x": [0.0, 1.0, 2.0, 2.0], "m": [1.0, 2.0, 3.0, 3.1]}
    total = kf.Equality([kf.Term("C")], 4.5)
    result = kf.calibrate("y = C(x)", data, start, target="m", bounds={"C": (0.0, 1.5)}, constraints=[total])
    (warning,) = result.warnings
    assert "worse than by the mean" in warning.message
    assert warning.remedy == "Bounds, pins and limits hold all values where they are: check them."


def test_a_poor_end_that_limits_of_outputs_enforce_names_them():
    data = {"x": X, "m": 3 + 2 * X}
    options = {"target": "m", "limits": [kf.Limit("y", upper=5.0)]}
    result = kf.calibrate("y = a + b*x", data, {"a": 0.0, "b": 0.0}, **options)
    [warning] = result.warnings
    assert "worse than by the mean" in warning.message
    assert warning.remedy == "Limits of outputs are reached there: check them."


def test_a_minimum_has_a_certificate_and_other_values_have_none():
    random = np.random.default_rng(0)
    y = 2 * np.exp(0.3 * X) + random.normal(0, 0.1, X.size)
    data, formula = {"x": X, "m": y}, "y = a*exp(b*x)"
    result = kf.calibrate(formula, data, {"a": 1.0, "b": 0.1}, target="m")
    a, b = (result.parameters[name].value for name in "ab")
    error = a * np.exp(b * X) - y
    slopes = np.stack([np.exp(b * X), a * X * np.exp(b * X)], axis=1)
    cosines = np.abs(slopes.T @ error) / np.linalg.norm(slopes, axis=0) / np.linalg.norm(error)
    assert cosines.max() < 1e-6
    assert result.certificate.gradient < 1e-6
    assert result.certificate.predicted_decrease < 1e-8
    early = kf.calibrate(formula, data, {"a": 1.0, "b": 0.1}, target="m", options=kf.Options(max_iterations=1))
    assert early.status == "max_iterations"
    assert early.certificate.predicted_decrease > 0.1
    assert early.as_json()["certificate"]["gradient"] == early.certificate.gradient


def test_a_bound_that_holds_a_value_belongs_to_the_minimum():
    start = kf.ParameterSet([kf.Scalar("a", 1.0, lower=0.0, upper=1.5), kf.Scalar("b", 0.0)])
    result = kf.calibrate("y = a*x + b", {"x": X, "m": 2 * X + 1}, start, target="m")
    assert result.parameters["a"].value == 1.5
    assert result.certificate.gradient < 1e-8
    assert result.certificate.limits == 0.0


# the least costs are those of scipy's L-BFGS-B and of IPOPT
def fuel_problem(samples, speeds, loads):
    t = np.arange(float(samples))
    data = {"time": t, "n": 2500 + 1500 * np.sin(t / 37), "L": 50 + 40 * np.sin(t / 11)}
    axes = np.linspace(1000, 4000, speeds), np.linspace(10, 90, loads)
    shape = speeds, loads
    maps = [
        kf.Map("Spark", *axes, np.full(shape, 20.0), lower=0.0, upper=45.0),
        kf.Map("Egr", *axes, np.full(shape, 5.0), lower=0.0, upper=25.0),
    ]
    return data, kf.ParameterSet(maps)


FUEL = """
sp = Spark(n, L)
eg = Egr(n, L)
opt = 30 - 0.18*L + 0.003*n + 0.4*eg
fuel = (0.4 + 1.2e-5*n*L)*(1 + 6e-4*(opt - sp)^2 + 2e-4*eg^2)
root = sqrt(fuel)
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("samples", "speeds", "loads", "least"),
    [(300, 4, 3, 634.717), pytest.param(1800, 12, 10, 3464.03, marks=pytest.mark.slow)],
)
def test_the_least_fuel_of_a_cycle_without_noise_is_found(samples, speeds, loads, least):
    data, start = fuel_problem(samples, speeds, loads)
    result = kf.calibrate(FUEL, data, start, node="root", target=0.0)
    assert result.converged
    assert result.cost_after < least
    limited = kf.calibrate(FUEL, data, start, node="root", target=0.0, limits=[kf.Limit("sp", upper=100.0)])
    assert result.cost_after <= limited.cost_after * (1 + 1e-6)


def test_a_sequence_that_ends_on_a_coarse_grid_states_the_gain_of_the_full_one():
    random = np.random.default_rng(0)
    z = random.uniform(0, 10, 300)
    curve = kf.Curve("C", np.linspace(0, 10, 11), np.zeros(11))
    data = {"z": z, "m": np.sin(z) + random.normal(0, 0.1, z.size)}
    coarse = kf.Options(steps=(kf.Step(grid_reduction=2),))
    [warning] = kf.calibrate("y = C(z)", data, kf.ParameterSet([curve]), target="m", options=coarse).warnings
    assert "the last step of the sequence keeps some of them, or removes breakpoints" in warning.message
    optimum = kf.calibrate("y = C(z)", data, kf.ParameterSet([curve]), target="m", smoothness=0.01).parameters
    [warning] = kf.calibrate("y = C(z)", data, optimum, target="m", smoothness=0.01, options=coarse).warnings
    assert "The last step of the sequence keeps some values, or removes breakpoints: the RMSE of y" in warning.message
    assert "End the sequence with a step" in warning.remedy


@pytest.mark.slow
def test_two_terms_that_became_alike_separate_again():
    x = np.linspace(0, 10, 300)
    truth = {"a": 3.0, "b": 1.5, "c": 2.0, "d": 0.2}
    y = 3 * np.exp(-1.5 * x) + 2 * np.exp(-0.2 * x) + 0.01 * np.sin(37 * x)
    start = {"a": 0.5, "b": 5.0, "c": 7.7, "d": 0.6}
    result = kf.calibrate("y = a*exp(-b*x) + c*exp(-d*x)", {"x": x, "m": y}, start, target="m")
    assert result.converged
    assert {name: result.parameters[name].value for name in truth} == pytest.approx(truth, rel=2e-3)


@pytest.mark.parametrize("last", [10.1, 10.4, 10.7, 11.0])
def test_an_exact_fit_on_a_ridge_stays_near_the_start(last):
    x = np.linspace(0, last, 60)
    points = [0.0, 5.0, last]
    data = {"x": x, "q": np.interp(x, points, [1, 3, 4])}
    start = kf.ParameterSet([kf.Curve("C", points, [1.0, 1.0, 1.0]), kf.Scalar("k", 1.0)])
    rising = [kf.Shape("C", 0, "slope", lower=0.0)]
    result = kf.calibrate("y = C(x) + k*x", data, start, target="q", constraints=rising)
    # from k = 1 down to the first k with which C does not fall; any lower one is as exact
    assert result.parameters["k"].value == pytest.approx(1 / (last - 5))


def test_a_value_whose_slope_vanishes_at_the_minimum_has_converged():
    result = kf.calibrate("y = b + a^2*x", {"x": X, "m": 3 - 0.5 * X}, {"a": 1.0, "b": 0.0}, target="m")
    assert result.converged
    assert result.parameters["a"].value == pytest.approx(0.0, abs=1e-3)
    assert result.parameters["b"].value == pytest.approx(0.5)
    assert not result.warnings


def test_targets_used_as_upper_limits_need_not_be_reached():
    criteria = [kf.Criterion("y", "m", loss="excess")]
    result = kf.calibrate("y = a + b*x", {"x": X, "m": 3 + X}, {"a": 0.0, "b": 0.0}, criteria=criteria)
    assert result.converged
    assert result.cost_after == 0.0
    assert not result.warnings


@pytest.mark.slow
def test_an_end_at_the_mean_has_no_warning():
    for seed in range(8):
        m = 5 + np.random.default_rng(seed).normal(size=50)
        assert not kf.calibrate("y = c + 0*x", {"x": np.arange(50.0), "m": m}, {"c": 0.0}, target="m").warnings


def test_an_output_that_became_a_constant_has_a_warning():
    """The bell runs away to where the data see its offset alone."""
    x = np.linspace(0.2, 8, 60)
    data = {"x": x, "q": 3 * np.exp(-(((x - 4) / 1.2) ** 2)) + 1}
    start = {"h": 1.0, "m": -5.0, "s": 1.0, "c": 0.0}
    result = kf.calibrate("y = h*exp(-((x - m)/s)^2) + c", data, start, target="q")
    assert any("no better than by the mean of its target" in warning.message for warning in result.warnings)
