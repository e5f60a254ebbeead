"""Checks that half the step of a drawn model gives the same values."""

import re

import numpy as np
import pytest

from kennfeld import cli
from tests.importers.simulink.simulink_files import Model

pytestmark = pytest.mark.guests

PROJECT = """[model]
file = "lag.slx"
[[dataset]]
files = "drive.csv"
[[criterion]]
node = "y"
target = "z"
[parameters.Rate]
initial = {rate}
"""


@pytest.fixture
def lag(shop):
    """A project on y' = Rate * (u - y) with a solver of a variable step, over steps of 10 ms."""

    def drawn(rate, solver="ode15s"):
        model = Model("lag", solver=solver, step="auto" if solver == "ode15s" else "0.01")
        model.inport("u")
        model.block("Sum", "Error", ports=(2, 1), Inputs="+-")
        model.block("Gain", "Rate", Gain="Rate")
        model.block("Integrator", "Lag")
        model.outport("y")
        model.line("u", "Error:1")
        model.line("Lag", "Error:2")
        model.chain("Error", "Rate", "Lag")
        model.line("Lag", "y")
        model.write(shop.folder, "slx parts")
        time = 0.01 * np.arange(400)
        shop.csv("drive.csv", {"time": time, "u": np.sin(3 * time), "z": np.sin(3 * time)})
        shop.toml = PROJECT.format(rate=rate)
        return shop

    return drawn


def warnings(shop):
    return [finding for finding in shop.project.check() if "too long for the fixed-step solver" in finding.message]


def test_an_unstable_step_of_a_stiff_model_is_a_finding_with_a_stable_one(lag):
    shop = lag(2000.0)
    (warning,) = warnings(shop)
    assert "step" in str(warning.location)
    assert "step = 0.01 s is too long for the fixed-step solver: halving it changes " in warning.message
    (step,) = re.findall(r"Write step = (\S+) under", warning.remedy)
    assert 2000.0 * float(step) < 2.79  # where ode4 is stable
    shop.change('file = "lag.slx"', f'file = "lag.slx"\nstep = {step}')
    assert warnings(shop) == []


def test_a_stable_but_inexact_step_is_a_finding(lag):
    """At Rate * step = 2.7 ode4 still shrinks, by a factor of 0.88 a step in place of 0.07."""
    (warning,) = warnings(lag(270.0))
    assert re.search(r"y by \d+% of its standard deviation", warning.message)


@pytest.mark.parametrize(("rate", "solver"), [(20.0, "ode15s"), (270.0, "ode4")])
def test_a_step_that_half_of_it_confirms_or_that_the_model_states_has_no_finding(lag, rate, solver):
    assert warnings(lag(rate, solver)) == []


def test_samples_between_those_of_the_data_are_not_counted(lag, capsys):
    shop = lag(20.0)
    shop.change('file = "lag.slx"', 'file = "lag.slx"\nstep = 0.0025')
    assert cli.run(["check", str(shop.project.path)]) == 0
    assert "400 training samples" in capsys.readouterr().out
