"""Data stores, delays that change, scripts, and other things that go beyond a single block."""

from dataclasses import replace

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.domain.parameter_set import ParameterSet
from kennfeld.domain.parameters import Scalar
from kennfeld.importers.simulink.blocks import continuous
from kennfeld.importers.simulink.flattening.flat_model import DataStoreOrder, FlatBlock
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.reader.document import read_document
from kennfeld.importers.simulink.reader.model_tree import StoredWorkspace
from kennfeld.importers.simulink.variables.model_variables import collect_variables
from kennfeld.models.formula import formula
from kennfeld.models.formula.printer import to_text
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_data import sldd
from tests.importers.simulink.simulink_files import LAYOUTS, Mask, Model
from tests.importers.simulink.simulink_runs import alone, imported, run
from tests.importers.simulink.torque_drawing import TORQUE, torque

U = np.random.default_rng(5).normal(size=30)


def store(reader, writer):
    """A counter through a data store, read outside of the subsystem that writes it; priorities as given."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="total", InitialValue="start")
    inner = drawn.subsystem("Add", **({"Priority": writer} if writer else {}))
    inner.inport("x")
    inner.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="total", Priority="1")
    inner.block("Sum", "S", ports=(2, 1))
    inner.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="total", Priority="2")
    inner.line("x", "S:1")
    inner.line("R", "S:2")
    inner.chain("S", "W")
    drawn.line("u", "Add")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="total", **({"Priority": reader} if reader else {}))
    drawn.outport("y")
    drawn.chain("R", "y")
    return drawn


@pytest.mark.parametrize(("reader", "writer", "late"), [("2", "1", 0), ("1", "2", 1), ("", "", 1), ("-1", "3", 1)])
def test_priorities_decide_whether_a_data_store_is_read_before_it_is_written(reader, writer, late, tmp_path):
    output = run(imported(store(reader, writer), tmp_path, parameters=[{"start": 2.0}]), {"u": U})["y"]
    expected = np.concatenate([[2.0], 2 + np.cumsum(U)])
    np.testing.assert_allclose(output, expected[1:] if late == 0 else expected[:-1])


def test_an_order_that_no_priority_decides_is_reported(tmp_path):
    report = import_simulink(store("", "").write(tmp_path), parameters=[{"start": 2.0}]).report
    assert any("data store" in one and "R" in one for one in report.substitutions)
    assert any("Assign a Priority to both" in str(one) for one in report.notes)


def several_writers(priorities):
    """Writers of one data store in the order of the file, each of its own input; the output shows the last one."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="s")
    for name, priority in priorities.items():
        drawn.inport(f"u{name}")
        setting = {"Priority": priority} if priority else {}
        drawn.block("DataStoreWrite", name, ports=(1, 0), DataStoreName="s", **setting)
        drawn.line(f"u{name}", name)
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="s")
    drawn.outport("y")
    drawn.line("R", "y")
    return drawn


@pytest.mark.parametrize(
    ("priorities", "last", "undecided"),
    [
        ({"C": "2", "B": "", "A": "1"}, "C", {"BA", "BC"}),
        ({"A": "1", "B": "", "C": "2"}, "C", {"AB", "BC"}),
        ({"C": "2", "A": "1", "B": ""}, "B", {"AB", "CB"}),
        ({"C": "3", "B": "2", "A": "1"}, "C", set()),
        ({"C": "2", "B": "1", "A": "1"}, "C", {"BA"}),
        ({"A": "", "B": ""}, "B", {"AB"}),
    ],
)
def test_writers_run_in_the_order_of_their_priorities(priorities, last, undecided, tmp_path):
    imported_model = import_simulink(several_writers(priorities).write(tmp_path))
    inputs = {f"u{name}": [float(k)] * 2 for k, name in enumerate(priorities)}
    # a reader without a priority shows what the step before has left
    assert run(imported_model.model, inputs)["y"][1] == inputs[f"u{last}"][0]
    notes = [note for note in imported_model.report.substitutions if "writes the data store after" in note]
    assert {note.split(" writes")[0] + note.split(" after ")[1][0] for note in notes} == {
        pair[::-1] for pair in undecided
    }


