"""Components of ASCET 6, drawn as blocks: their methods calculate what the blocks say, and what the same ESDL says."""

from dataclasses import replace

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.calfiles import read, write
from kennfeld.importers.ascet.importing import classes_of, esdl, import_esdl
from kennfeld.models.formula import formula, to_text
from tests.importers.ascet.amd_files import (
    Component,
    Drawing,
    Item,
    Method,
    message,
    operators_module,
    parameter,
    write_archive,
    write_folder,
)
from tests.importers.ascet.component_samples import ELEMENTS, LOW_PASS, X, machine_component, plant_component
from tests.importers.ascet.esdl_projects import class_model, run

NUMBERS = np.random.default_rng(3)
A, B, C = NUMBERS.normal(size=(3, 40)).round(1)
A[:3], B[:3] = [1.0, 2.0, 0.0], [1.0, 0.0, 0.0]
P, Q, R = NUMBERS.integers(0, 2, size=(3, 40)).astype(bool)


def calculated(folder, component, columns, **options):
    return run(esdl(write_archive(folder, component), **options), columns)


@pytest.mark.parametrize(
    ("kind", "count", "expected"),
    [
        ("+", 3, A + B + C),
        ("*", 3, A * B * C),
        ("-", 2, A - B),
        ("-", 1, -A),
        ("/", 2, np.where(B == 0.0, A, A / np.where(B == 0.0, 1.0, B))),
        ("max", 3, np.maximum(np.maximum(A, B), C)),
        ("min", 2, np.minimum(A, B)),
        ("abs", 1, np.abs(A)),
    ],
)
def test_operators_of_numbers(tmp_path, kind, count, expected):
    columns = dict(zip("abc"[:count], (A, B, C), strict=False))
    values = calculated(tmp_path, operators_module(kind, count), columns)
    np.testing.assert_allclose(values["y"], expected, rtol=1e-12)


@pytest.mark.parametrize(
    ("kind", "count", "expected"),
    [
        ("=", 2, A == B),
        ("!=", 2, A != B),
        ("<", 2, A < B),
        ("<=", 2, A <= B),
        (">", 2, A > B),
        (">=", 2, A >= B),
        ("bet", 3, (A >= B) & (A <= C)),
    ],
)
def test_comparisons(tmp_path, kind, count, expected):
    columns = dict(zip("abc"[:count], (A, B, C), strict=False))
    values = calculated(tmp_path, operators_module(kind, count, result="log"), columns)
    assert values["y"].astype(bool).tolist() == expected.tolist()


@pytest.mark.parametrize(("kind", "count", "expected"), [("&", 3, P & Q & R), ("|", 3, P | Q | R), ("not", 1, ~P)])
def test_operators_of_truth_values(tmp_path, kind, count, expected):
    columns = dict(zip("abc"[:count], (P, Q, R), strict=False))
    values = calculated(tmp_path, operators_module(kind, count, "log", "log"), columns)
    assert values["y"].astype(bool).tolist() == expected.tolist()


def test_a_multiplexer_takes_the_input_of_the_first_true_condition(tmp_path):
    drawing = Drawing()
    inputs = [drawing.element(name) for name in ("p", "q", "a", "b", "c")]
    chosen = drawing.switch("MUX", inputs[:2], default=inputs[2], _2=inputs[3], _1=inputs[4])
    drawing.write("y", chosen, ("calc", 1))
    elements = [message("p", basic="log"), message("q", basic="log"), *map(message, "abc"), message("y", "exported")]
    component = Component("Plant", elements, [Method("calc")], drawing)
    values = calculated(tmp_path, component, {"p": P, "q": Q, "a": A, "b": B, "c": C})
    assert values["y"].tolist() == np.where(P, C, np.where(Q, B, A)).tolist()


def test_a_case_operator_takes_the_input_of_a_number(tmp_path):
    drawing = Drawing()
    inputs = [drawing.element(name) for name in ("k", "a", "b", "c")]
    chosen = drawing.switch("Case", inputs[:1], _1=inputs[1], _2=inputs[2], default=inputs[3])
    drawing.write("y", chosen, ("calc", 1))
    elements = [message("k", basic="udisc"), *map(message, "abc"), message("y", "exported")]
    component = Component("Plant", elements, [Method("calc")], drawing)
    k = NUMBERS.integers(0, 4, 40)
    values = calculated(tmp_path, component, {"k": k, "a": A, "b": B, "c": C})
    assert values["y"].tolist() == np.select([k == 1, k == 2], [A, B], C).tolist()


