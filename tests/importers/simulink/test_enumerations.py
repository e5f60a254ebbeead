"""Enumerations: members of classes as whole numbers, wherever a value may stand."""

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink, simulink
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from kennfeld.matlab.enumerations import Enumeration, enumeration_of
from tests.draws import mostly_slow
from tests.importers.simulink.simulink_code import function
from tests.importers.simulink.simulink_data import sldd
from tests.importers.simulink.simulink_files import LAYOUTS, Chart, Mask, Model, zipped
from tests.importers.simulink.simulink_runs import alone, imported, run, switch_case

GEAR = """% the gears of the box
classdef Gear < Simulink.IntEnumType
    enumeration
        Reverse (-1)  % backwards
        Neutral(0), First(1)
        Second (int32(2))
    end
    methods (Static)
        function found = getDefaultValue()
            found = Gear.Neutral;
        end
    end
end
"""
MEMBERS = {"Reverse": -1, "Neutral": 0, "First": 1, "Second": 2}


def class_file(folder):
    (folder / "Gear.m").write_text(GEAR)
    return folder / "Gear.m"


def script(folder):
    (folder / "init.m").write_text(
        "Simulink.defineIntEnumType('Gear', {'Reverse', 'Neutral', 'First', 'Second'}, [-1 0 1 2], ...\n"
        "    'DefaultValue', 'Neutral');\nstart = Gear.Second + 1;\n"
    )
    return folder / "init.m"


def dictionary(folder, references=()):
    members = "".join(
        f'<Element><P Name="Name" Class="char">{name}</P><P Name="Value" Class="char">{value}</P>'
        '<P Name="Description" Class="char"/></Element>'
        for name, value in MEMBERS.items()
    )
    definition = (
        '<Object Class="DD.ENTRY"><P Name="Name" Class="char">Gear</P><P Name="Value">'
        '<Element Class="Simulink.data.dictionary.EnumTypeDefinition">'
        f'<P Name="Enumerals" Class="struct" Dimension="1*4">{members}</P></Element></P></Object>'
    )
    path = folder / "data.sldd"
    path.write_bytes(zipped({"data/chunk0.xml": f'<DataSource FormatVersion="1">{definition}</DataSource>'}))
    return path


def constant(kind="Constant", value="Gear.Second", **more):
    return alone(kind, 0, Value=value, **more)


@pytest.mark.parametrize("source", [class_file, script, dictionary])
@pytest.mark.parametrize(
    ("kind", "value", "number"),
    [
        ("Constant", "Gear.Second", 2),
        ("Constant", "Gear.Reverse * 3", -3),
        ("EnumeratedConstant", "Gear.First", 1),
        ("Constant", "double(Gear.Second) == 2", 1),
        ("Constant", "Gear(1)", 1),
        ("Constant", "sum([Gear.First Gear.Second])", 3),
        ("Constant", "interp1([1 2], [5 6], Gear.Second)", 6),
    ],
)
def test_a_member_is_its_whole_number_and_no_parameter(source, kind, value, number, tmp_path):
    model = imported(constant(kind, value), tmp_path, parameters=[source(tmp_path)])
    assert set(run(model, samples=3)["y1"]) == {float(number)}
    assert not model.graph.parameters


def test_a_script_computes_with_members(tmp_path):
    model = imported(constant(value="start"), tmp_path, parameters=[script(tmp_path)])
    assert run(model, samples=1)["y1"][0] == 3.0


def test_a_class_file_beside_the_model_is_read(tmp_path):
    class_file(tmp_path)
    drawn = constant("EnumeratedConstant", "Gear.Second", OutDataTypeStr="Enum: Gear")
    assert run(imported(drawn, tmp_path), samples=1)["y1"][0] == 2.0
    assert run(imported(constant(value="Gear.Second + Gear(2)"), tmp_path), samples=1)["y1"][0] == 4.0


def test_a_class_file_in_a_further_folder_is_read(tmp_path):
    (tmp_path / "types").mkdir()
    class_file(tmp_path / "types")
    assert run(imported(constant(), tmp_path, folders=[tmp_path / "types"]), samples=1)["y1"][0] == 2.0