@pytest.mark.parametrize("branches", [("If:1", "If:2"), ("If:1", "If:1")])
def test_writers_in_branches_that_exclude_each_other_need_no_order(branches, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="s")
    drawn.block("If", "If", ports=(1, 2), IfExpression="u1 > 0", ShowElse="on")
    drawn.line("u", "If")
    for name, branch in zip("AB", branches, strict=True):
        inner = drawn.subsystem(name)
        inner.block("ActionPort", "Action", ports=(0, 0))
        inner.block("Constant", "K", ports=(0, 1), Value="1" if name == "A" else "2")
        inner.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="s")
        inner.line("K", "W")
        drawn.line(branch, f"{name}#ifaction")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="s")
    drawn.outport("y")
    drawn.line("R", "y")
    notes = import_simulink(drawn.write(tmp_path)).report.substitutions
    assert any("writes the data store after" in note for note in notes) == (branches[0] == branches[1])


def test_tasks_that_contradict_priorities_leave_the_order_to_the_file():
    writers = [FlatBlock("DataStoreWrite", None, name, None) for name in "ABC"]
    memory = FlatBlock("DataStoreMemory", None, "M", None)
    for writer, priority in zip(writers, (3, 1, 2), strict=True):
        writer.data_store, writer.priority_path = memory, ((writer.path, priority),)
    a, b, c = writers
    # A is in a faster task than B, and the task of C is unknown: A, B, C, A
    order = DataStoreOrder(writers, lambda flat, other: {(a, b): -1, (b, a): 1}.get((flat, other), 0))
    assert order.writers[memory] == [a, b, c]
    assert order.undecided_writers == [(a, c)]