def test_integers_are_limited_to_their_range_and_divided_towards_zero(tmp_path):
    drawing = Drawing()
    ratio = drawing.operator("/", drawing.element("k"), drawing.literal("2"))
    drawing.write("n", drawing.cast(ratio), ("calc", 1))
    elements = [message("k", basic="sdisc"), message("n", "exported", basic="sdisc", limits=(-2, 3))]
    values = calculated(tmp_path, Component("Plant", elements, [Method("calc")], drawing), {"k": [-7, -3, 3, 99]})
    assert values["n"].tolist() == [-2.0, -1.0, 1.0, 3.0]


# a class with tables, a filter and a condition, drawn and written

ESDL = """type Curve is table real -> real; type Map is table real, real -> real;
data interface Bus { real n = 0.0; real load = 0.0; real torque = 0.0; boolean high = false; }
class LowPass {
  real memory = 0.5; characteristic real T = 0.4; @dT real dT;
  initializer Slow() { T = 2.0; }
  public real calc(real x) { memory = memory + (x - memory) * (dT / T); return memory; }
}
class Plant {
  characteristic real gain = 1.5; characteristic real limit = 12.0;
  characteristic Curve curve[3] = { { 0.0, 10.0, 30.0 }, { 1.0, 3.0, 2.0 } };
  characteristic Map map[3][2] = { { 0.0, 10.0, 30.0 }, { 0.0, 1.0 }, { { 1.0, 2.0 }, { 2.0, 1.0 }, { 4.0, 7.0 } } };
  real count = 0.0;
  LowPass slow = LowPass.Slow(); LowPass fast;
  public void calc() {
    if (Bus.n > limit) { count = count + 1.0; Bus.high = true; }
    else { Bus.high = false; if (Bus.load > 0.5) { count = fast.calc(Bus.load); } }
    Bus.torque = slow.calc(gain * (curve.getAt(Bus.n) + map.getAt(Bus.n, Bus.load)));
  }
}"""
N, LOAD = np.linspace(-5.0, 40.0, 60), np.tile([0.2, 0.7, 1.4], 20)


def test_blocks_calculate_what_the_same_esdl_says(tmp_path):
    drawn = esdl(write_archive(tmp_path, plant_component(), LOW_PASS))
    written = class_model(tmp_path, ESDL, class_name="Plant")
    mine, its = (run(model, {"n": N, "load": LOAD}) for model in (drawn, written))
    assert set(drawn.graph.outputs) == set(written.graph.outputs) == {"torque", "high"}
    for name in ("torque", "high", "count", "slow.memory", "fast.memory"):
        np.testing.assert_array_equal(mine[name], its[name], err_msg=name)
    assert len(drawn.graph.nodes) == len(written.graph.nodes)
    assert np.ptp(mine["torque"]) > 1.0


def test_values_of_the_model_are_those_of_the_files(tmp_path):
    model = esdl(write_archive(tmp_path, plant_component(), LOW_PASS))
    names = ["gain", "limit", "curve", "map", "slow.T", "fast.T"]
    assert sorted(model.values) == sorted(names)
    assert model.values["map"].values.tolist() == [[1.0, 2.0], [2.0, 1.0], [4.0, 7.0]]
    assert [model.values[name].value for name in ("slow.T", "fast.T")] == [2.0, 0.4]
    gain = model.values["gain"]
    assert (float(gain.lower), float(gain.upper), gain.description) == (0.0, 10.0, "gain of all")
    assert model.graph.units["torque"] == "Nm"
    assert model.graph.units["n"] == "rpm"


def test_values_of_a_model_are_written_into_a_copy_of_its_archive(tmp_path):
    other = Component("Other", [parameter("limit", 1.0)])
    values = esdl(write_archive(tmp_path, plant_component(), other, LOW_PASS), "Plant").values
    write(values.with_parameters(values["limit"].with_values(7.0)), tmp_path / "copy.axl")
    again = read(tmp_path / "copy.axl")
    assert (again["Plant.limit"].value, again["Other.limit"].value) == (7.0, 1.0)


@pytest.mark.slow
def test_files_of_a_folder_are_those_of_an_archive(tmp_path):
    main = write_folder(tmp_path / "files", plant_component(), LOW_PASS)
    for path in (main, main.with_name("Plant.specification.amd")):
        mine = run(esdl(path), {"n": N, "load": LOAD})
        its = run(esdl(write_archive(tmp_path, plant_component(), LOW_PASS), "Plant"), {"n": N, "load": LOAD})
        np.testing.assert_array_equal(mine["torque"], its["torque"])


