"""Models with FMUs in Python run in a process of their own, which alone ends if the code of the FMU crashes."""

import logging

import numpy as np
import pytest

import kennfeld as kf
from kennfeld.base.errors import InputError
from kennfeld.importers.fmu.importing import fmu
from tests.importers.fmu.lag_fmu import build
from tests.importers.fmu.tank_fmu import build as build_tank
from tests.importers.fmu.tank_fmu import recording

DATA = {"time": np.arange(20) * 0.1, "u": np.full(20, 3.0)}


def test_a_crash_is_a_message_that_names_the_function_and_the_session_goes_on(tmp_path):
    crashing = build(tmp_path, 2, "-DIN_GET=if (m->used_tau > 9.0) raise(SIGSEGV)")
    model = fmu(crashing)
    expected = kf.simulate(model, DATA, {"tau": 2.0})["y"].values
    with pytest.raises(InputError, match=r"lag\.fmu: its code crashed in fmi2Get.*segmentation fault"):
        kf.simulate(model, DATA, {"tau": 9.5})
    np.testing.assert_array_equal(kf.simulate(model, DATA, {"tau": 2.0})["y"].values, expected)
    data = {**DATA, "target": expected}
    lines = []
    result = kf.calibrate(model, data, {"tau": 1.5}, "target", free=["tau"], progress=lines.append)
    assert result.parameters["tau"].value == pytest.approx(2.0, rel=1e-6)
    assert result.trust.deviation["tau"].shape == ()
    assert len(lines) == len(result.trace) > 1


@pytest.mark.parametrize(
    ("code", "message"),
    [
        # what the C library does when it finds a damaged heap
        ("free((char *)m + 8)", r"crashed in fmi2Get.*aborted"),
        pytest.param("exit(3)", "ended the program with exit status 3", marks=pytest.mark.slow),
    ],
)
def test_a_damaged_heap_or_an_exit_of_an_fmu_is_a_message(code, message, tmp_path):
    model = fmu(build(tmp_path, 2, f"-DIN_GET={code}"))
    with pytest.raises(InputError, match=message):
        kf.simulate(model, DATA, {"tau": 2.0})


@pytest.mark.slow
def test_a_crash_in_a_project_is_a_message_too(tmp_path):
    build(tmp_path, 2, "-DIN_GET=if (m->used_tau > 9.0) raise(SIGSEGV)")
    text = """[model]
file = "lag.fmu"
[[dataset]]
files = ["bench.csv"]
[[criterion]]
node = "y"
target = 305.0
[calibration]
free = ["k"]
[parameters.tau]
initial = 9.5
"""
    (tmp_path / "bench.csv").write_text("time,u\n0,1\n0.1,1\n0.2,1\n")
    (tmp_path / "kennfeld.toml").write_text(text)
    project = kf.Project.read(tmp_path / "kennfeld.toml")
    for call in (project.simulate, project.calibrate, project.check):
        with pytest.raises(InputError, match=r"lag\.fmu: its code crashed in fmi2Get"):
            call()


def test_messages_of_an_fmu_reach_the_session(tmp_path, caplog):
    with caplog.at_level(logging.WARNING):
        y = kf.simulate(fmu(build_tank(tmp_path, 2)), recording(), {"fault": 3.0, "at": 1.0})["y"].values
    assert np.isnan(y[-1])
    assert "tank.fmu logged: the tank leaks" in caplog.text
