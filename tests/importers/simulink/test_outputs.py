"""Outputs of a model: outports, else recorded signals, else displayed ones, else those that lead nowhere."""

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


def thrice():
    """A gain of 3 whose output is not connected."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "Thrice", ports=(1, 1), Gain="3")
    drawn.line("u", "Thrice")
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


@pytest.mark.parametrize("kind", ["Record", "SpectrumAnalyzer"])
def test_plots_and_recorders_show_signals_as_scopes_do(kind, tmp_path):
    drawn = doubled(scope=False)
    drawn.block(kind, "Plot", ports=(1, 0))
    drawn.line("Thrice", "Plot")
    assert imported(drawn, tmp_path).graph.outputs == ("Thrice",)


def test_without_displays_the_signals_that_lead_nowhere_are_the_outputs(tmp_path):
    drawn = thrice()
    drawn.block("Demux", "Parts", ports=(1, 2), Outputs="2")
    drawn.block("Mux", "Both", ports=(2, 1), Inputs="2")
    drawn.block("Gain", "Half", ports=(1, 1), Gain="0.5")
    drawn.block("Terminator", "T", ports=(1, 0))
    drawn.line("u", "Both:1")
    drawn.line("Thrice", "Both:2")
    drawn.line("Both", "Parts")
    drawn.line("Parts:2", "Half")
    drawn.line("Half", "T", name="half")
    drawn.block("Constant", "Unused", ports=(0, 1))
    result = import_simulink(drawn.write(tmp_path, "slx parts"))
    assert result.model is not None
    assert result.model.graph.outputs == ("Parts:1", "half")
    np.testing.assert_array_equal(run(result.model, {"u": U})["Parts:1"], U)
    np.testing.assert_array_equal(run(result.model, {"u": U})["half"], 1.5 * U)
    (remark,) = [text for text in result.report.substitutions if "open ends" in text]
    assert remark.endswith("the outputs are the open ends of Parts, Half")


def test_the_driver_of_a_pin_ends_a_signal(tmp_path):
    drawn = thrice()
    drawn.link("Pin", "boards/PWM Output", "", ports=(1, 0))
    drawn.line("Thrice", "Pin")
    result = import_simulink(drawn.write(tmp_path, "slx parts"))
    assert result.model is not None
    assert result.model.graph.outputs == ("Thrice",)
    assert [(one.path, one.stops) for one in result.report.unsupported] == [("Pin", False)]


@pytest.mark.parametrize("read", [False, True])
def test_a_data_store_ends_a_signal_unless_it_is_read(read, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("DataStoreMemory", "M", DataStoreName="A")
    drawn.block("Gain", "Twice", ports=(1, 1), Gain="2")
    drawn.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="A", Priority="1")
    drawn.chain("u", "Twice", "W")
    if read:
        drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="A", Priority="2")
        drawn.block("Gain", "Again", ports=(1, 1), Gain="3")
        drawn.line("R", "Again")
    model = imported(drawn, tmp_path)
    assert model.graph.outputs == (("Again",) if read else ("Twice",))
    np.testing.assert_array_equal(run(model, {"u": U})[model.graph.outputs[0]], (6 if read else 2) * U)


def test_a_subsystem_that_is_the_only_block_has_its_ports(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    inner = drawn.subsystem("Torque")
    inner.inport("speed")
    inner.block("Gain", "Factor", ports=(1, 1), Gain="2")
    inner.outport("torque")
    inner.chain("speed", "Factor", "torque")
    result = import_simulink(drawn.write(tmp_path, "slx parts"))
    assert result.model is not None
    assert (result.model.graph.inputs, result.model.graph.outputs) == (("speed",), ("torque",))
    np.testing.assert_array_equal(run(result.model, {"speed": U})["torque"], 2 * U)
    assert [str(remark) for remark in result.report.remarks] == [
        "Torque: it is the only block and not connected: its ports are the inputs and outputs"
    ]


def test_a_model_without_outputs_is_reported(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Terminator", "T", ports=(1, 0))
    drawn.line("u", "T")
    with pytest.raises(InputError, match="no outport and no signal that could be an output"):
        imported(drawn, tmp_path)
