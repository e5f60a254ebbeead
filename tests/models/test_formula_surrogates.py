"""Data-driven models called in formula text, against their own recursion."""

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.domain.rbf import Expansion
from kennfeld.models.formula import formula
from kennfeld.surrogate import DynamicSurrogate, StaticSurrogate


def expansion(inputs, size=12, seed=0):
    rng = np.random.default_rng(seed)
    slopes = rng.uniform(-0.3, 0.4, inputs)
    return Expansion(0.1, slopes, 0.1 * rng.normal(size=size), rng.normal(size=(size, inputs)), np.ones((size, inputs)))


def engine(lags=((0, 2), (1, 3)), output_lags=(1, 2), limits=(-1.0, 0.9)):
    size = len(output_lags) + sum(map(len, lags))
    attributes = {"start": 0.3, "start_inputs": (0.1, 0.2), "limits": limits}
    return DynamicSurrogate("engine", ("a", "b"), lags, "n", output_lags, 0.02, expansion(size), **attributes)


def recording(count=300, seed=1):
    u = np.random.default_rng(seed).normal(size=(count, 2))
    return u, kf.Dataset.of("d", {"a": u[:, 0], "b": u[:, 1]}, time=0.02 * np.arange(count))


@pytest.mark.parametrize("limits", [(-1.0, 0.9), (-np.inf, np.inf)])
def test_a_dynamic_one_runs_as_its_own_simulation(limits):
    surrogate = engine(limits=limits)
    u, data = recording()
    model = formula("n = engine(a, b)", surrogates=[surrogate])
    np.testing.assert_allclose(kf.simulate(model, data, {})["n"].values, surrogate.simulate(u), rtol=0, atol=1e-12)


def test_init_replaces_the_output_before_the_first_sample():
    surrogate = engine()
    u, data = recording()
    model = formula("n = engine(a, b, 0.7)", surrogates=[surrogate])
    expected = surrogate.simulate(np.concatenate([u[:1], u]), [0.7])[1:]
    np.testing.assert_allclose(kf.simulate(model, data, {})["n"].values, expected, rtol=0, atol=1e-12)


def test_a_static_one_is_its_expansion():
    surrogate = StaticSurrogate("F", ("x", "z"), "y", (), expansion(2))
    x = np.random.default_rng(3).normal(size=(50, 2))
    model = formula("y = 2 * F(x, z)", surrogates=[surrogate])
    got = kf.simulate(model, {"x": x[:, 0], "z": x[:, 1]}, {})["y"].values
    np.testing.assert_allclose(got, 2 * surrogate(x), rtol=1e-13)


LOOP = """
n = engine(a, thr)
miss = ref - n
x = integrator(kI * miss, 0)
thr = kp * miss + x
scalar kp
scalar kI
"""


def test_a_loop_closes_through_an_input_that_acts_later_only():
    surrogate = engine()
    u, _ = recording()
    ref = np.where(np.arange(len(u)) > 100, 0.5, 0.2)
    data = kf.Dataset.of("d", {"a": u[:, 0], "ref": ref}, time=0.02 * np.arange(len(u)))
    got = kf.simulate(formula(LOOP, surrogates=[surrogate]), data, {"kp": 0.4, "kI": 1.0})["n"].values
    expected = closed_loop(surrogate, u[:, 0], ref, 0.4, 1.0)
    np.testing.assert_allclose(got, expected, rtol=0, atol=1e-10)


def closed_loop(surrogate, a, ref, kp, ki):
    """The same in plain Python: b before the first sample is the start of the surrogate, a its own first value."""
    n, b, x = [], [], 0.0
    for k in range(len(a)):
        past = [n[k - lag] if k >= lag else surrogate.start for lag in surrogate.output_lags]
        first = [a[max(k - lag, 0)] for lag in surrogate.lags[0]]
        second = [b[k - lag] if k >= lag else surrogate.start_inputs[1] for lag in surrogate.lags[1]]
        n.append(float(np.clip(surrogate.expansion(np.array([*past, *first, *second])), *surrogate.limits)))
        b.append(kp * (ref[k] - n[k]) + x)
        x += 0.02 * ki * (ref[k] - n[k])
    return n


