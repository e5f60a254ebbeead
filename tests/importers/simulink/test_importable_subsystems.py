"""Subsystems of a model that can be imported by themselves."""

import numpy as np
import pytest

from kennfeld.cli import run as command
from kennfeld.graph import builder
from kennfeld.importers.simulink import importable_subsystems
from kennfeld.importers.simulink.importable_subsystems import inspect_simulink
from kennfeld.importers.simulink.importing import import_simulink, simulink
from kennfeld.importers.simulink.loaded_model import LoadedModel
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import run

U = np.linspace(-1, 1, 9)


def chain(system, *gains, unsupported=False):
    """Gains in a row from an inport to an outport."""
    system.inport("u")
    names = [f"K{at}" for at in range(len(gains))]
    for name, gain in zip(names, gains, strict=True):
        system.block("Gain", name, Gain=str(gain))
    if unsupported:
        system.block("S-Function", "Foreign", ports=(1, 1), FunctionName="foreign")
        names.append("Foreign")
    system.outport("y")
    system.chain("u", *names, "y")


def engine():
    """A model in which an S-function stands in one of three subsystems, beside a larger one that is whole."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    outer = drawn.subsystem("Outer")
    chain(outer, 2, unsupported=True)
    chain(outer.subsystem("Within"), 1, 2, 3, 4)
    chain(drawn.subsystem("Small"), 1)
    chain(drawn.subsystem("Middle"), "a", "b")
    drawn.inport("u")
    drawn.outport("y")
    drawn.chain("u", "Outer", "Small", "Middle", "y")
    return drawn


def test_the_largest_importable_subsystems_are_listed(tmp_path):
    path = engine().write(tmp_path)
    subsystems = inspect_simulink(path, parameters=[{"a": 3.0, "b": 2.0}]).subsystems
    assert [(one.path, one.blocks, one.inputs, one.outputs) for one in subsystems] == [
        ("Outer/Within", 6, ("u",), ("y",)),
        ("Middle", 4, ("u",), ("y",)),
    ]
    parameters = [{"a": 3.0, "b": 2.0}]
    np.testing.assert_allclose(run(simulink(path, "Middle", parameters), {"u": U})["y"], 6 * U)
    np.testing.assert_allclose(run(simulink(path, "Outer/Within"), {"u": U})["y"], 24 * U)


def test_a_subsystem_whose_variables_have_no_value_is_not_among_them(tmp_path):
    subsystems = inspect_simulink(engine().write(tmp_path)).subsystems
    assert [one.path for one in subsystems] == ["Outer/Within"]


def test_an_importable_model_lists_no_subsystems(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    chain(drawn, 1, 2)
    chain(drawn.subsystem("Part"), 1, 2)
    report = inspect_simulink(drawn.write(tmp_path))
    assert report.whole
    assert report.subsystems == ()


def test_the_command_shows_them(tmp_path, capsys):
    assert command(["info", str(engine().write(tmp_path))]) == 0
    shown = capsys.readouterr().out
    assert "can be imported by itself" in shown
    assert "Outer/Within" in shown


def test_the_search_builds_each_block_a_few_times_at_most(tmp_path, monkeypatch):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("S-Function", "Foreign", ports=(1, 1), FunctionName="foreign")
    drawn.outport("y")
    drawn.chain("u", "Foreign", "y")
    here = drawn
    for level in range(40):  # each level has a loop of its own, so that none is whole
        here = here.subsystem(f"Level{level}")
        chain(here, *[1] * 8)
        here.block("Gain", "Loop")
        here.outport("z")
        here.chain("Loop", "Loop", "z")
    built = []
    flat = LoadedModel.flat

    def counted(self, *args):
        flattened = flat(self, *args)
        built.append(len(flattened.blocks))
        return flattened

    monkeypatch.setattr(LoadedModel, "flat", counted)
    report = inspect_simulink(drawn.write(tmp_path))
    assert report.subsystems == ()
    assert sum(built) < 10 * report.total


@pytest.mark.parametrize("kind", ["EnablePort", "TriggerPort"])
def test_a_conditional_subsystem_can_be_among_them(kind, tmp_path):
    drawn = engine()
    inner = drawn.subsystem("Sometimes")
    chain(inner, 5, 6)
    inner.block(kind, "P")
    path = drawn.write(tmp_path)
    assert "Sometimes" in [one.path for one in inspect_simulink(path).subsystems]
    np.testing.assert_allclose(run(simulink(path, "Sometimes"), {"u": U})["y"], 30 * U)


def test_the_search_can_begin_at_a_subsystem(tmp_path):
    report = inspect_simulink(engine().write(tmp_path), "Outer")
    assert [one.path for one in report.subsystems] == ["Outer/Within"]


def large(count=3):
    """A model of subsystems of ten gains each, one after the other, over ten elements."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u", PortDimensions="10")
    names = [f"S{at}" for at in range(count)]
    for number, name in enumerate(names, 2):
        inner = drawn.subsystem(name)
        chain(inner, *[f"{number}.{at}" for at in range(1, 11)])
        inner.blocks[0].parameters["PortDimensions"] = "10"
    drawn.outport("y")
    drawn.chain("u", *names, "y")
    return drawn