def test_the_text_of_a_method_is_esdl(tmp_path):
    text = "real z;\nz = n * gain;\nif (z > 3.0) { torque = z; } else { torque = curve.getAt(n); }"
    component = Component("Plant", ELEMENTS[:7], [Method("calc", text=text)], Drawing())
    values = calculated(tmp_path, component, {"n": N})
    expected = np.where(N * 1.5 > 3.0, N * 1.5, np.interp(N, X, [1.0, 3.0, 2.0]))
    np.testing.assert_allclose(values["torque"], expected)


def test_errors_in_the_text_of_a_method_are_reported_with_their_lines(tmp_path):
    component = Component("Plant", ELEMENTS[:7], [Method("calc", text="torque := n;\n")], Drawing())
    report = import_esdl(write_archive(tmp_path, component)).report
    assert "Plant.specification.amd line" in str(report.findings[0])
    assert "Plant.calc" in str(report.findings[0])


def test_what_is_searched_in_a_table_is_interpolated_later(tmp_path):
    drawing = Drawing()
    drawing.run("curve", "search", ("calc", 1), "oned", x=drawing.element("n"))
    drawing.write("torque", drawing.value_of("curve", "interpolate", "oned"), ("calc", 2))
    values = calculated(tmp_path, Component("Plant", ELEMENTS[:7], [Method("calc")], drawing), {"n": N})
    np.testing.assert_allclose(values["torque"], np.interp(N, X, [1.0, 3.0, 2.0]))


def test_elements_of_arrays_are_read_and_set(tmp_path):
    drawing = Drawing()
    drawing.run("v", "setAt", ("calc", 1), "array", setAt=drawing.element("n"), x=drawing.literal("1"))
    drawing.write("torque", drawing.value_of("v", "getAt", "array", x=drawing.element("k")), ("calc", 2))
    array = Item("v", model="array", value=[1.0, 2.0, 4.0])
    elements = [*ELEMENTS[:3], message("k", basic="udisc"), array]
    values = calculated(
        tmp_path, Component("Plant", elements, [Method("calc")], drawing), {"n": [9.0, 8.0, 7.0], "k": [0, 1, 5]}
    )
    assert values["torque"].tolist() == [1.0, 8.0, 4.0]


def test_elements_of_instances_are_set_and_read(tmp_path):
    drawing = Drawing()
    drawing.put("fast", "memory", drawing.element("n"), ("calc", 1))
    drawing.write("torque", drawing.member("fast", "memory"), ("calc", 2))
    path = write_archive(tmp_path, Component("Plant", ELEMENTS, [Method("calc")], drawing), LOW_PASS)
    assert run(esdl(path), {"n": [1.0, 2.0]})["torque"].tolist() == [1.0, 2.0]


def test_labels_are_those_of_the_enumeration_of_the_component(tmp_path):
    mode = Component("Mode", kind="ASCET_Enumeration", labels=("Off", "On"), folder="Lib")
    other = Component("Other", kind="ASCET_Enumeration", labels=("None", "Off"), folder="Lib")
    drawing = Drawing()
    drawing.write("high", drawing.operator("=", drawing.element("mode"), drawing.literal("On")), ("calc", 1))
    state = message("mode", "imported", basic="enumeration", reference="/Lib/Mode")
    high = message("high", "exported", basic="log")
    path = write_archive(tmp_path, Component("Plant", [state, high], [Method("calc")], drawing), mode, other)
    assert run(esdl(path), {"mode": [0, 1]})["high"].tolist() == [0.0, 1.0]


def test_messages_of_other_modules_are_known_by_their_names(tmp_path):
    drawing = Drawing()
    product = drawing.operator("*", drawing.element("gain"), drawing.element("n"))
    drawing.write("power", product, ("run", 1))
    elements = [message("n"), parameter("gain", None, scope="imported"), message("power", "exported")]
    user = Component("User", elements, [Method("run")], drawing)
    model = esdl(write_archive(tmp_path, user, plant_component(), LOW_PASS), "User")
    assert model.values["gain"].value == 1.5
    assert run(model, {"n": [2.0]})["power"].tolist() == [3.0]
    report = import_esdl(write_archive(tmp_path, user)).report
    assert "gain has no value in the files" in str(report.findings)


