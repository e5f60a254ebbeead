"""Resettable subsystems, and memories that begin anew with a subsystem further out."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import crossings, imported, run, slopes

T = 0.1
U = np.random.default_rng(8).normal(size=40)
R = np.array([0, 0, 1, 1, 0, -1, 0, 0, 2, 0, -2, -1, 1, 0, 0, 0, 3, 3, 0, 0] * 2, dtype=float)
KINDS = ("level", "rising", "falling", "either", "level hold")


def accumulator(inner, start="start"):
    """A running sum, x = x + u, written out in blocks."""
    inner.inport("x")
    inner.block("Sum", "S", ports=(2, 1))
    inner.block("UnitDelay", "Z", SampleTime="-1", InitialCondition=start)
    inner.outport("y")
    inner.line("x", "S:1")
    inner.line("Z", "S:2")
    inner.line("S", "Z", "y")


def resettable(kind=None, content=accumulator, **model):
    drawn = Model(step="0.1", **{"solver": "FixedStepDiscrete", **model})
    drawn.inport("u")
    drawn.inport("r")
    inner = drawn.subsystem("Sub")
    content(inner)
    inner.block("ResetPort", "Reset", **({"ResetTriggerType": kind} if kind else {}))
    drawn.outport("y")
    drawn.chain("u", "Sub", "y")
    drawn.line("r", "Sub#reset")
    return drawn


def resets(kind, k, r=R):
    """Return whether a reset takes place, by the words of the setting."""
    if kind == "level hold":
        return r[k] != 0
    if kind == "level":
        return r[k] != 0 or (k > 0 and r[k - 1] != 0)
    up, down = crossings(r)
    return {"rising": up[k], "falling": down[k], "either": up[k] or down[k]}[kind]


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
def test_a_resettable_subsystem_restarts_and_continues(layout, tmp_path):
    model = imported(resettable(), tmp_path, layout, parameters=[{"start": 2.0}])
    output = run(model, {"u": U, "r": R})["y"]
    x = 2.0
    for k, u in enumerate(U):
        x = 2.0 if resets("level", k) else x
        x += u
        assert output[k] == pytest.approx(x, abs=1e-12), k
    exact, differences = slopes(model, {"u": U, "r": R}, "start", "y")
    np.testing.assert_allclose(exact, differences, atol=1e-8)


@pytest.mark.parametrize("kind", KINDS)
def test_the_kinds_of_resets(kind, tmp_path):
    output = run(imported(resettable(kind), tmp_path, parameters=[{"start": -1.0}]), {"u": U, "r": R})["y"]
    x = -1.0
    for k, u in enumerate(U):
        x = (-1.0 if resets(kind, k) else x) + u
        assert output[k] == pytest.approx(x, abs=1e-12), k


def test_an_unknown_kind_of_reset_is_reported(tmp_path):
    with pytest.raises(InputError, match="Sub: its reset 'guess'"):
        imported(resettable("guess"), tmp_path, parameters=[{"start": 0.0}])


def integrators(inner):
    inner.inport("x")
    inner.block("Integrator", "I", ports=(1, 1), InitialCondition="1")
    inner.block("DiscreteIntegrator", "D", ports=(1, 1), InitialCondition="5", SampleTime="0.1")
    inner.block("Sum", "S", ports=(2, 1))
    inner.outport("y")
    inner.line("x", "I", "D")
    inner.line("I", "S:1")
    inner.line("D", "S:2")
    inner.line("S", "y")


def test_integrators_are_reset_as_well(tmp_path):
    drawn = resettable("rising", integrators, solver="ode4")
    output = run(imported(drawn, tmp_path), {"u": U, "r": R})["y"]
    a, b = 1.0, 5.0
    for k, u in enumerate(U):
        if resets("rising", k):
            a, b = 1.0, 5.0
        assert output[k] == pytest.approx(a + b, abs=1e-12), k
        a, b = a + T * u, b + T * u


def nested(inner):
    """An enabled subsystem that holds its memory, within the one that is reset."""
    inner.inport("x")
    within = inner.subsystem("Within")
    accumulator(within)
    within.block("EnablePort", "E", StatesWhenEnabling="held")
    inner.outport("y")
    inner.chain("x", "Within", "y")
    inner.line("x", "Within#enable")


def test_a_reset_reaches_what_is_nested_even_while_that_does_not_run(tmp_path):
    outputs = run(imported(resettable("level hold", nested), tmp_path, parameters=[{"start": 2.0}]), {"u": U, "r": R})
    x, y = 2.0, 0.0
    for k, u in enumerate(U):
        x = 2.0 if R[k] else x
        if u > 0:
            x += u
            y = x
        assert outputs["y"][k] == pytest.approx(y, abs=1e-12), k


def test_states_that_are_reset_with_an_enabled_subsystem_are_those_within_too(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.inport("c")
    outer = drawn.subsystem("Outer")
    outer.inport("x")
    outer.block("EnablePort", "E", StatesWhenEnabling="reset")
    within = outer.subsystem("Within", TreatAsAtomicUnit="on")
    accumulator(within, "2")
    triggered = outer.subsystem("Calls")
    accumulator(triggered, "3")
    triggered.block("TriggerPort", "T", TriggerType="function-call")
    outer.link("F", "simulink/Ports & Subsystems/Function-Call Generator", "Function-Call Generator", ports=(0, 1),
               sample_time="-1")  # fmt: skip
    outer.line("F", "Calls#trigger")
    outer.line("x", "Within", "Calls")
    outer.outport("y")
    outer.outport("z")
    outer.line("Within", "y")
    outer.line("Calls", "z")
    drawn.outport("y")
    drawn.outport("z")
    drawn.line("u", "Outer")
    drawn.line("c", "Outer#enable")
    drawn.line("Outer:1", "y")
    drawn.line("Outer:2", "z")
    C = np.tile([1.0, 1.0, 0.0, 0.0, 1.0], 8)
    outputs = run(imported(drawn, tmp_path), {"u": U, "c": C})
    a, b, was, y, z = 2.0, 3.0, 0.0, 0.0, 0.0
    for k, u in enumerate(U):
        if C[k]:
            a, b = (2.0, 3.0) if not was else (a, b)
            a, b = a + u, b + u
            y, z = a, b
        was = C[k]
        assert (outputs["y"][k], outputs["z"][k]) == pytest.approx((y, z), abs=1e-12), k


def test_a_subsystem_can_be_enabled_and_resettable(tmp_path):
    drawn = resettable("level hold")
    drawn.inport("c")
    drawn.blocks[2].system.block("EnablePort", "E", StatesWhenEnabling="held")
    drawn.line("c", "Sub#enable")
    C = np.tile([1.0, 1.0, 0.0, 1.0], 10)
    output = run(imported(drawn, tmp_path, parameters=[{"start": 2.0}]), {"u": U, "r": R, "c": C})["y"]
    x, y = 2.0, 0.0
    for k, u in enumerate(U):
        x = 2.0 if R[k] else x
        if C[k]:
            x += u
            y = x
        assert output[k] == pytest.approx(y, abs=1e-12), k