def test_subsystems_of_a_too_large_model_are_listed_nevertheless(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(builder, "_MAX_NODES", 250)
    path = large().write(tmp_path)
    report = inspect_simulink(path)
    assert not report.whole
    assert [one.message for one in report.findings] == [
        "the blocks up to here require more than 250 operations per step"
    ]
    assert [one.path for one in report.subsystems] == ["S0", "S1", "S2"]
    assert command(["info", str(path)]) == 0
    shown = capsys.readouterr().out
    assert "require more than 250 operations" in shown
    assert "S2" in shown


def test_a_search_that_ends_early_is_reported(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(builder, "_MAX_NODES", 500)
    monkeypatch.setattr(importable_subsystems, "_MAX_OPERATIONS", 1000)
    monkeypatch.setattr(importable_subsystems, "_MIN_OPERATIONS", 100)
    path = large(8).write(tmp_path)
    report = inspect_simulink(path)
    assert 0 < len(report.subsystems) < 8
    assert "the search for importable subsystems reached its limit" in str(report.remarks[-1])
    assert command(["info", str(path)]) == 0
    assert "reached its limit" in capsys.readouterr().out


def test_a_solver_that_needs_too_many_operations_stops_the_whole_alone(tmp_path, monkeypatch):
    drawn = Model(step="0.1", solver="ode5")
    drawn.inport("u", PortDimensions="20")
    drawn.block("Integrator", "I")
    drawn.outport("y")
    drawn.chain("u", "I", "y")
    chain(drawn.subsystem("Part"), 2, 3)
    path = drawn.write(tmp_path)
    assert inspect_simulink(path).whole
    monkeypatch.setattr(builder, "_MAX_NODES", 200)
    report = inspect_simulink(path)
    assert not report.whole
    assert [one.path for one in report.subsystems] == ["Part"]


def test_the_command_explains_why_a_script_gives_a_variable_no_value(tmp_path, capsys):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    chain(drawn, "k")
    (tmp_path / "init.m").write_text("k = sqrt(nowhere);")
    assert command(["info", str(drawn.write(tmp_path)), "--parameters", str(tmp_path / "init.m")]) == 0
    assert "init.m line 1" in capsys.readouterr().out


def test_plots_in_a_script_concern_no_user_who_calibrates(tmp_path):
    (tmp_path / "init.m").write_text("Slope = 3;\nplot(1:3);\n")
    model = Model("line")
    model.inport("u")
    model.block("Gain", "Times", Gain="Slope")
    model.outport("y")
    model.chain("u", "Times", "y")
    report = import_simulink(model.write(tmp_path), parameters=[tmp_path / "init.m"]).report
    assert [remark for remark in report.remarks if "plot" in str(remark)]
    assert report.notes == ()
