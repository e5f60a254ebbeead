"""Exported FMUs in `fmusim`, the simulator of the Reference FMUs of the Modelica Association, where it is installed."""

import csv
import shutil
import subprocess
from functools import cache

import numpy as np
import pytest

from kennfeld import Axis, Map, ParameterSet, Scalar, simulate
from kennfeld.export.api import export_function
from tests.export.compiled import needs_compiler

STATIC = "y = M(Speed, Load) * K"
MEMORY = "y = PT1(M(Speed, Load), 0.5) + K * delay(Load, 3, 0)"
STEP, SAMPLES = 0.1, 60


@cache
def _lacks_fmusim() -> bool:
    path = shutil.which("fmusim")
    # later versions, which are written in Rust, have other options
    return (
        path is None or "--interface-type" not in subprocess.run([path, "--help"], capture_output=True).stdout.decode()
    )


pytestmark = [
    pytest.mark.slow,
    needs_compiler,
    pytest.mark.skipif(_lacks_fmusim(), reason="fmusim of the Reference FMUs, up to version 0.0.39, is not installed"),
]


def _values():
    random = np.random.default_rng(1)
    return ParameterSet([Map("M", Axis([0, 1, 2, 5]), [-1, 2, 3], random.normal(size=(4, 3))), Scalar("K", 0.3)])


def _columns():
    random = np.random.default_rng(2)
    return {"Speed": random.uniform(-1, 6, SAMPLES), "Load": random.uniform(-1, 4, SAMPLES)}


def _simulated(fmu, kind, *options):
    """Return time and output as fmusim computes them, Float[2, samples]."""
    columns, time = _columns(), np.arange(SAMPLES) * STEP
    table = fmu.with_suffix(".csv")
    rows = zip(time, *columns.values(), strict=True)
    table.write_text("\n".join([",".join(["time", *columns]), *(",".join(map(repr, map(float, row))) for row in rows)]))
    out = fmu.with_suffix(".out.csv")
    command = ["fmusim", "--interface-type", kind, "--solver", "euler", "--output-interval", repr(STEP)]
    command += ["--stop-time", repr(float(time[-1])), "--input-file", str(table), "--output-file", str(out)]
    run = subprocess.run([*command, *options, str(fmu)], capture_output=True, text=True, check=False)
    assert (run.returncode, run.stderr) == (0, "")
    with out.open() as file:
        return np.array([*csv.reader(file)][1:], dtype=np.float64).T


@pytest.mark.parametrize("fmi", [2, 3])
@pytest.mark.parametrize("text", [STATIC, MEMORY], ids=["static", "memory"])
def test_co_simulation_gives_the_simulation_a_step_later(text, fmi, tmp_path):
    options = {"to": "fmu", "name": "engine", "fmi": fmi, "inputs": "start", "step": STEP}
    fmu = export_function(text, _values(), tmp_path, **options).files[0]
    time, output = _simulated(fmu, "cs")
    expected = simulate(text, {**_columns(), "time": np.arange(SAMPLES) * STEP}, _values())["y"].values
    np.testing.assert_allclose(time, np.arange(SAMPLES) * STEP)
    # the first row is that of the initialization
    np.testing.assert_allclose(output, [expected[0], *expected[:-1]], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("fmi", [2, 3])
def test_model_exchange_gives_the_simulation(fmi, tmp_path):
    fmu = export_function(STATIC, _values(), tmp_path, to="fmu", name="engine", fmi=fmi).files[0]
    expected = simulate(STATIC, _columns(), _values())["y"].values
    np.testing.assert_allclose(_simulated(fmu, "me")[1], expected, rtol=1e-12, atol=1e-12)
