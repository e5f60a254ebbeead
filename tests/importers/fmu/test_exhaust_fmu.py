"""The exhaust temperature model as an FMU beside the same model as formula text."""

import shutil
import sys
from pathlib import Path

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Map
from kennfeld.importers.fmu.importing import fmu

ROOT = Path(__file__).parents[3]
FORMULA = """\
solver ode1
settled = MapSettled(speed, injection)
T = integrator((settled - T) / CurveTimeConstant(air), settled)
"""
SAMPLES, SPAN = 300, 30.0


@pytest.fixture(scope="module")
def problem():
    if shutil.which("gcc") is None or not (ROOT / "benchmarks").is_dir():
        pytest.skip("needs gcc and the folder benchmarks")
    sys.path.insert(0, str(ROOT))
    try:
        from benchmarks import fmu_problem
    finally:
        sys.path.remove(str(ROOT))
    return fmu_problem


def formula_start(problem, settled, constant):
    rows, columns, points = problem.GRID
    axes = [Axis(np.linspace(0.0, 1.0, count)) for count in (rows, columns, points)]
    return kf.ParameterSet(
        [
            Map("MapSettled", *axes[:2], np.reshape(settled, (rows, columns)), extrapolation="linear"),
            Curve("CurveTimeConstant", axes[2], constant, extrapolation="linear", lower=0.001, upper=np.inf),
        ]
    )


@pytest.mark.slow
@pytest.mark.parametrize("directional", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_both_calibrate_to_the_same_parameters(problem, tmp_path, directional):
    own = problem.PROBLEMS["exhaust"]
    values = problem.GRID[0] * problem.GRID[1]
    data = problem.data_of("exhaust", SAMPLES, SPAN)
    true = formula_start(problem, own.true[:values], own.true[values:])
    clean = kf.simulate(FORMULA, data, true)["T"].values
    data["target"] = clean + np.random.default_rng(3).normal(0.0, 3.7, SAMPLES)
    options = kf.Options(tolerance=1e-12)
    start = formula_start(problem, np.full(values, 230.0), np.full(problem.GRID[2], 5.0))
    by_formula = kf.calibrate(FORMULA, data, start, "target", node="T", options=options)
    model = fmu(problem.build(tmp_path, "exhaust", directional=directional), solver="ode1")
    by_fmu = kf.calibrate(model, data, {}, "target", options=options)
    assert by_fmu.cost_after == pytest.approx(by_formula.cost_after, rel=1e-9)
    for name in ("MapSettled", "CurveTimeConstant"):
        fitted, expected = (result.parameters[name].values for result in (by_fmu, by_formula))
        np.testing.assert_allclose(fitted, expected, rtol=1e-6)