def test_a_step_runs_the_processes_of_several_modules_in_their_order(tmp_path):
    drawing = Drawing()
    product = drawing.operator("*", drawing.element("torque"), drawing.element("n"))
    drawing.write("power", product, ("run", 1))
    elements = [message("n"), message("torque"), message("power", "exported")]
    path = write_archive(tmp_path, Component("User", elements, [Method("run")], drawing), plant_component(), LOW_PASS)
    columns = {"n": N, "load": LOAD}
    torque = run(esdl(path, "Plant"), columns)["torque"]
    model = esdl(path, methods=["Plant.calc", "User.run"])
    assert "torque" not in model.graph.inputs
    np.testing.assert_array_equal(run(model, columns)["power"], torque * N)
    late = run(esdl(path, methods=["User.run", "Engine.Plant.calc"]), columns)["power"]
    np.testing.assert_array_equal(late, np.concatenate([[0.0], torque[:-1]]) * N)
    with pytest.raises(InputError, match="unknown method clac"):
        esdl(path, methods=["Plant.clac"])


def test_an_element_that_two_components_export_is_taken_from_the_first_with_a_warning(tmp_path):
    drawing = Drawing()
    drawing.write("power", drawing.element("gain"), ("run", 1))
    elements = [parameter("gain", None, scope="imported"), message("power", "exported")]
    user = Component("User", elements, [Method("run")], drawing)
    others = [Component(name, [parameter("gain", value, scope="exported")]) for name, value in (("A", 1.0), ("B", 2.0))]
    model = esdl(write_archive(tmp_path, user, *others), "User")
    assert model.values["gain"].value == 1.0
    assert any("gain is exported by Engine/A, Engine/B" in str(remark) for remark in model.remarks)


def test_a_state_machine_runs_the_methods_of_its_states(tmp_path):
    values = calculated(tmp_path, machine_component(), {"n": [0, 6, 4, 4, 2, 6]})
    assert values["torque"].tolist() == [0.0, 1.0, 11.0, 21.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("draw", "message_part"),
    [
        (lambda d: d.operator("tri", d.element("n")), "the operator tri"),
        (lambda d: d.operator("+", d.element("n"), None), "an input is not connected"),
        (lambda d: d.literal("Unknown"), "the literal 'Unknown'"),
        (lambda d: d.value_of("curve", "getAt", "oned"), "getAt"),
        (lambda d: d.value_of("slow", "other"), "the method other of slow"),
        (lambda d: d.element("missing"), "unknown name missing"),
    ],
)
def test_what_is_not_supported_is_reported_with_its_line(tmp_path, draw, message_part):
    drawing = Drawing()
    drawing.write("torque", draw(drawing), ("calc", 1))
    component = Component("Plant", ELEMENTS, [Method("calc")], drawing)
    result = import_esdl(write_archive(tmp_path, component, LOW_PASS))
    assert result.model is None
    text = str(result.report.findings[0])
    assert message_part in text
    assert "Plant.specification.amd line" in text


def test_a_loop_of_blocks_without_a_variable_is_reported(tmp_path):
    drawing = Drawing()
    port = drawing.operator("+", drawing.element("n"), 999)
    drawing.connect(port, 999)
    drawing.write("torque", port, ("calc", 1))
    report = import_esdl(write_archive(tmp_path, Component("Plant", ELEMENTS[:3], [Method("calc")], drawing))).report
    assert "form a loop" in str(report.findings[0])


def test_a_chain_that_doubles_its_size_with_each_block_is_refused(tmp_path):
    drawing = Drawing()
    port = drawing.element("n")
    for _ in range(60):
        port = drawing.operator("*", port, port)
    drawing.write("torque", port, ("calc", 1))
    report = import_esdl(write_archive(tmp_path, Component("Plant", ELEMENTS[:3], [Method("calc")], drawing))).report
    assert "an expression of more than" in str(report.findings[0])


def test_code_in_c_is_reported(tmp_path):
    component = Component("Plant", ELEMENTS[:3], [Method("calc")], code="int x;")
    report = import_esdl(write_archive(tmp_path, component)).report
    assert "Plant.calc is implemented in C" in str(report.findings[0])


def test_a_break_ends_the_method(tmp_path):
    drawing = Drawing()
    n = drawing.element("n")
    drawing.write("torque", drawing.operator("*", n, drawing.literal("2.0")), ("calc", 1))
    (then,) = drawing.control("IfThen", drawing.operator(">", n, drawing.literal("3")), ("calc", 2))
    drawing.control("Break", n, (then, 1))
    drawing.write("torque", n, ("calc", 3))
    values = calculated(tmp_path, Component("Plant", ELEMENTS[:3], [Method("calc")], drawing), {"n": [1.0, 5.0]})
    assert values["torque"].tolist() == [1.0, 10.0]


