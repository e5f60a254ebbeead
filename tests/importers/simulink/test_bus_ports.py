"""Ports that several blocks share, each for an element of a bus."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_files import LAYOUTS, Model
from tests.importers.simulink.simulink_runs import imported, run

U, V = np.random.default_rng(37).normal(size=(2, 12))


def element(system, kind, name, port, way, bus="Bus"):
    system.block(kind, name, IsBusElementPort="on", Port=str(port), PortName=bus, Element=way)


def drawn(control=None):
    """A subsystem that takes n and air.p of one bus, and gives sum and deep.product in another."""
    model = Model(step="0.1", solver="FixedStepDiscrete")
    model.inport("u")
    model.inport("v")
    model.block("BusCreator", "Air", ports=(1, 1), Inputs="1")
    model.block("BusCreator", "All", ports=(2, 1), Inputs="2")
    inner = model.subsystem("S", ports={"in": 1, "out": 1, **({"enable": 1} if control else {})})
    element(inner, "Inport", "n", 1, "n")
    element(inner, "Inport", "p", 1, "air.p")
    element(inner, "Outport", "first", 1, "sum")
    element(inner, "Outport", "second", 1, "deep.product")
    inner.block("Sum", "T", ports=(2, 1))
    inner.block("Product", "M", ports=(2, 1))
    if control:
        inner.block("EnablePort", "E")
    for at, name in enumerate(("n", "p"), 1):
        inner.line(name, f"T:{at}", f"M:{at}")
    inner.line("T", "first")
    inner.line("M", "second")
    model.block("BusSelector", "Pick", ports=(1, 2), OutputSignals="sum,deep.product")
    model.outport("a")
    model.outport("b")
    model.line("v", "Air", name="p")
    model.line("Air", "All:2", name="air")
    model.line("u", "All:1", name="n")
    model.chain("All", "S", "Pick")
    model.line("Pick:1", "a")
    model.line("Pick:2", "b")
    return model


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl package"]))
def test_a_subsystem_takes_and_gives_elements_of_buses(layout, tmp_path):
    outputs = run(imported(drawn(), tmp_path, layout), {"u": U, "v": V})
    np.testing.assert_allclose(outputs["a"], U + V)
    np.testing.assert_allclose(outputs["b"], U * V)


def test_elements_at_the_top_are_channels_and_outputs_of_their_own(tmp_path):
    model = Model(step="0.1", solver="FixedStepDiscrete")
    element(model, "Inport", "In Bus Element", 1, "n", "Engine")
    element(model, "Inport", "In Bus Element1", 1, "air.p", "Engine")
    element(model, "Outport", "Out Bus Element", 1, "m", "Result")
    element(model, "Outport", "Out Bus Element1", 1, "k", "Result")
    model.block("Gain", "G", Gain="2")
    model.block("Gain", "H", Gain="3")
    model.chain("In Bus Element", "G", "Out Bus Element")
    model.chain("In Bus Element1", "H", "Out Bus Element1")
    model_of_buses = imported(model, tmp_path)
    assert model_of_buses.graph.outputs == ("Result.m", "Result.k")
    outputs = run(model_of_buses, {"Engine.n": U, "Engine.air.p": V})
    np.testing.assert_allclose(outputs["Result.m"], 2 * U)
    np.testing.assert_allclose(outputs["Result.k"], 3 * V)


@pytest.mark.parametrize(
    ("selected", "expected"),
    [("a1,a2", [1, 2]), ("a(signal1),a (signal 2)", [1, 2]), ("a2,b", [2, 3]), ("a,b3", [1, 3])],
)
def test_duplicate_names_in_a_bus_get_port_numbers(selected, expected, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("BusCreator", "C", Inputs="3", ports=(3, 1))
    for at, name in enumerate("aab", 1):
        drawn.inport(f"u{at}")
        drawn.line(f"u{at}", f"C:{at}", name=name)
    drawn.block("BusSelector", "S", OutputSignals=selected, ports=(1, 2))
    drawn.line("C", "S")
    for at in (1, 2):
        drawn.outport(f"y{at}")
        drawn.line(f"S:{at}", f"y{at}")
    outputs = run(imported(drawn, tmp_path), {"u1": [1.0], "u2": [2.0], "u3": [3.0]})
    assert [outputs["y1"][0], outputs["y2"][0]] == expected


def test_an_unknown_element_of_a_bus_is_reported(tmp_path):
    model = drawn()
    model.blocks[4].system.blocks[0].parameters["Element"] = "speed"
    with pytest.raises(InputError, match="S/n: it selects speed, but the bus contains n, air"):
        imported(model, tmp_path)


def test_elements_that_leave_a_conditional_subsystem_are_refused(tmp_path):
    model = drawn(control=True)
    model.line("u", "S#enable")
    with pytest.raises(InputError, match="S/first: unsupported: an output of a conditional subsystem composed of bus"):
        imported(model, tmp_path)


def test_elements_at_a_subsystem_that_runs_several_times_are_refused(tmp_path):
    model = drawn()
    inner = model.blocks[4].system
    inner.block("ForIterator", "For", ports=(0, 1), IterationLimit="3")
    with pytest.raises(InputError, match="unsupported: a bus element port of an iterated subsystem"):
        imported(model, tmp_path)


def test_a_bus_at_a_block_that_takes_none_is_a_vector(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("BusCreator", "C", Inputs="2", ports=(2, 1))
    drawn.between(["a", "b"], "C")
    drawn.block("Gain", "G", ports=(1, 1), Gain="[2 3]")
    drawn.outport("y")
    drawn.chain("C", "G", "y")
    model = imported(drawn, tmp_path)
    outputs = run(model, {"a": [1.0, 2.0], "b": [5.0, 7.0]})
    assert (outputs["y[1]"].tolist(), outputs["y[2]"].tolist()) == ([2.0, 4.0], [15.0, 21.0])
    assert any("G takes the bus at its input 1 as a vector" in str(remark) for remark in model.remarks)


def test_a_bus_of_buses_cannot_be_a_vector(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("BusCreator", "C", Inputs="2", ports=(2, 1))
    drawn.between(["a", "b"], "C")
    drawn.block("BusCreator", "D", Inputs="2", ports=(2, 1))
    drawn.line("C", "D:1", name="inner")
    drawn.line("a", "D:2")
    drawn.block("Gain", "G", ports=(1, 1), Gain="2")
    drawn.outport("y")
    drawn.chain("D", "G", "y")
    with pytest.raises(InputError, match="its input 1 is a bus"):
        imported(drawn, tmp_path)


@pytest.mark.parametrize(("shape", "row"), [("[1 2]", True), ("[2 1]", False), ("2", False)])
def test_a_bus_with_a_row_is_a_row(shape, row, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("a")
    drawn.inport("b", PortDimensions=shape)
    drawn.block("BusCreator", "C", Inputs="2", ports=(2, 1))
    drawn.line("a", "C:1")
    drawn.line("b", "C:2")
    drawn.block("Constant", "K", ports=(0, 1), Value="[1; 10; 100]" if row else "[1 10 100]", VectorParams1D="off")
    drawn.block("Product", "P", ports=(2, 1), Multiplication="Matrix(*)", Inputs="2")
    drawn.line("K", "P:1")
    drawn.line("C", "P:2")
    drawn.outport("y")
    drawn.line("P", "y")
    outputs = run(imported(drawn, tmp_path), {"a": [2.0], "b[1]": [3.0], "b[2]": [5.0]})
    product = np.outer([1, 10, 100], [2, 3, 5]).ravel(order="F") if row else [532.0]
    names = [f"y[{k + 1}]" for k in range(9)] if row else ["y"]
    assert [outputs[name].item() for name in names] == list(product)