@pytest.mark.parametrize(
    "code",
    [
        "function y = f(u)\nif u == Gear.Second\n y = 5;\nelse\n y = double(Gear.First);\nend\nend",
        "function y = f(u)\nswitch u\ncase Gear.Second\n y = 5;\notherwise\n y = 1;\nend\nend",
        "function y = f(u)\ny = 1 + 4*(Gear(u) == Gear.Second);\nend",
    ],
)
def test_a_matlab_function_knows_the_classes_beside_the_model(code, tmp_path):
    class_file(tmp_path)
    model = imported(function(code, ("u",)), tmp_path)
    assert run(model, {"u": [0.0, 2.0, 1.0]})["y1"].tolist() == [1.0, 5.0, 1.0]


@pytest.mark.parametrize(("language", "prefix"), [("C", "Gear."), ("C", ""), ("MATLAB", "Gear.")])
def test_a_chart_knows_the_classes_beside_the_model(language, prefix, tmp_path):
    class_file(tmp_path)
    chart = Chart(
        {"Slow": f"Slow\nen: y = {prefix}First;", "Fast": "Fast\nen: y = x + 1;"},
        [("", "Slow", ""), ("Slow", "Fast", f"[u == {prefix}Second]"), ("Fast", "Slow", f"[u == {prefix}Neutral]")],
        [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("x", "LOCAL_DATA", "Gear.Second")],
        language=language,
        types={"y": "Enum: Gear"},
    )
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.chart("C", chart)
    drawn.between(["u"], "C", ["y"])
    y = run(imported(drawn, tmp_path), {"u": [0.0, 2.0, 1.0, 0.0]})["y"]
    assert y.tolist() == [1.0, 3.0, 3.0, 1.0]


