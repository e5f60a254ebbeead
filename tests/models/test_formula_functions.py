"""Each built-in function against a recursion written by hand."""

import math
import re

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.graph.interpreter import evaluate
from kennfeld.models.formula import formula
from kennfeld.models.formula.functions import FUNCTIONS
from tests.clocks import even_clock

DT = np.array([0.1, 0.1, 0.1, 0.2, 0.2, 0.1, 0.05, 0.1, 0.1, 0.3])
U = np.array([1.5, -2.0, 0.25, 4.0, 4.0, -1.0, 0.0, 7.5, 3.0, -3.5])
V = np.array([0.5, 2.0, -1.25, 3.0, 4.0, 1.0, 0.0, -2.5, 6.0, 0.5])
NEXT_DT = np.append(DT[1:], DT[-1])
COLUMNS = {"u": U, "v": V, "dt": DT, "dt_next": NEXT_DT, "t": np.cumsum(DT) - DT[0]}


def run(text: str, starts: tuple[int, ...] = (0,), **scalars: float) -> np.ndarray:
    declared = "".join(f"\nscalar {name}" for name in scalars)
    graph = formula(f"y = {text}{declared}").graph
    parameters = ParameterSet([Scalar(name, value) for name, value in scalars.items()])
    return evaluate(graph, COLUMNS, parameters, starts)["y"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("abs(u)", np.abs(U)),
        ("sqrt(u)", np.sqrt(np.abs(U)) * np.where(U < 0, np.nan, 1)),
        ("exp(u)", np.exp(U)),
        ("log(abs(u) + 1)", np.log(np.abs(U) + 1)),
        ("log10(abs(u) + 1)", np.log10(np.abs(U) + 1)),
        ("sin(u)", np.sin(U)),
        ("cos(u)", np.cos(U)),
        ("tan(u)", np.tan(U)),
        ("asin(u / 10)", np.arcsin(U / 10)),
        ("acos(u / 10)", np.arccos(U / 10)),
        ("atan(u)", np.arctan(U)),
        ("atan2(u, v)", np.arctan2(U, V)),
        ("sinh(u)", np.sinh(U)),
        ("cosh(u)", np.cosh(U)),
        ("tanh(u)", np.tanh(U)),
        ("erf(u)", np.array([math.erf(u) for u in U])),
        ("erfc(u)", np.array([math.erfc(u) for u in U])),
        ("floor(u)", np.floor(U)),
        ("ceil(u)", np.ceil(U)),
        ("round(u)", np.array([2.0, -2.0, 0.0, 4.0, 4.0, -1.0, 0.0, 8.0, 3.0, -4.0])),
        ("sign(u)", np.sign(U)),
        ("single(u / 3)", (U / 3).astype(np.float32)),
        ("mod(u, 2)", U - np.floor(U / 2) * 2),
        ("min(u, v)", np.minimum(U, V)),
        ("max(u, v)", np.maximum(U, V)),
        ("min(u, v, 1, 0.5)", np.minimum(np.minimum(U, V), 0.5)),
        ("max(u, v, 1, 0.5)", np.maximum(np.maximum(U, V), 1)),
        ("clip(u, -1, v)", np.minimum(np.maximum(U, -1), V)),
        ("if(u > v, u, 2 * v)", np.where(U > V, U, 2 * V)),
        ("bswitch(u, 1, v)", np.where(U <= 0, 1, V)),
        ("u < v", U < V),
        ("u <= v", U <= V),
        ("u > v", U > V),
        ("u >= v", U >= V),
        ("u == v", U == V),
        ("u != v", U != V),
        ("u and v", (U != 0) & (V != 0)),
        ("u or v", (U != 0) | (V != 0)),
        ("not u", U == 0),
        ("t + dt", COLUMNS["t"] + DT),
        ("sampled(u)", U),
        ("u - inf", U - np.inf),
        ("u * nan", U * np.nan),
        ("u * pi", U * math.pi),
    ],
)
def test_functions_without_memory(text, expected):
    np.testing.assert_allclose(run(text), expected.astype(float), rtol=1e-15)


def recursion(start, output, following):
    """y[k] = output(state, k), state = following(state, y, k), from state = start(0)."""
    state, result = start(0), []
    for k in range(U.size):
        y = output(state, k)
        result.append(y)
        state = following(state, y, k)
    return np.array(result)


