"""Enumerations: members of classes as whole numbers, wherever a value may stand."""

import numpy as np
import pytest
from simulink_files import LAYOUTS, Model, zipped
from simulink_runs import alone, imported, run, switch_case

from kennfeld.errors import InputError
from kennfeld.models.simulink.importing import simulink
from kennfeld.models.simulink.variables.data_dictionary import read_dictionary
from kennfeld.models.simulink.variables.m_files import enumeration_of

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


def test_a_class_file_beside_the_model_is_found_where_a_block_names_it(tmp_path):
    class_file(tmp_path)
    drawn = constant("EnumeratedConstant", "Gear.Second", OutDataTypeStr="Enum: Gear")
    assert run(imported(drawn, tmp_path), samples=1)["y1"][0] == 2.0


def test_an_enumerated_constant_of_simulinks_library_is_a_member(tmp_path):
    drawn = Model(step="0.1", solver="FixedStepDiscrete")
    drawn.link("C", "simulink/Sources/Enumerated\nConstant", "Enumerated Constant", ports=(0, 1), Value="Gear.Second")
    drawn.outport("y")
    drawn.line("C", "y")
    assert run(imported(drawn, tmp_path, parameters=[script(tmp_path)]), samples=1)["y"][0] == 2.0


@pytest.mark.parametrize("layout", LAYOUTS)
def test_a_switch_case_knows_members(layout, tmp_path):
    drawn = switch_case("{Gear.First, [Gear.Second, Gear.Reverse]}", 1, 2, 3)
    found = run(imported(drawn, tmp_path, layout, parameters=[class_file(tmp_path)]), {"u": [1.0, 2.0, -1.0, 0.0]})
    assert found["y"].tolist() == [1, 2, 2, 3]


@pytest.mark.parametrize(
    ("default", "expected"), [("Last data port", [1, 2, 2, 3, 3]), ("Additional data port", [1, 2, 2, 3, 4])]
)
def test_a_multiport_switch_takes_indices_that_are_members(default, expected, tmp_path):
    count = 4 if default.startswith("Add") else 3
    drawn = alone("MultiPortSwitch", count + 1, Inputs="3", DataPortOrder="Specify indices",
                  DataPortIndices="{Gear.First, [Gear.Second -1], 7}", DataPortForDefault=default)  # fmt: skip
    model = imported(drawn, tmp_path, parameters=[class_file(tmp_path)])
    ports = {f"u{at + 2}": np.full(5, at + 1.0) for at in range(count)}
    found = run(model, {"u1": [1.9, 2.0, -1.0, 7.0, 5.0], **ports})["y1"]
    assert found.tolist() == expected


def test_indices_and_ports_that_do_not_fit_are_told(tmp_path):
    drawn = alone("MultiPortSwitch", 3, DataPortOrder="Specify indices", DataPortIndices="{1,2,3}")
    with pytest.raises(InputError, match="2 data ports but 3 indices"):
        imported(drawn, tmp_path)
    drawn = alone("MultiPortSwitch", 3, DataPortOrder="Specify indices", DataPortIndices="{Lost.A,2}")
    with pytest.raises(InputError, match=r"variable Lost.A: undefined"):
        imported(drawn, tmp_path)


@pytest.mark.parametrize(
    ("value", "told"),
    [("Gear.Fifth", "Gear has no field Fifth; its fields are Reverse"), ("Lost.A", "Lost.A: undefined")],
)
def test_a_member_that_is_not_there_is_told(value, told, tmp_path):
    with pytest.raises(InputError, match=told):
        imported(constant(value=value), tmp_path, parameters=[class_file(tmp_path)])


def test_a_class_of_another_kind_is_told(tmp_path):
    path = tmp_path / "Thing.m"
    path.write_text("classdef Thing < handle\nproperties\nx\nend\nend\n")
    with pytest.raises(InputError, match=r"Thing.m: is a class, but not an enumeration of integers"):
        simulink(constant().write(tmp_path), parameters=[path])


def test_class_files_in_the_forms_that_are_written():
    assert enumeration_of(GEAR) == ("Gear", {name: float(value) for name, value in MEMBERS.items()})
    short = "classdef (Enumeration) On < int32\n  enumeration\n No(0) , Yes(1);\n  end\nend"
    assert enumeration_of(short) == ("On", {"No": 0.0, "Yes": 1.0})
    several = "classdef A < uint8\nenumeration\nB(1)\nend\nenumeration\nC(2)\nend\nend"
    assert enumeration_of(several) == ("A", {"B": 1.0, "C": 2.0})
    assert enumeration_of("classdef A < Simulink.IntEnumType\nenumeration\nB(x)\nend\nend") is None
    assert enumeration_of("x = 3;") is None


def test_a_dictionary_keeps_the_members_of_its_enumerations(tmp_path):
    found = read_dictionary(dictionary(tmp_path))
    assert found.enumerations == {"Gear": {name: float(value) for name, value in MEMBERS.items()}}
    assert found.types == ("Gear",)