def test_a_member_without_its_class_must_be_unique(tmp_path):
    class_file(tmp_path)
    (tmp_path / "Lamp.m").write_text("classdef Lamp < int32\nenumeration\nFirst(7)\nend\nend")
    chart = Chart({"A": "A\nen: y = First;"}, [("", "A", "")], [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA")])
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.chart("C", chart)
    drawn.between(["u"], "C", ["y"])
    with pytest.raises(InputError, match="variable First: undefined"):
        imported(drawn, tmp_path)


def test_a_mask_and_its_code_compute_with_members(tmp_path):
    class_file(tmp_path)
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    code = "offset = double(gear) + 1; if gear == Gear.Second, more = 7; else, more = 8; end"
    inner = drawn.subsystem("S", mask=Mask({"gear": "Gear.Second"}, initialization=code))
    inner.block("Constant", "K", Value="100*gear + 10*offset + more")
    inner.outport("y")
    inner.line("K", "y")
    drawn.outport("y")
    drawn.line("S", "y")
    assert run(imported(drawn, tmp_path), samples=1)["y"][0] == 237.0


def test_a_script_computes_with_the_classes_beside_the_model(tmp_path):
    class_file(tmp_path)
    (tmp_path / "init.m").write_text("s.gear = Gear.Second;\nif Gear(2) == s.gear\nstart = s.gear + 1;\nend\n")
    model = imported(constant(value="start"), tmp_path, parameters=[tmp_path / "init.m"])
    assert run(model, samples=1)["y1"][0] == 3.0


def entries(folder, *values):
    """A dictionary with the entries a, b, ... of these values."""
    path = folder / "entries.sldd"
    path.write_bytes(sldd(dict(zip("abcdef", values, strict=False))))
    return path


@pytest.mark.parametrize(
    ("written", "number"),
    [
        ('<P Name="Value" IsEnum="1"><Element Class="Gear" EnumerationName="Second" EnumerationType="int32">2</Element>'
         "</P>", 2),
        ('<P Name="Value"><Element Class="Simulink.Parameter"><P Name="Value" IsEnum="1">'
         '<Element Class="Gear" EnumerationName="First" EnumerationType="int32">1</Element></P></Element></P>', 1),
        ('<P Name="Value" IsEnum="1"><Element Class="Gear" EnumerationName="Second"/></P>', 2),
        ('<P Name="Value" Class="Gear" IsEnum="1">2</P>', 2),
        ('<P Name="Value" Class="Gear" IsEnum="1">Second</P>', 2),
        ('<P Name="Value" Class="Gear">Gear.Reverse</P>', -1),
        ('<P Name="Value"><Element Class="Gear" IsEnum="1">Gear.Second</Element></P>', 2),
        ('<P Name="Value"><Element Class="Simulink.Parameter"><P Name="Value" Class="Gear" IsEnum="1">1</P>'
         '<P Name="DataType" Class="char">Enum: Gear</P></Element></P>', 1),
    ],
)  # fmt: skip
def test_an_enumerated_entry_of_a_dictionary_is_its_whole_number_and_no_parameter(written, number, tmp_path):
    class_file(tmp_path)
    model = imported(constant(value="a"), tmp_path, parameters=[entries(tmp_path, written)])
    assert run(model, samples=1)["y1"][0] == number
    assert not model.graph.parameters


def test_an_array_of_members_is_an_array_of_numbers(tmp_path):
    class_file(tmp_path)
    elements = "".join(f'<Element Class="Gear" EnumerationName="?">{number}</Element>' for number in (2, 1))
    texts = [f'<P Name="Value" IsEnum="1" Dimension="1*2">{elements}</P>',
             '<P Name="Value" Class="Gear" IsEnum="1" Dimension="1*2">First Second</P>']  # fmt: skip
    model = imported(constant(value="10*a + b"), tmp_path, parameters=[entries(tmp_path, *texts)])
    outputs = run(model, samples=1)
    assert [outputs["y1[1]"][0], outputs["y1[2]"][0]] == [21.0, 12.0]


@pytest.mark.parametrize(("kind", "remark"), [("Lost", "place Lost.m next to the model"), ("Gear", "no member Fifth")])
def test_an_entry_whose_member_is_unknown_is_reported(kind, remark, tmp_path):
    class_file(tmp_path)
    path = entries(tmp_path, f'<P Name="Value" Class="{kind}" IsEnum="1">Fifth</P>')
    report = import_simulink(constant(value="a").write(tmp_path), parameters=[path]).report
    assert any(remark in str(finding) for finding in report.remarks)


def test_an_enumerated_constant_of_simulinks_library_is_a_member(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("C", "simulink/Sources/Enumerated\nConstant", "Enumerated Constant", ports=(0, 1), Value="Gear.Second")
    drawn.outport("y")
    drawn.line("C", "y")
    assert run(imported(drawn, tmp_path, parameters=[script(tmp_path)]), samples=1)["y"][0] == 2.0


@pytest.mark.parametrize("layout", mostly_slow(LAYOUTS, ["mdl"]))
def test_a_switch_case_knows_members(layout, tmp_path):
    drawn = switch_case("{Gear.First, [Gear.Second, Gear.Reverse]}", 1, 2, 3)
    outputs = run(imported(drawn, tmp_path, layout, parameters=[class_file(tmp_path)]), {"u": [1.0, 2.0, -1.0, 0.0]})
    assert outputs["y"].tolist() == [1, 2, 2, 3]


@pytest.mark.parametrize(
    ("default", "expected"), [("Last data port", [1, 2, 2, 3, 3]), ("Additional data port", [1, 2, 2, 3, 4])]
)
def test_a_multiport_switch_takes_indices_that_are_members(default, expected, tmp_path):
    count = 4 if default.startswith("Add") else 3
    drawn = alone("MultiPortSwitch", count + 1, Inputs="3", DataPortOrder="Specify indices",
                  DataPortIndices="{Gear.First, [Gear.Second -1], 7}", DataPortForDefault=default)  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[class_file(tmp_path)])
    ports = {f"u{at + 2}": np.full(5, at + 1.0) for at in range(count)}
    output = run(model, {"u1": [1.9, 2.0, -1.0, 7.0, 5.0], **ports})["y1"]
    assert output.tolist() == expected


def test_indices_and_ports_that_do_not_match_are_reported(tmp_path):
    drawn = alone("MultiPortSwitch", 3, DataPortOrder="Specify indices", DataPortIndices="{1,2,3}")
    with pytest.raises(InputError, match="2 data ports but 3 indices"):
        imported(drawn, tmp_path)
    drawn = alone("MultiPortSwitch", 3, DataPortOrder="Specify indices", DataPortIndices="{Lost.A,2}")
    with pytest.raises(InputError, match=r"variable Lost.A: undefined"):
        imported(drawn, tmp_path)


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        (
            "Gear.Fifth",
            r"the enumeration Gear has no member Fifth; its members are Neutral, .* add the member to Gear\.m\.",
        ),
        ("Lost.A", "Lost.A: undefined"),
    ],
)
def test_a_missing_member_is_reported(value, reason, tmp_path):
    with pytest.raises(InputError, match=reason):
        imported(constant(value=value), tmp_path, parameters=[class_file(tmp_path)])