def tasks(reader, writer, mode, priorities):
    """A data store that one sample time writes and another one reads, both in steps of 0.1 s."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.solver["SolverMode"] = mode
    drawn.inport("u")
    drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="s", InitialValue="5")
    drawn.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="s", SampleTime=str(writer / 10),
                Priority=priorities[1])  # fmt: skip
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="s", SampleTime=str(reader / 10),
                Priority=priorities[0])  # fmt: skip
    drawn.outport("y")
    drawn.line("u", "W")
    drawn.line("R", "y")
    return drawn


def in_order(reader, writer, first):
    """Return the values that are read if one of the two runs first in each step."""
    stored, shown, read = 5.0, 5.0, []
    for k, value in enumerate(U):
        for who in ("reader", "writer") if first == "reader" else ("writer", "reader"):
            if who == "reader" and k % reader == 0:
                shown = stored
            elif who == "writer" and k % writer == 0:
                stored = value
        read.append(shown)
    return read


@pytest.mark.parametrize(
    ("reader", "writer", "mode", "priorities", "first"),
    [
        (2, 3, "MultiTasking", ("2", "1"), "reader"),
        (3, 2, "MultiTasking", ("1", "2"), "writer"),
        (3, 1, "Auto", ("1", "2"), "writer"),
        (2, 2, "MultiTasking", ("2", "1"), "writer"),
        (2, 3, "SingleTasking", ("2", "1"), "writer"),
        (3, 2, "SingleTasking", ("1", "2"), "reader"),
    ],
)
def test_the_faster_of_two_tasks_comes_first_whatever_the_priorities(reader, writer, mode, priorities, first, tmp_path):
    model = imported(tasks(reader, writer, mode, priorities), tmp_path)
    np.testing.assert_allclose(run(model, {"u": U})["y"], in_order(reader, writer, first))


SIGNAL = "A = Simulink.Signal; A.InitialValue = 'start*2'; A.Dimensions = 1; start = 3;"


def signal_entry(initial):
    element = f'<P Name="InitialValue" Class="char">{initial}</P><P Name="Dimensions" Class="double">1</P>'
    return f'<P Name="Value"><Element Class="Simulink.Signal">{element}</Element></P>'


@pytest.mark.parametrize("source", ["script", "dictionary", "workspace"])
def test_a_signal_object_declares_a_data_store(source, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete", code=SIGNAL if source == "workspace" else "")
    drawn.inport("u")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="A", Priority="1")
    inner = drawn.subsystem("S", Priority="2")
    inner.inport("u")
    inner.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="A")
    inner.line("u", "W")
    drawn.outport("y")
    drawn.line("u", "S")
    drawn.line("R", "y")
    (tmp_path / "init.m").write_text(SIGNAL)
    (tmp_path / "data.sldd").write_bytes(sldd({"A": signal_entry("2*start")}))
    sources = {"script": [tmp_path / "init.m"], "dictionary": [tmp_path / "data.sldd", {"start": 3.0}], "workspace": []}
    model = imported(drawn, tmp_path, parameters=sources[source])
    assert run(model, {"u": [1.0, 2.0, 3.0]})["y"].tolist() == [6, 1, 2]
    assert list(model.graph.parameters) == ["start"]


def counting(name, code="", factor="1"):
    """A model that writes a multiple of its input to the store A, and returns what it was before."""
    drawn = Model(name, step="0.1", solver="FixedStepDiscrete", code=code)
    drawn.inport("x")
    drawn.block("Gain", "G", Gain=factor)
    drawn.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="A", Priority="2")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="A", Priority="1")
    drawn.outport("y")
    drawn.chain("x", "G", "W")
    drawn.chain("R", "y")
    return drawn


def referring(*names, code="", initial=""):
    """A model around referenced models of these names, perhaps with a block of the store A."""
    drawn = Model("top", step="0.1", solver="FixedStepDiscrete", code=code)
    drawn.inport("u")
    if initial:
        drawn.block("DataStoreMemory", "M", ports=(0, 0), DataStoreName="A", InitialValue=initial)
    for k, name in enumerate(names, 1):
        drawn.block("ModelReference", f"R{k}", ports=(1, 1), ModelNameDialog=name)
        drawn.outport(f"y{k}")
        drawn.chain("u", f"R{k}", f"y{k}")
    return drawn


def signal_of(initial):
    return f"A = Simulink.Signal; A.InitialValue = '{initial}'; A.Dimensions = 1;"


@pytest.mark.parametrize(
    ("own", "names", "top", "expected"),
    [
        ({"one": signal_of(7), "two": signal_of(8)}, ("one", "two"), {}, [[7, 1, 2], [8, 2, 4]]),
        ({"one": signal_of(7)}, ("one", "one"), {}, [[7, 1, 2], [7, 1, 2]]),
        ({"one": signal_of(9), "two": ""}, ("one", "two"), {"given": signal_of(9)}, [[9, 1, 2], [9, 2, 4]]),
        ({"one": signal_of(7), "two": signal_of(8)}, ("one", "two"), {"initial": "5"}, [[7, 1, 2], [8, 2, 4]]),
        ({"one": "", "two": ""}, ("one", "two"), {"given": signal_of(9)}, [[9, 2, 4], [9, 2, 4]]),
        ({"one": "", "two": ""}, ("one", "two"), {"code": signal_of(9)}, [[9, 2, 4], [9, 2, 4]]),
        ({"one": "", "two": ""}, ("one", "two"), {"initial": "5"}, [[5, 2, 4], [5, 2, 4]]),
    ],
)
def test_a_store_of_a_model_workspace_is_local_to_each_instance_of_its_model(own, names, top, expected, tmp_path):
    for factor, (name, code) in enumerate(own.items(), 1):
        counting(name, code, str(factor)).write(tmp_path)
    (tmp_path / "given.m").write_text(top.pop("given", ""))
    model = imported(referring(*names, **top), tmp_path, parameters=[tmp_path / "given.m"])
    outputs = run(model, {"u": [1.0, 2.0, 3.0]})
    assert [outputs[f"y{k}"].tolist() for k in (1, 2)] == expected


@pytest.mark.parametrize("kind", ["m-code", "file"])
def test_variables_of_a_workspace_are_local_even_if_they_equal_given_ones(kind, tmp_path):
    for file in ("given.m", "own.m"):
        (tmp_path / file).write_text(f"{signal_of(7)} {'k = 2;' if file == 'given.m' else ''}")
    text = signal_of(7) if kind == "m-code" else "own.m"
    document = replace(read_document(counting("one").write(tmp_path)), workspace=StoredWorkspace(kind, text=text))
    variables = collect_variables(document, [tmp_path / "given.m"])
    assert {name: variables[name].local for name in ("A", "k")} == {"A": True, "k": False}


def test_a_data_store_of_a_signal_object_without_a_value_starts_at_0(tmp_path):
    drawn = alone("Gain")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="A")
    drawn.outport("z")
    drawn.line("R", "z")
    (tmp_path / "init.m").write_text("A = Simulink.Signal; A.Dimensions = [1 2];")
    outputs = run(imported(drawn, tmp_path, parameters=[tmp_path / "init.m"]), {"u1": [5.0]})
    assert [outputs["z[1]"][0], outputs["z[2]"][0]] == [0.0, 0.0]


def test_a_data_store_outside_of_the_model_that_is_only_read_is_an_input(tmp_path):
    drawn = alone("Gain", Gain="2")
    for at in range(2):
        drawn.block("DataStoreRead", f"R{at}", ports=(0, 1), DataStoreName="outside")
        drawn.outport(f"z{at}")
        drawn.line(f"R{at}", f"z{at}")
    model = imported(drawn, tmp_path)
    assert model.graph.inputs == ("u1", "outside")
    outputs = run(model, {"u1": [1.0, 1.0], "outside": [3.0, 4.0]})
    assert outputs["z0"].tolist() == outputs["z1"].tolist() == [3.0, 4.0]
    assert "R0 reads the data store outside, which is not in the model: it is the input outside" in map(
        str, model.remarks
    )


def test_a_data_store_without_a_memory_that_is_written_is_reported(tmp_path):
    drawn = alone("Gain")
    drawn.block("DataStoreRead", "R", ports=(0, 1), DataStoreName="lost")
    drawn.block("DataStoreWrite", "W", ports=(1, 0), DataStoreName="lost")
    drawn.outport("z")
    drawn.line("R", "z")
    drawn.line("B", "W")
    with pytest.raises(InputError, match="data store lost not found"):
        imported(drawn, tmp_path)


def delayed(kind, longest, **more):
    return alone("VariableTransportDelay", 2, VariableDelayType=kind, MaximumDelay=longest, InitialOutput="-5", **more)


def test_a_variable_time_delay_looks_back_by_its_second_input(tmp_path):
    time = np.linspace(0.1, 0.55, 30)
    output = run(imported(delayed("Variable time delay", "1"), tmp_path), {"u1": U, "u2": time})["y1"]
    t = 0.1 * np.arange(30)
    expected = np.where(t - time < 1e-9, -5.0, np.interp(t - time, t, U))
    np.testing.assert_allclose(output, expected, atol=1e-12)


@pytest.mark.parametrize("zero", ["off", "on"])
def test_a_time_delay_of_less_than_a_step_goes_on_as_a_line_or_looks_at_its_input(zero, tmp_path):
    time = np.tile([0.0, 0.02, 0.07, -0.3, 0.1], 6)
    output = run(imported(delayed("Variable time delay", "1", ZeroDelay=zero), tmp_path), {"u1": U, "u2": time})["y1"]
    share = np.maximum(time, 0.0) / 0.1
    assert output[0] == (U[0] if zero == "on" else -5.0)
    for k in range(2, 30):
        newest, before = (U[k], U[k - 1]) if zero == "on" else (U[k - 1], U[k - 2])
        ahead = 0.0 if zero == "on" else 1.0
        assert output[k] == pytest.approx(newest + (share[k] - ahead) * (before - newest), abs=1e-12), k


def test_a_transport_delay_is_a_pipe_that_takes_its_time(tmp_path):
    model = imported(delayed("Variable transport delay", "2"), tmp_path)
    t = 0.1 * np.arange(30)
    even = run(model, {"u1": U, "u2": np.full(30, 0.4)})["y1"]
    np.testing.assert_allclose(even[4:], U[:-4], atol=1e-9)
    assert set(even[:4]) == {-5.0}
    slowing = 0.5 + 0.2 * t
    output = run(model, {"u1": t, "u2": slowing})["y1"]
    # the way covered is 5 log((0.5 + 0.2 t) / 0.5); one pipe back the time was ...
    entered = ((0.5 + 0.2 * t) * np.exp(-0.2) - 0.5) / 0.2
    np.testing.assert_allclose(output[entered > 0], entered[entered > 0], atol=2e-3)
    assert set(output[entered < 0]) == {-5.0}


@pytest.mark.parametrize("kind", ["Variable time delay", "Variable transport delay"])
def test_a_delay_beyond_the_most_steps_is_unknown(kind, tmp_path, monkeypatch):
    monkeypatch.setattr(continuous, "_MAX_STATES", 5)
    model = imported(delayed(kind, "0.9"), tmp_path)
    (remark,) = [str(remark) for remark in model.remarks if "MaximumDelay" in str(remark)]
    assert "B is NaN while its delay exceeds 0.5 s: its MaximumDelay of 0.9 s is 9 steps" in remark
    whole = imported(delayed(kind, "0.4"), tmp_path)
    for time in (0.3, 0.8):
        columns = {"u1": U, "u2": np.full(30, time)}
        output, at = run(model, columns)["y1"], round(10 * time)
        np.testing.assert_array_equal(output[:at], -5.0)
        if time == 0.3:
            np.testing.assert_array_equal(output, run(whole, columns)["y1"])
        else:
            assert np.isnan(output[at + 1 :]).all()


def test_a_shorter_delay_needs_fewer_states(tmp_path):
    model = imported(delayed("Variable time delay", "900"), tmp_path, parameters=[{"B:MaximumDelay": 0.5}])
    assert len(model.graph.states) == 5


@pytest.mark.parametrize("kind", ["Variable time delay", "Variable transport delay"])
def test_a_delay_that_is_limited_needs_states_up_to_its_limit_only(kind, tmp_path):
    outputs = {}
    for longest in ("900", "2"):
        drawn = Model(step="0.1", solver="FixedStepDiscrete")
        drawn.block("VariableTransportDelay", "B", ports=(2, 1), VariableDelayType=kind, MaximumDelay=longest)
        drawn.block("Saturate", "S", LowerLimit="0.15", UpperLimit="0.35" if longest == "900" else "inf")
        drawn.between(["u1"], "B", ["y1"])
        drawn.inport("u2")
        drawn.chain("u2", "S")
        drawn.line("S", "B:2")
        model = imported(drawn, tmp_path)
        time = np.clip(0.3 * np.sin(np.arange(30)) + 0.2, None, 0.35)
        outputs[longest] = run(model, {"u1": U, "u2": time})["y1"]
        assert (len(model.graph.states) < 20) == (longest == "900")
    np.testing.assert_array_equal(outputs["900"], outputs["2"])


# where values come from


def test_scripts_give_values_units_and_comments(tmp_path):
    script = (
        "T = 0.5; % time constant\nK = Simulink.Parameter;\nK.Value = 2*T;\nK.Min = 0;\nK.Max = 7;\nK.Unit = 'Nm';\n"
    )
    (tmp_path / "init.m").write_text(script + "map.x = [0 1 2];\nmap.z = map.x.^2;\nfigure(1)\n")
    drawn = alone("Gain", Gain="K/T")
    drawn.block("Lookup_n-D", "L", ports=(1, 1), NumberOfTableDimensions="1", Table="map.z",
                BreakpointsForDimension1="map.x")  # fmt: skip
    drawn.outport("z")
    drawn.chain("u1", "L", "z")
    model = imported(drawn, tmp_path, parameters=[tmp_path / "init.m"])
    gain = model.values["K"]
    assert (gain.value, float(gain.lower), float(gain.upper), gain.unit) == (1.0, 0.0, 7.0, "Nm")
    assert model.values["T"].description == "time constant"
    outputs = run(model, {"u1": [1.5]})
    assert (outputs["y1"][0], outputs["z"][0]) == (3.0, 2.5)
    assert model.values["map.z"].axes[0].name == "map.x"


def test_the_code_of_callbacks_and_of_the_model_workspace_gives_values(tmp_path):
    callbacks = {"InitFcn": "a = 1; b = 10; c = 100;"}
    empty = Model(step="0.1", solver="FixedStepDiscrete", callbacks=callbacks, code="b = 20;")
    drawn = alone("Gain", Gain="a + b + c", model=empty)
    assert run(imported(drawn, tmp_path), {"u1": [1.0]})["y1"].tolist() == [121.0]
    calibration = ParameterSet([Scalar("c", 7.0)])
    assert run(imported(drawn, tmp_path, parameters=[calibration]), {"u1": [1.0]})["y1"].tolist() == [28.0]


def test_functions_of_whole_arrays_are_evaluated_as_numbers_with_a_remark(tmp_path):
    drawn = alone("Gain", Gain="interp1([0 1 2], [10 20 40], q)*max(cumsum([1 q]))")
    result = import_simulink(drawn.write(tmp_path), parameters=[{"q": 1.5}])
    assert run(result.model, {"u1": [1.0]})["y1"].tolist() == [75.0]
    assert list(result.report.frozen) == ["interp1([0 1 2], [10 20 40], q)*max(cumsum([1 q]))"]


def test_values_under_the_name_of_a_field_go_over_its_literal(tmp_path):
    drawn = alone("Gain", Gain="3")
    assert run(imported(drawn, tmp_path, parameters=[{"B:Gain": 4.0}]), {"u1": [1.0]})["y1"].tolist() == [4.0]
    model = imported(drawn, tmp_path, parameters=[ParameterSet([Scalar("B:Gain", 5.0)])], promote=["B:Gain"])
    assert model.values["B:Gain"].value == 5.0


# the whole model


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["slx json"]))
def test_the_torque_model_as_blocks_is_the_one_as_formula(layout, tmp_path):
    rng = np.random.default_rng(1)
    n, q, d = np.linspace(700, 6000, 6), np.linspace(10, 100, 5), np.linspace(-10, 50, 7)
    parameters = {"n": n, "q": q, "d": d, "CurveEtaDeltaSpark": np.cos(d / 60)}
    parameters |= {name: rng.normal(size=(6, 5)) for name in ("MapOptTorque", "MapOptIgnition", "MapDragTorque")}
    model = imported(torque(), tmp_path, layout, parameters=[parameters])
    written = formula(TORQUE)
    columns = {
        "Speed": rng.uniform(500, 6500, 50),
        "Rel_Airmass": rng.uniform(0, 110, 50),
        "Ignition": rng.uniform(-30, 30, 50),
    }
    outputs, expected = run(model, columns), run(written, columns, parameters=model.values)
    np.testing.assert_array_equal(outputs["TorquePredict"], expected["TorquePredict"])
    np.testing.assert_array_equal(outputs["trqOpt"], expected["trqOpt"])
    assert set(model.graph.nodes) == set(written.graph.nodes)
    assert model.graph.outputs == ("TorquePredict",)
    assert {"trqOpt", "dragTorque", "Engine/deltaSpark", "Engine/etaSpark"} <= set(model.graph.names)


def test_a_model_is_printed_as_formula_text_that_gives_the_same_graph(tmp_path):
    drawn = Model("osc", solver="ode3", step="0.05")
    drawn.inport("u in [Nm]")
    drawn.block("Sum", "S\nup/down", ports=(2, 1), Inputs="+-")
    drawn.block("Integrator", "V", ports=(1, 1), InitialCondition="v0")
    drawn.block("Gain", "D", Gain="d")
    drawn.outport("y 1")
    drawn.line("u in [Nm]", "S\nup/down:1")
    drawn.chain("S\nup/down", "V")
    drawn.line("V", "D", "y 1")
    drawn.line("D", "S\nup/down:2")
    model = imported(drawn, tmp_path, parameters=[{"v0": 1.0, "d": 0.5}])
    again = formula(to_text(model.graph, model.step))
    assert again.graph == model.graph
    assert again.step == 0.05


def test_ambiguous_names_are_distinguished(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("K")
    drawn.block("Gain", "y", Gain="K")
    drawn.outport("K")
    drawn.chain("K", "y")
    drawn.blocks[-1].name = "out"
    drawn.line("y", "out")
    drawn.blocks[-1].name = "t"
    drawn.wires[-1].ends[0] = ("t", "in", 1)
    model = imported(drawn, tmp_path, parameters=[{"K": 2.0}])
    assert model.graph.inputs == ("K_in",)
    assert run(model, {"K_in": [3.0]})[model.graph.outputs[0]].tolist() == [6.0]
    formula(to_text(model.graph))


@pytest.mark.slow
def test_a_long_chain_of_blocks_is_built(tmp_path):
    drawn = Model("long", step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    names = [f"G{at}" for at in range(1200)]
    for name in names:
        drawn.block("Gain", name, Gain="-1")
    drawn.outport("y")
    drawn.chain("u", *names, "y")
    model = imported(drawn, tmp_path)
    assert run(model, {"u": [1.5]})["y"].tolist() == [1.5]


@pytest.mark.parametrize(
    ("code", "gain", "exact"),
    [
        ("b = 2*a + 1;", 4.0, True),
        ("a = 2*a; b = a; b = b + 1; disp(b)", 4.0, True),
        ("if a > 1\n  b = 4;\nelse\n  b = 0;\nend", 4.0, False),
        ("b = 0;\nfor k = 1:3\n  b = b + k*a;\nend", 9.0, False),
        ("v(2) = 1; b = 2*a + 1;", 4.0, True),
        ("a = 2*a; v(1) = a; v(2) = 1; b = v(1);", 3.0, False),
        ("v(1) = a; b = v(1); v(1) = 9;", 1.5, False),
    ],
)
def test_masks_with_code_are_followed(code, gain, exact, tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.inport("u")
    inner = drawn.subsystem("S", mask=Mask({"a": "K"}, initialization=code))
    inner.inport("x")
    inner.block("Gain", "G", Gain="b")
    inner.outport("y")
    inner.chain("x", "G", "y")
    drawn.outport("y")
    drawn.chain("u", "S", "y")
    result = import_simulink(drawn.write(tmp_path), parameters=[{"K": 1.5}])
    assert run(result.model, {"u": [1.0]})["y"].tolist() == [gain]
    assert (list(result.model.graph.parameters) == ["K"]) == exact
    assert bool(result.report.frozen) != exact