def test_the_gains_of_a_loop_are_calibrated_and_the_plant_stays():
    surrogate = engine(limits=(-np.inf, np.inf))
    u, _ = recording()
    ref = np.where(np.arange(len(u)) > 100, 0.5, 0.2)
    data = kf.Dataset.of("d", {"a": u[:, 0], "ref": ref}, time=0.02 * np.arange(len(u)))
    model = formula(LOOP, surrogates=[surrogate])
    result = kf.calibrate(model, data, {"kp": 0.0, "kI": 0.0}, target="ref", node="n")
    assert result.status == "converged"
    assert result.quality[0].rmse_after < 0.9 * result.quality[0].rmse_before
    assert result.parameters["engine"].expansion == surrogate.expansion


def test_an_algebraic_loop_through_a_present_input_is_named():
    with pytest.raises(InputError, match="algebraic loop: n -> "):
        formula(LOOP, surrogates=[engine(lags=((0,), (0, 1)))])


def test_a_wrong_number_of_arguments_is_answered_with_the_signature():
    with pytest.raises(InputError, match=r"Write engine\(a, b, init=0\.3\)"):
        formula("n = engine(a)", surrogates=[engine()])


def test_the_text_of_such_a_graph_reads_back():
    from kennfeld.models.formula import to_text

    graph = formula(LOOP, surrogates=[engine()]).graph
    assert formula(to_text(graph)).graph == graph


def test_the_step_of_the_data_must_be_its_own():
    model = formula("n = engine(a, b)", surrogates=[engine()])
    u, _ = recording(20)
    columns = {"a": u[:, 0], "b": u[:, 1]}
    with pytest.raises(InputError, match=r"engine was trained at steps of 0\.02 s, and dataset d has one of 0\.1 s"):
        kf.simulate(model, kf.Dataset.of("d", columns, time=0.1 * np.arange(20)), {})
    with pytest.raises(InputError, match="engine runs in time, but dataset d has no time stamps"):
        kf.simulate(model, kf.Dataset.of("d", columns), {})
    pieces = kf.Dataset.of("d", columns, time=[0.02 * k + (k >= 10) for k in range(20)], piece_starts=[0, 10])
    assert kf.simulate(model, pieces, {})["n"].values.size == 20


@pytest.mark.parametrize("text", ["y = F(x, z) + k", "y = k * F(x, z)", "y = k * prev(F(x, z), 0)"])
def test_one_that_depends_on_the_data_alone_is_computed_before_the_fit(text):
    surrogate = StaticSurrogate("F", ("x", "z"), "y", (), expansion(2))
    x = np.random.default_rng(3).normal(size=(50, 2))
    model = formula(f"{text}\nscalar k", surrogates=[surrogate])
    data = kf.Dataset.of("d", {"x": x[:, 0], "z": x[:, 1]}, time=np.arange(50.0))
    wanted = kf.simulate(model, data, {"k": 1.7})["y"].values
    result = kf.calibrate(model, {"x": x[:, 0], "z": x[:, 1], "m": wanted}, {"k": 0.5}, target="m", node="y")
    assert float(result.parameters["k"].values) == pytest.approx(1.7)


def test_settled_points_run_at_the_step_of_the_training():
    half = Expansion(0.0, [0.5, 0.25], [], np.zeros((0, 2)), np.zeros((0, 2)))
    lag = DynamicSurrogate("lag", ("u",), ((1,),), "y", (1,), 0.1, half)
    model = formula("y = lag(u)", surrogates=[lag])
    points = {"u": np.array([1.0, 2.0, 5.0])}
    settled = kf.simulate(model, kf.Dataset.of("points", points, settling=kf.Settling(60.0, step=0.1)), {})
    np.testing.assert_allclose(settled["y"].values, 0.5 * points["u"])
    other = kf.Dataset.of("points", points, settling=kf.Settling(60.0, step=0.2))
    with pytest.raises(
        InputError, match=r"lag was trained at steps of 0\.1 s, and dataset points has one of 0\.2 s\. Write step"
    ):
        kf.simulate(model, other, {})
