"""LTI System blocks, against the matrix exponential of their state space."""

import numpy as np
import pytest
import scipy

from kennfeld.base.errors import InputError
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run, slopes

U = np.random.default_rng(4).normal(size=30)
STEP = 0.05
VALUES = {"K": 2.0, "Kp": 0.5, "Ki": 1.5, "N": 4.0, "T": 0.3}


def drawn(text, **fields):
    model = Model(solver="ode4", step=str(STEP))
    model.link("B", "cstblocks/LTI System", "LTI Block", ports=(1, 1), sys=text, **fields)
    model.between(["u"], "B", ["y"])
    return model


def response(numerator, denominator, start=None):
    """The output for inputs that are constant within a step, exact."""
    A, B, C, D = scipy.signal.tf2ss(numerator, denominator)
    return of_states(A, B, C, D, np.zeros(len(A)))


def of_states(A, B, C, D, x):
    n = len(A)
    grown = scipy.linalg.expm(STEP * np.block([[A, B], [np.zeros((1, n + 1))]]))
    result = []
    for u in U:
        result.append((C @ x + D[0] * u).item())
        x = grown[:n, :n] @ x + grown[:n, n] * u
    return np.array(result)


@pytest.mark.parametrize(
    ("text", "numerator", "denominator"),
    [
        ("tf(1,[1 1])", [1], [1, 1]),
        ("tf(K, [T 1])", [2.0], [0.3, 1]),
        ("tf([1 2],[1 3 5])", [1, 2], [1, 3, 5]),
        ("tf([0 0 1],[1 3 5])", [1], [1, 3, 5]),
        ("zpk([-1],[-2 -3],4)", [4, 4], [1, 5, 6]),
        ("zpk([],[-2],K)", [2], [1, 2]),
        ("-K/(T*s + 1)", [-2.0], [0.3, 1]),
        ("tf('s')/(tf('s') + K)", [1, 0], [1, 2]),
        ("(s + 1)^2/(s^2 + 3*s + 5)", [1, 2, 1], [1, 3, 5]),
        # a PID controller with a filtered derivative: Kp + Ki/s + K N s / (s + N)
        ("tf(Kp + Ki/s + K*N*s/(s + N))", [0.5 + 8, 2.0 + 1.5, 6.0], [1, 4, 0]),
        ("tf(2,4)", [0.5], [1]),
    ],
)
def test_transfer_functions_respond_as_their_state_space(text, numerator, denominator, tmp_path):
    output = run(imported(drawn(text), tmp_path, parameters=[VALUES]), {"u": U})["y"]
    expected = 0.5 * U if numerator == [0.5] else response(numerator, denominator)
    np.testing.assert_allclose(output, expected, atol=1e-5 * np.abs(expected).max())


def test_a_state_space_begins_at_its_initial_states(tmp_path):
    model = drawn("ss([-1 2; 0 -K], [1; 1], [1 0], 0)", IC="[3 -1]")
    output = run(imported(model, tmp_path, parameters=[VALUES]), {"u": U})["y"]
    A, B = np.array([[-1.0, 2], [0, -2]]), np.array([[1.0], [1]])
    expected = of_states(A, B, np.array([1.0, 0]), np.array([0.0]), np.array([3.0, -1]))
    np.testing.assert_allclose(output, expected, rtol=1e-6, atol=1e-7)


def test_derivatives_with_respect_to_the_parameters_of_a_system_are_exact(tmp_path):
    model = imported(drawn("tf(K, [T 1])"), tmp_path, parameters=[VALUES])
    for name in ("K", "T"):
        exact, numeric = slopes(model, {"u": U}, name, "y")
        np.testing.assert_allclose(exact, numeric, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize(
    ("text", "fields", "why"),
    [
        ("tf(1,[1 1],0.1)", {}, "its tf has 3 arguments: only continuous systems"),
        ("s", {}, "its sys is not proper"),
        ("1/(s-s)", {}, "denominator of its sys is 0"),
        ("sys_1", {}, "sys_1"),
        ("s^0.5", {}, "a power that is not an integer"),
        ("tf(1,[1 1])", {"IC": "2"}, "initial states, which only state spaces have"),
        ("ss(1,2)", {}, "its ss has 2 arguments"),
        ("ss([1 2],[1;1],[1 0],0)", {}, "sizes of its A, B, C and D"),
    ],
)
def test_other_systems_are_refused(text, fields, why, tmp_path):
    with pytest.raises(InputError, match=why):
        imported(drawn(text, **fields), tmp_path, parameters=[VALUES])
