"""Covariances against repeated measurements, and what they are made of."""

import numpy as np
import pytest
from hypothesis import strategies as st

import kennfeld as kf
from kennfeld.optimize import Problem, run
from tests.draws import few_or_many, mostly_slow
from tests.optimize.repetitions import agree, counts, repeated

NOISE = 0.5
GRID, LINE = np.arange(6.0), np.arange(10.0)
SURFACE = 10 + 2 * GRID[:, None] + 2 * np.sin(GRID) + 0.3 * np.outer(GRID, GRID)
FALL = 1 - 0.01 * LINE**1.5
TEXT = "m = M(x, y) * C(z) + K * sin(z)"


def product(*, count=400, map_bounds=(-np.inf, np.inf), locked=False, curve_upper=np.inf, **arguments):
    """A map times a curve and a scalar, 47 values, about 9 samples for each; and the truth."""
    rng = np.random.default_rng(0)
    x, y, z = rng.uniform(0, 1, (3, count)) * np.array([[5.0], [5.0], [9.0]])
    truth = kf.ParameterSet(
        [
            kf.Map("M", GRID, GRID, SURFACE, lower=map_bounds[0], upper=map_bounds[1], locked=locked),
            kf.Curve("C", LINE, FALL, upper=curve_upper),
            kf.Scalar("K", 3.0),
        ]
    )
    clean = kf.simulate(TEXT, {"x": x, "y": y, "z": z}, truth)["m"].values
    data = kf.Dataset.of("d", {"x": x, "y": y, "z": z, "t": clean + rng.normal(0, NOISE, count)})
    model = kf.formula(TEXT, parameters=list(truth))
    return Problem(model, (data,), truth, (kf.Criterion("m", "t"),), **arguments), truth


def draw(rng, count):
    return rng.normal(0, NOISE, (1, count))


BOUND = np.where(np.arange(10) == 5, FALL - 0.07, np.inf)  # presses only if the scale of the curve is known
CASES = {
    "pinned between grid points": {"pins": (kf.Pin("C", (0.4,), 0.99), kf.Pin("M", (2.5, 1.5), 19.0))},
    "at a bound": {"curve_upper": BOUND, "pins": (kf.Pin("C", (0.4,), 0.99),)},
    "partly locked": {"locked": np.add.outer(GRID, GRID) < 3},
    "smooth at a bound": {"curve_upper": BOUND, "smoothness": {"M": (0.5, 0.5), "C": (20.0,)}},
}


@pytest.mark.slow
@counts
@pytest.mark.parametrize("name", mostly_slow(CASES, ["smooth at a bound"]))
def test_values_scatter_over_repeated_measurements_as_predicted(name, count):
    case = CASES[name]
    problem, truth = product(**case)
    trust = run(problem, kf.Options()).trust
    ends = repeated(problem, truth, draw, count)
    assert agree(trust.covariance(scatter=True), ends) >= 35
    if "smoothness" not in case:
        assert trust.covariance() == pytest.approx(trust.covariance(scatter=True), rel=1e-6, abs=1e-12)


@counts
def test_values_before_a_state_scatter_as_predicted(count):
    rng = np.random.default_rng(1)
    time = np.arange(3000) * 0.1
    u, load = np.repeat(rng.uniform(0, 10, 60), 50), np.repeat(rng.uniform(0, 4, 30), 100)
    truth = kf.ParameterSet(
        [kf.Curve("G", np.arange(0, 11, 2.0), [1, 3, 4, 6, 9, 10.0]), kf.Curve("T", [0, 2, 4], [0.5, 1, 2.0])]
    )
    text = "m = PT1(G(u), T(load))"
    clean = kf.simulate(text, kf.Dataset.of("d", {"u": u, "load": load}, time=time), truth)["m"].values
    data = kf.Dataset.of("d", {"u": u, "load": load, "t": clean + rng.normal(0, NOISE, u.size)}, time=time)
    problem = Problem(kf.formula(text, parameters=list(truth)), (data,), truth, (kf.Criterion("m", "t"),))
    trust = run(problem, kf.Options()).trust
    assert trust.noise["m"] == pytest.approx(NOISE, rel=0.05)
    assert trust.persistence["m"] == pytest.approx(1.0, abs=0.25)
    assert agree(trust.covariance() / trust.persistence["m"], repeated(problem, truth, draw, count)) == 9


