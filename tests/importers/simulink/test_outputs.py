"""Outputs of a model: outports, else recorded signals, else displayed ones."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import imported, run

U = np.array([1.0, 2.0, 3.0])


def doubled(*, scope=True):
    """A gain with its signal named, and one without, before a scope of two inputs and a display."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    inner = drawn.subsystem("In")
    inner.inport("a")
    inner.block("Gain", "Twice", ports=(1, 1), Gain="2")
    inner.outport("b")
    inner.chain("a", "Twice", "b")
    drawn.block("Gain", "Thrice", ports=(1, 1), Gain="3")
    drawn.line("u", "In", "Thrice")
    if scope:
        drawn.block("Scope", "Shown", ports=(3, 0), NumInputPorts="3")
        drawn.block("Display", "Again", ports=(1, 0))
        drawn.line("In", "Shown:1", name="double")
        drawn.line("Thrice", "Shown:2", "Again")
    return drawn


def test_without_outports_the_signals_of_scopes_and_displays_are_the_outputs(tmp_path):
    model = imported(doubled(), tmp_path)
    assert model.graph.outputs == ("double", "Thrice")
    outputs = run(model, {"u": U})
    np.testing.assert_array_equal(outputs["double"], 2 * U)
    np.testing.assert_array_equal(outputs["Thrice"], 3 * U)


@pytest.mark.parametrize("kind", ["ToWorkspace", "SignalToWorkspace"])
def test_recorded_signals_come_before_displayed_ones(kind, tmp_path):
    drawn = doubled()
    drawn.block(kind, "W", ports=(1, 0), VariableName="kept")
    drawn.line("In", "W")
    assert imported(drawn, tmp_path).graph.outputs == ("kept",)


def test_scopes_are_passed_over_beside_outports(tmp_path):
    drawn = doubled()
    drawn.outport("y")
    drawn.line("In", "y")
    model = imported(drawn, tmp_path)
    assert model.graph.outputs == ("y",)
    assert "Shown" not in " ".join(model.graph.names)


def test_a_bus_in_a_scope_is_taken_apart(tmp_path):
    drawn = doubled(scope=False)
    drawn.block("BusCreator", "Bus", ports=(2, 1), Inputs="2")
    drawn.block("Scope", "Shown", ports=(1, 0))
    drawn.line("In", "Bus:1", name="a")
    drawn.line("Thrice", "Bus:2", name="b")
    drawn.line("Bus", "Shown", name="both")
    assert imported(drawn, tmp_path).graph.outputs == ("both.a", "both.b")


def test_a_display_of_an_unsupported_signal_is_left_out(tmp_path):
    drawn = doubled()
    drawn.block("S-Function", "Sync", ports=(0, 1))
    drawn.block("Display", "Ticks", ports=(1, 0))
    drawn.line("Sync", "Ticks")
    result = import_simulink(drawn.write(tmp_path, "slx parts"))
    assert result.model is not None
    assert result.model.graph.outputs == ("double", "Thrice")
    assert "skipped Ticks: the displayed signal is not supported" in result.report.substitutions
    assert [(one.path, one.stops) for one in result.report.unsupported] == [("Sync", False)]


def test_a_model_without_outputs_is_reported(tmp_path):
    with pytest.raises(InputError, match="no outport and no block that records"):
        imported(doubled(scope=False), tmp_path)
