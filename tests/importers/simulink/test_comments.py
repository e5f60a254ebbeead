"""Blocks that are commented out are not there; those that are commented through are wires."""

import numpy as np
import pytest

from kennfeld.importers.simulink.importing import import_simulink
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import imported, run

U = np.array([1.0, -2.0, 3.0])


def summed(**parameters):
    """A model y = u + 10 f(u) where f is a block that may be commented."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "F", ports=(1, 1), Gain="7", **parameters)
    drawn.block("Gain", "K", ports=(1, 1), Gain="10")
    drawn.block("Sum", "S", ports=(2, 1), Inputs="++")
    drawn.outport("y")
    drawn.line("u", "F", "S:1")
    drawn.chain("F", "K", "S:2")
    drawn.line("S", "y")
    return drawn


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
@pytest.mark.parametrize(("how", "factor"), [("off", 71), ("on", 1), ("through", 11)])
def test_a_commented_block_gives_nothing_or_passes_on(layout, how, factor, tmp_path):
    output = run(imported(summed(Commented=how), tmp_path, layout), {"u": U})["y"]
    np.testing.assert_array_equal(output, factor * U)


def test_several_blocks_in_a_row_are_commented_through(tmp_path):
    drawn = summed(Commented="through")
    drawn.blocks[2].parameters["Commented"] = "through"
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u": U})["y"], 2 * U)


def test_blocks_that_are_commented_out_need_not_be_supported(tmp_path):
    drawn = summed()
    drawn.block("S-Function", "Target", ports=(1, 1), Commented="on")
    drawn.link("Gone", "elsewhere/Block", ports=(1, 1), Commented="on")
    drawn.block("Goto", "Second", ports=(1, 0), GotoTag="T", Commented="on")
    drawn.block("Goto", "First", ports=(1, 0), GotoTag="T")
    drawn.block("From", "Here", ports=(0, 1), GotoTag="T")
    drawn.outport("z")
    drawn.outport("out of use", Commented="on")
    drawn.line("u", "Target", "Gone", "First")
    drawn.line("K", "Second")
    drawn.line("Here", "z")
    drawn.line("Target", "out of use")
    model = imported(drawn, tmp_path)
    assert model.graph.outputs == ("y", "z")
    np.testing.assert_array_equal(run(model, {"u": U})["z"], U)


def test_a_subsystem_is_commented_with_all_that_is_in_it(tmp_path):
    for how, factor in (("on", 0), ("through", 1)):
        drawn = Model(step="0.1", solver="FixedStepDiscrete")
        drawn.inport("u")
        inner = drawn.subsystem("In", Commented=how, ports=(1, 1))
        inner.inport("a")
        inner.block("S-Function", "F", ports=(1, 1))
        inner.outport("b")
        inner.chain("a", "F", "b")
        drawn.outport("y")
        drawn.chain("u", "In", "y")
        output = run(imported(drawn, tmp_path), {"u": U})["y"]
        np.testing.assert_array_equal(output, factor * U)


def test_a_subsystem_that_is_commented_out_can_be_imported_by_itself(tmp_path):
    drawn = summed()
    inner = drawn.subsystem("In", Commented="on", ports=(1, 1))
    inner.inport("a")
    inner.block("Gain", "Twice", ports=(1, 1), Gain="2")
    inner.block("Gain", "Thrice", ports=(1, 1), Gain="3", Commented="through")
    inner.outport("b")
    inner.chain("a", "Twice", "Thrice", "b")
    output = run(imported(drawn, tmp_path, subsystem="In"), {"a": U})["b"]
    np.testing.assert_array_equal(output, 2 * U)


def test_a_ring_of_blocks_that_are_commented_through_gives_nothing(tmp_path):
    drawn = summed()
    for name in ("A", "B"):
        drawn.block("Gain", name, ports=(1, 1), Commented="through")
    drawn.block("Bias", "C", ports=(1, 1), Bias="5")
    drawn.outport("z")
    drawn.line("A", "B")
    drawn.line("B", "A", "C")
    drawn.line("C", "z")
    np.testing.assert_array_equal(run(imported(drawn, tmp_path), {"u": U})["z"], [5, 5, 5])


def remarks(drawn, folder, **options):
    return [str(remark) for remark in import_simulink(drawn.write(folder, "slx parts"), **options).report.remarks]


def test_a_constant_output_names_the_block_that_is_commented_out(tmp_path):
    drawn = Model(step="0.1", solver="ode4")
    drawn.inport("u")
    plant = drawn.subsystem("Plant")
    plant.inport("a")
    plant.block("Gain", "Off", Commented="on")
    plant.block("Gain", "K", ports=(1, 1), Gain="5")
    plant.block("Integrator", "I", InitialCondition="2")
    plant.outport("b")
    plant.chain("a", "Off", "K", "I", "b")
    drawn.block("UnitDelay", "Z", InitialCondition="2", SampleTime="-1")
    drawn.outport("y")
    drawn.outport("z")
    drawn.chain("u", "Plant", "Z", "y")
    drawn.line("u", "z")
    assert remarks(drawn, tmp_path) == ["y: the output is constant (2): Plant/Off is commented out"]
    assert remarks(summed(Commented="on"), tmp_path) == []
    assert remarks(summed(Commented="through"), tmp_path) == []


def test_a_constant_output_names_the_subsystem_that_never_runs(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("Gain", "Switch", Gain="1", Commented="on")
    inner = drawn.subsystem("Part")
    inner.block("EnablePort", "E")
    inner.inport("a")
    inner.outport("b", InitialOutput="7")
    inner.chain("a", "b")
    drawn.outport("y")
    drawn.line("u", "Switch", "Part")
    drawn.line("Switch", "Part#enable")
    drawn.line("Part", "y")
    remark = "y: the output is constant (7): Part never runs, Switch is commented out"
    assert remarks(drawn, tmp_path) == [remark]


def test_an_output_of_a_constant_block_gives_no_remark(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("Constant", "C", Value="3")
    drawn.block("Ground", "G", ports=(0, 1))
    for name in ("y", "z"):
        drawn.outport(name)
    drawn.line("C", "y")
    drawn.line("G", "z")
    assert remarks(drawn, tmp_path) == ["z: the output is constant (0): G is grounded"]