@pytest.mark.slow
def test_the_error_covers_the_truth_of_smoothed_values():
    """Nychka's promise: averaged over the grid points, two deviations cover the truth in 95 of 100 cases."""
    x = np.linspace(0, 10, 150)
    grid = np.linspace(0, 10, 41)
    truth = np.sin(grid) * 3
    covered, bare = [], []
    for seed in range(6):
        y = np.interp(x, grid, truth) + np.random.default_rng(seed).normal(0, 1.0, x.size)
        start = kf.ParameterSet([kf.Curve("C", grid, np.zeros(41))])
        result = kf.calibrate("m = C(x)", {"x": x, "y": y}, start, target="y", smoothness=1.0 * 41 / 0.03)
        off = np.abs(result.parameters["C"].values - truth)
        covered.append(off < 2 * result.trust.deviation["C"])
        bare.append(off < 2 * result.trust.scatter["C"])
    assert 0.90 < np.mean(covered) < 0.99
    assert np.mean(bare) < np.mean(covered)


def test_recordings_with_persistent_errors_determine_less():
    rng = np.random.default_rng(5)
    x = np.repeat(rng.uniform(0, 1, 100), 100)
    noise = np.zeros(x.size)
    for k in range(1, x.size):
        noise[k] = 0.9 * noise[k - 1] + rng.normal()
    columns = {"x": x, "y": x + noise}
    moving = kf.Dataset.of("d", columns, time=np.arange(x.size) * 0.1)
    lasting = kf.calibrate("m = a + b * x", moving, {"a": 0.0, "b": 0.0}, target="y").trust
    steady = kf.calibrate("m = a + b * x", columns, {"a": 0.0, "b": 0.0}, target="y").trust
    assert lasting.persistence["m"] == pytest.approx(19, rel=0.15)
    assert steady.persistence["m"] == 1.0
    assert lasting.deviation["b"] == pytest.approx(np.sqrt(lasting.persistence["m"]) * steady.deviation["b"])


@few_or_many(
    st.integers(0, 2**16), st.sampled_from([0.0, 1e-3, 1.0, 1e4]), st.sampled_from([None, 0.3]), few=3, many=12
)
def test_leverages_lie_between_0_and_1_and_sum_up_to_the_degrees_of_freedom(seed, smoothness, bound):
    rng = np.random.default_rng(seed)
    x = rng.uniform(0, rng.uniform(2, 9), 60)
    y = np.sin(x) + rng.normal(0, 0.1, 60)
    start = kf.ParameterSet([kf.Curve("C", np.arange(10.0), np.zeros(10)), kf.Scalar("k", 0.0)])
    bounds = None if bound is None else {"C": (-bound, bound)}
    fit = kf.calibrate(
        "m = C(x) + k * x^2", {"x": x, "y": y}, start, target="y", smoothness={"C": smoothness}, bounds=bounds
    )
    trust = fit.trust
    whole = np.concatenate([trust.leverage["C"], np.atleast_1d(trust.leverage["k"])])
    assert np.all((whole >= 0) & (whole <= 1))
    assert whole.sum() == pytest.approx(trust.freedom, abs=1e-6)
    assert np.all(trust.leverage["C"][trust.samples["C"] == 0] == 0)
    at_bound = np.abs(fit.parameters["C"].values) == bound
    assert np.all(trust.deviation["C"][at_bound] == 0)
    assert np.all(trust.scatter["C"] <= trust.deviation["C"] * (1 + 1e-6) + 1e-12)
    assert trust.freedom <= 11 + 1e-6


@pytest.mark.parametrize("unit", mostly_slow([1e-6, 1e6], 1))
def test_deviations_scale_with_their_units(unit):
    rng = np.random.default_rng(4)
    x, z = rng.uniform(0, 3, (2, 200))
    y = np.sin(x) * (1 + 0.1 * z) + rng.normal(0, 0.05, 200)

    def trust(scale):
        start = kf.ParameterSet(
            [kf.Curve("A", np.arange(4.0), np.ones(4) * scale), kf.Curve("B", np.arange(4.0), np.ones(4))]
        )
        pins = [kf.Pin("B", (0.0,), 1.0)]
        return kf.calibrate(
            f"m = A(x) / {scale!r} * B(z)", {"x": x, "z": z, "y": y}, start, target="y", pins=pins
        ).trust

    plain, scaled = trust(1.0), trust(unit)
    assert scaled.deviation["A"] == pytest.approx(unit * plain.deviation["A"], rel=1e-4)
    assert scaled.leverage["A"] == pytest.approx(plain.leverage["A"], rel=1e-4)
    assert [d.sentence for d in scaled.directions] == [d.sentence for d in plain.directions]
