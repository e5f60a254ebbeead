"""Warnings about fitted time constants close to the step, and about limits in the wrong order."""

import numpy as np
import pytest

import kennfeld as kf

RNG = np.random.default_rng(0)
U = RNG.normal(size=400)


def lag(dt, T=1.0):
    """The input, and a lag that follows it exactly, with samples dt apart."""
    y = [0.0]
    for u in U[1:]:
        y.append(y[-1] + (1 - np.exp(-dt / T)) * (u - y[-1]))
    return {"time": dt * np.arange(U.size), "u": U, "w": np.abs(U), "m": np.array(y)}


def warnings(text, data, start, **options):
    result = kf.calibrate(text, data, start, "m", **options)
    return result, [str(warning) for warning in result.warnings]


@pytest.mark.parametrize(("dt", "T"), [(0.1, 0.951), (0.3, 0.857), (1.0, 0.582)])
def test_a_time_constant_below_five_steps_is_a_warning_with_that_of_the_lag(dt, T):
    result, sentences = warnings("y = PT1(u, T, 0)", lag(dt), {"T": 2.0})
    assert result.parameters["T"].value == pytest.approx(T, abs=1e-3)
    assert len(sentences) == (dt > T / 5)
    for sentence in sentences:
        assert f"depends on T is below 5 steps ({result.parameters['T'].value:.3g} s at a step of {dt:g} s)" in sentence
        assert "decays like a lag of 1 s" in sentence
        assert "PT1exact" in sentence
    rows = result.as_json()["warnings"]
    assert len(rows) == len(sentences)
    assert all(row["sentence"] in sentence for row, sentence in zip(rows, sentences, strict=True))


@pytest.mark.parametrize("dt", [0.1, 0.3, 1.0])
def test_the_exact_lag_recovers_the_time_constant(dt):
    result, sentences = warnings("y = PT1exact(u, T, 0)", lag(dt), {"T": 2.0})
    assert result.parameters["T"].value == pytest.approx(1.0, rel=1e-3)
    assert not sentences


def test_time_constants_of_a_table_are_examined_at_values_with_data():
    low = kf.Curve("L", [0.0, 1.0, 9.0], [0.2, 3.0, 0.01])
    _, sentences = warnings(
        "y = PT1(u, L(w), 0) * k", lag(0.1), kf.ParameterSet([low, kf.Scalar("k", 1.0)]), free=["L"]
    )
    assert all("depends on L is below 5 steps at " in sentence for sentence in sentences)
    _, sentences = warnings(
        "y = PT1(u, L(w), 0) * k", lag(0.1), kf.ParameterSet([low, kf.Scalar("k", 1.0)]), free=["k"]
    )
    assert not sentences  # it is not fitted


def test_a_corner_frequency_is_examined_on_uneven_time():
    time = np.cumsum(np.resize([0.4, 0.02], U.size))
    data = {"time": time, "u": U} | {"m": kf.simulate("y = lowpass(u, 0.5)", {"time": time, "u": U}, {})["y"].values}
    _, sentences = warnings("y = lowpass(u, f)", data, {"f": 0.6})
    assert "depends on f is below 5 steps at 50% of the samples, down to 0.318 s at a step of 0.4 s" in sentences[0]


@pytest.mark.parametrize(
    ("text", "start", "expected"),
    [
        (
            "y = k * integrator(u, 0, lo, hi)",
            {"lo": 1.0, "hi": -1.0},
            "limits that depend on hi, lo are crossed: 1 > -1",
        ),
        ("y = k * clip(u, lo, hi)", {"lo": 1.0, "hi": 2.0}, ""),
        ("y = k * hysteresis(u, on, off)", {"on": -1.0, "off": 1.0}, "depend on off, on are crossed: 1 > -1"),
        ("y = k * ratelimit(u, up, down)", {"up": -1.0, "down": 1.0}, "limits that depend on down, up are crossed"),
    ],
)
def test_limits_that_parameters_cross_are_a_warning(text, start, expected):
    _, sentences = warnings(text, lag(0.1), {**start, "k": 1.0}, free=["k"])
    crossed = [sentence for sentence in sentences if "crossed" in sentence]
    assert len(crossed) == bool(expected)
    assert all(expected in sentence for sentence in crossed)