def test_a_loop_of_blocks_that_is_not_supported_is_reported(tmp_path):
    drawing = Drawing()
    drawing.control("While", drawing.element("n"), ("calc", 1))
    report = import_esdl(write_archive(tmp_path, Component("Plant", ELEMENTS[:3], [Method("calc")], drawing))).report
    assert "the control block While is not supported" in str(report.findings[0])


def test_the_history_of_a_state_without_inner_states_changes_nothing(tmp_path):
    component = machine_component()
    changed = replace(component, machine=component.machine.replace('history="false"', 'history="true"'))
    values = calculated(tmp_path, changed, {"n": [0, 6, 4, 4, 2, 6]})
    assert values["torque"].tolist() == [0.0, 1.0, 11.0, 21.0, 0.0, 1.0]


@pytest.mark.parametrize(
    ("old", "new", "part"),
    [
        ("<Actions>", "<DiagramElements/><Actions>", "states within states"),
        ("</State>", "</State><Junction/>", "the element Junction"),
        ('<Start graphicOID="101"/>', '<Start graphicOID="7"/>', "does not join two states"),
        ('<Condition><MethodAction methodName="is_high"/>', "<Condition>", "a condition of a transition"),
    ],
)
def test_state_machines_that_are_not_supported_are_reported(tmp_path, old, new, part):
    component = machine_component()
    assert old in component.machine
    changed = replace(component, machine=component.machine.replace(old, new, 1))
    result = import_esdl(write_archive(tmp_path, changed))
    assert result.model is None
    assert part in str(result.report.findings[0])


def test_a_connected_input_that_no_method_runs_is_remarked(tmp_path):
    component = plant_component()
    port = 990
    component.drawing.parts.append(
        f'<DiagramElement><SimpleElement graphicOID="991" elementName="count" type="Variable"><Interfaces>'
        f'<SelectorPort graphicOID="{port}"><SequenceCall graphicOID="992" sequenceNumber="0"/></SelectorPort>'
        "</Interfaces></SimpleElement></DiagramElement>"
    )
    component.drawing.connect(component.drawing.element("n"), port)
    model = esdl(write_archive(tmp_path, component, LOW_PASS))
    assert any("no method runs it" in str(remark) for remark in model.remarks)


def test_a_component_is_chosen_by_its_name_or_path(tmp_path):
    path = write_archive(tmp_path, plant_component(), plant_component(name="Second"), LOW_PASS)
    assert [item.name for item in classes_of(path)] == ["Plant", "Second", "LowPass"]
    assert esdl(path, "Engine/Second").graph.outputs == esdl(path, "Engine.Second").graph.outputs
    with pytest.raises(InputError, match="several components"):
        esdl(path)
    with pytest.raises(InputError, match="unknown class Secund"):
        esdl(path, "Secund")
    with pytest.raises(InputError, match="unknown method clac"):
        esdl(path, "Plant", ["clac"])


def test_a_model_becomes_formula_text(tmp_path):
    model = esdl(write_archive(tmp_path, plant_component(), LOW_PASS))
    again = formula(to_text(model.graph))
    mine, its = (run(own, {"n": N, "load": LOAD}, parameters=model.values) for own in (model, again))
    np.testing.assert_array_equal(mine["torque"], its["torque"])


@pytest.mark.parametrize(
    ("content", "part"),
    [
        (b"<ComponentMain", "not well-formed XML"),
        (b'<!DOCTYPE a [<!ENTITY x "y">]><ComponentMain>&x;</ComponentMain>', "declares the entity x"),
        (b"<ComponentMain/>", "declares no component"),
        (b"<a>" * 300 + b"</a>" * 300, "nested more than"),
    ],
)
def test_a_broken_file_gives_one_message(tmp_path, content, part):
    main = write_folder(tmp_path, plant_component(), LOW_PASS)
    main.write_bytes(content)
    with pytest.raises(InputError, match=part) as error:
        esdl(main)
    assert len(error.value.findings) == 1
    assert error.value.findings[0].location.file == "Plant.main.amd"


def test_an_archive_that_is_cut_off_gives_one_message(tmp_path):
    path = write_archive(tmp_path, plant_component(), LOW_PASS)
    path.write_bytes(path.read_bytes()[:-40])
    with pytest.raises(InputError, match="not a readable archive") as error:
        esdl(path)
    assert len(error.value.findings) == 1


def test_a_file_without_its_main_file_is_explained(tmp_path):
    main = write_folder(tmp_path, plant_component(), LOW_PASS)
    main.unlink()
    with pytest.raises(InputError, match=r"Plant\.main\.amd is missing"):
        esdl(main.with_name("Plant.specification.amd"))