def test_a_class_of_another_kind_is_reported(tmp_path):
    path = tmp_path / "Thing.m"
    path.write_text("classdef Thing < handle\nproperties\nx\nend\nend\n")
    with pytest.raises(InputError, match=r"Thing.m: is a class, but not an enumeration of integers"):
        simulink(constant().write(tmp_path), parameters=[path])


def test_class_files_in_the_forms_that_are_written():
    gear = enumeration_of(GEAR)
    assert (gear.name, gear.members, gear.counted) == ("Gear", MEMBERS, False)
    assert next(iter(gear.members)) == "Neutral", "the default comes first"
    short = "classdef (Enumeration) On < int32\n  enumeration\n No(0) , Yes(1);\n  end\nend"
    assert enumeration_of(short) == Enumeration("On", {"No": 0.0, "Yes": 1.0})
    several = "classdef A < uint8\nenumeration\nB(1)\nend\nenumeration\nC(2)\nend\nend"
    assert enumeration_of(several) == Enumeration("A", {"B": 1.0, "C": 2.0})
    line = "classdef A < Simulink.IntEnumType\nenumeration, B(0x1F), C(2^3 - 1), end\nend"
    assert enumeration_of(line) == Enumeration("A", {"B": 31.0, "C": 7.0})
    assert enumeration_of("classdef A < Simulink.IntEnumType\nenumeration\nB(x)\nend\nend") is None
    assert enumeration_of("classdef A < Simulink.IntEnumType\nenumeration\nB(1), C\nend\nend") is None
    assert enumeration_of("x = 3;") is None


def lamp(chart, folder, columns):
    """The output y of a chart over u."""
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.chart("C", chart)
    drawn.between(["u"], "C", ["y"])
    result = import_simulink(drawn.write(folder))
    return run(result.model, columns)["y"].tolist(), [str(finding) for finding in result.report.remarks]


@pytest.mark.parametrize("initial", ["", "Blink", "Lamp.Blink"])
def test_a_class_without_numbers_is_counted_from_0_with_a_remark(initial, tmp_path):
    (tmp_path / "Lamp.m").write_text("classdef Lamp < Simulink.IntEnumType\nenumeration\nOff\nOn, Blink\nend\nend")
    chart = Chart(
        {"A": "A\nen: y = x;", "B": "B\nen: y = On;"},
        [("", "A", ""), ("A", "B", "[u == Blink]")],
        [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("x", "LOCAL_DATA", initial)],
        types={"x": "Enum: Lamp"},
    )
    outputs, remarks = lamp(chart, tmp_path, {"u": [0.0, 1.0, 2.0]})
    assert outputs == [2.0 if initial else 0.0] * 2 + [1.0]
    assert any("no numbers; they are counted from 0 (Off = 0, On = 1, Blink = 2)" in remark for remark in remarks)


def test_a_variable_without_an_initial_value_begins_with_the_default_of_its_class(tmp_path):
    (tmp_path / "Lamp.m").write_text("classdef Lamp < int32\nenumeration\nOn(3), Off(5)\nend\nend")
    class_file(tmp_path)
    chart = Chart(
        {"A": "A\nen: y = 10 * g + x;"},
        [("", "A", "")],
        [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA"), ("x", "LOCAL_DATA"), ("g", "LOCAL_DATA")],
        types={"x": "Enum: Lamp", "g": "Enum: Gear"},
    )
    # the first member of Lamp; the one that Gear.getDefaultValue returns
    assert lamp(chart, tmp_path, {"u": [0.0]})[0] == [3.0]


def test_a_member_without_its_class_is_one_of_a_type_that_the_chart_uses(tmp_path):
    (tmp_path / "Lamp.m").write_text("classdef Lamp < int32\nenumeration\nFirst(7)\nend\nend")
    class_file(tmp_path)
    for kind, number in (("Lamp", 7.0), ("Gear", 1.0)):
        chart = Chart({"A": "A\nen: y = First;"}, [("", "A", "")], [("u", "INPUT_DATA"), ("y", "OUTPUT_DATA")],
                      types={"y": f"Enum: {kind}"})  # fmt: skip
        assert lamp(chart, tmp_path, {"u": [0.0]})[0] == [number]


def test_a_dictionary_keeps_the_members_of_its_enumerations(tmp_path):
    contents = read_dictionary(dictionary(tmp_path))
    assert contents.enumerations == {"Gear": {name: float(value) for name, value in MEMBERS.items()}}
    assert contents.types == ("Gear",)
