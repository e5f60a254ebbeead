"""Straight lines over inputs that vary little about a large number, such as Unix time."""

import numpy as np
import pytest

import kennfeld as kf


def line(count, first, step, a=0.0, b=0.0, options=None):
    noise = np.random.default_rng(0).normal(size=count)
    elapsed = np.arange(count) * step
    columns = {"stamp": first + elapsed, "y": 5 + 0.01 * elapsed / step + 0.1 * noise}
    result = kf.calibrate("m = a + b*stamp", columns, {"a": a, "b": b}, target="y", options=options)
    exact = np.polynomial.Polynomial.fit(elapsed, columns["y"], 1)
    return result, float(np.sqrt(np.mean((exact(elapsed) - columns["y"]) ** 2))), exact.convert().coef[1]


@pytest.mark.parametrize(
    ("count", "first", "step", "start"), [(100, 1.7e9, 1.0, 0.0), (3600, 1.7e9, 0.01, 1.0), (1000, 1.7e12, 1.0, 0.0)]
)
def test_a_line_over_unix_time_is_solved(count, first, step, start):
    result, rmse, slope = line(count, first, step, start, start)
    assert result.converged
    assert result.iterations < 20
    assert result.quality[0].rmse_after == pytest.approx(rmse, rel=1e-6)
    assert result.parameters["b"].value == pytest.approx(slope, rel=1e-5)


def test_the_slope_has_the_deviation_that_it_has_over_elapsed_time():
    trust = line(3600, 1.7e9, 0.01)[0].trust
    assert float(trust.deviation["b"]) == pytest.approx(0.1 / np.sqrt(3600) / np.std(0.01 * np.arange(3600)), rel=0.02)
    assert "smoothness" not in trust.directions[0].sentence  # there is none


def test_a_search_slowed_by_an_offset_suggests_a_remedy():
    result, *_ = line(100, 1.7e9, 1.0, options=kf.Options(max_iterations=1))
    assert result.status == "max_iterations"
    assert "stamp varies only by 99 about 1.7e+09. Subtract its first value" in result.message