def pt1(T, init=None, x=U, share=lambda dt, T: dt / (T + dt)):
    def output(y, k):
        return y + share(DT[k], T(k)) * (x[k] - y)

    return recursion(lambda k: x[0] if init is None else init, output, lambda s, y, k: y)


def exact(dt, T):
    return -math.expm1(-dt / T) if T else 1.0


def lagged(x, steps, init):
    return np.concatenate([np.full(steps, init), x[:-steps]])


def limited(low, high, start=0.5):
    return recursion(lambda k: start, lambda s, k: s, lambda s, y, k: min(max(y + NEXT_DT[k] * U[k], low(k)), high(k)))


def rate(up, down):
    return recursion(
        lambda k: U[0],
        lambda y, k: y + min(max(U[k] - y, down * DT[k]), up * DT[k]),
        lambda s, y, k: y,
    )


def relay(on, off):
    return recursion(lambda k: 0.0, lambda y, k: 1.0 if U[k] >= on else 0.0 if U[k] <= off else y, lambda s, y, k: y)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("prev(u)", lagged(U, 1, 0.0)),
        ("prev(u, v + 1)", lagged(U, 1, V[0] + 1)),
        ("timeDelay(u, 3)", lagged(U, 1, 3.0)),
        ("delay(u, 1)", lagged(U, 1, 0.0)),
        ("delay(u, 4)", lagged(U, 4, 0.0)),
        ("delay(u, 8 / 2, v)", lagged(U, 4, V[0])),
        ("integrator(u)", np.concatenate([[0.0], np.cumsum(NEXT_DT * U)[:-1]])),
        ("integrator(u, 2)", 2 + np.concatenate([[0.0], np.cumsum(NEXT_DT * U)[:-1]])),
        ("integrator(u, 0.5, 0.4)", limited(lambda k: 0.4, lambda k: np.inf)),
        ("integrator(u, 0.5, 0.4, 1)", limited(lambda k: 0.4, lambda k: 1.0)),
        ("integrator(u, 0.5, -inf, 1)", limited(lambda k: -np.inf, lambda k: 1.0)),
        ("integrator(u, 9, -1, 1)", limited(lambda k: -1.0, lambda k: 1.0, 1.0)),
        ("integrator(u, -9, v - 2, v)", limited(lambda k: V[k] - 2, lambda k: V[k], V[0] - 2)),
        ("integrator(u, 0.5, v - 3, v)", limited(lambda k: V[k] - 3, lambda k: V[k])),
        ("integrator(u, 0, -inf, inf, v)", np.concatenate([[0.0], (V + NEXT_DT * U)[:-1]])),
        ("derivative(u)", np.diff(U, prepend=U[0]) / DT),
        ("PT1(u, 0.7)", pt1(lambda k: 0.7)),
        ("PT1(u, 0)", U),
        ("PT1(u, abs(v))", pt1(lambda k: abs(V[k]))),
        ("PT1(u, 0.7, 20)", pt1(lambda k: 0.7, 20.0)),
        ("PT1exact(u, 0.7)", pt1(lambda k: 0.7, share=exact)),
        ("PT1exact(u, 0)", U),
        ("PT1exact(u, abs(v), 20)", pt1(lambda k: abs(V[k]), 20.0, share=exact)),
        ("lowpass(u, 2)", pt1(lambda k: 1 / (2 * math.pi * 2))),
        ("ratelimit(u, 5, -8)", rate(5, -8)),
        ("hysteresis(u, 3.5, -2.5)", relay(3.5, -2.5)),
        ("hysteresis(u, 0.2, -1)", relay(0.2, -1)),
    ],
)
def test_functions_with_memory(text, expected):
    np.testing.assert_allclose(run(text), expected, rtol=1e-14, atol=1e-14)


def test_every_function_is_tested():
    tested = {
        text.partition("(")[0]
        for test in (test_functions_without_memory, test_functions_with_memory)
        for text, _ in test.pytestmark[0].args[1]
    }
    assert set(FUNCTIONS) <= tested


@pytest.mark.parametrize("text", ["PT1(u, T)", "PT1exact(u, T)", "lowpass(u, 1 / (2 * pi * T))"])
def test_a_negative_time_constant_gives_nan(text):
    assert np.isnan(run(text, T=-0.5)).all()
    assert np.isnan(run(text.replace("T)", "-0.5)"))).all()
    assert np.isfinite(run(text, T=0.5)).all()


def test_a_constant_time_constant_makes_the_same_as_a_parameter():
    np.testing.assert_array_equal(run("PT1(u, 0.3)"), run("PT1(u, T)", T=0.3))


@pytest.mark.parametrize("T", [0.0, 1e-300, 1e-5, 0.03, 1.0, 1e6])
def test_the_exact_share_of_a_lag_is_exact_to_rounding(T):
    expected = pt1(lambda k: T, 20.0, share=exact)
    np.testing.assert_allclose(run("PT1exact(u, T, 20)", T=T) - 20.0, expected - 20.0, rtol=1e-13)


def test_the_initial_value_of_a_lag_is_the_output_before_the_first_sample():
    data = {"time": [0.0, 1.0, 2.0], "x": [2.0, 2.0, 2.0]}
    assert kf.simulate("y = PT1(x, 1, 3)", data, {})["y"].values.tolist() == [2.5, 2.25, 2.125]
    assert kf.simulate("y = PT1(x, 1)", data, {})["y"].values.tolist() == [2.0, 2.0, 2.0]


@pytest.mark.parametrize("solver", ["", "solver ode4\n"])
@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("integrator(0 * u, a, -1, b)", -1.0),
        ("integrator(0 * u, 9, -inf, y + 1)", 9.0),  # a limit that depends on the state does not limit its start
        ("integrator(0 * u, 9, -inf, z)\nz = integrator(0 * u, 8, -inf, y)", 8.0),
    ],
)
def test_an_integrator_starts_within_its_limits(solver, text, expected):
    values = {"a": -9.0, "b": 2.0} if "a, -1" in text else {}
    data = {"time": [0.0, 1.0], "u": [1.0, 1.0]}
    assert kf.simulate(f"{solver}y = {text}", data, values)["y"].values.tolist() == [expected] * 2


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("integrator(u, 0, 3, 1)", "column 25: integrator requires lower <= upper, got lower = 3 and upper = 1"),
        ("clip(u, 3, 2 - 1)", "column 18: clip requires lower <= upper, got lower = 3 and upper = 1"),
        ("hysteresis(u, 1, 2)", "column 22: hysteresis requires off <= on, got off = 2 and on = 1"),
        ("ratelimit(u, -2, 3)", "column 22: ratelimit requires down <= up, got down = 3 and up = -2"),
    ],
)
@pytest.mark.parametrize("solver", ["", "solver ode2"])
def test_constants_in_the_wrong_order_are_reported(text, message, solver):
    with pytest.raises(kf.InputError, match=re.escape(message)):
        formula(f"y = {text}\n{solver}")


@pytest.mark.parametrize("text", ["integrator(u, 0, 2)", "hysteresis(u, 1, 1)", "clip(u, -inf, inf)", "clip(u, v, 0)"])
def test_arguments_in_order_are_accepted(text):
    formula(f"y = {text}")


@pytest.mark.parametrize("text", ["prev(u, v)", "delay(u, 3, v)", "integrator(u, v)", "PT1(u, 1)", "derivative(u)"])
def test_memory_starts_anew_at_each_piece(text):
    whole = run(text, starts=(0, 6))
    later = {name: column[6:] for name, column in COLUMNS.items()}
    alone = evaluate(formula(f"y = {text}").graph, later, ParameterSet())["y"]
    np.testing.assert_array_equal(whole[6:], alone)


def test_an_integrator_writes_only_the_limits_that_are_given():
    operations = [node.op for node in formula("y = integrator(u, 0, -inf, 3)").graph.nodes]
    assert "min" in operations
    assert "max" not in operations


def test_a_controller_closes_its_loop_through_memory():
    text = """
        e = set - n
        I = integrator(e * Ki)
        torque = Kp * e + I
        n = PT1(integrator(torque - load, 800), 0.2)
        set = 1000
        load = 10
        scalar Kp
        scalar Ki
    """
    steps = 200
    columns = even_clock(0.01, steps)
    parameters = ParameterSet([Scalar("Kp", 5.0), Scalar("Ki", 2.0)])
    n = evaluate(formula(text).graph, columns, parameters)["n"]
    speed = integral = n_hand = None
    for k in range(steps):
        speed = 800.0 if k == 0 else speed
        n_hand = (speed if k == 0 else n_hand) + 0.01 / 0.21 * (speed - (speed if k == 0 else n_hand))
        integral = 0.0 if k == 0 else integral
        error = 1000.0 - n_hand
        torque = 5.0 * error + integral
        assert n[k] == pytest.approx(n_hand, rel=1e-12)
        integral, speed = integral + 0.01 * error * 2.0, speed + 0.01 * (torque - 10.0)
