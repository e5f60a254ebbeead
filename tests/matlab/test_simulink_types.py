"""Data types that scripts define: buses, aliases and fixed-point types."""

import numpy as np
import pytest

from kennfeld.matlab.script_runner import run_script
from kennfeld.matlab.values import text

BUSES = """
v = Simulink.BusElement; v.Name = 'v'; v.Dimensions = 3;
w = Simulink.BusElement; w.Name = 'w'; w.DataType = 'Bus: C';
B = Simulink.Bus; B.Elements = [v w];
C = Simulink.Bus; C.Elements(1) = Simulink.BusElement; C.Elements(1).Name = 'x'; C.Elements(1).Dimensions = [2 2];
"""


def variables(code, findings=0):
    result = run_script(code)
    assert len(result.findings) == findings, result.findings
    return result.variables


def elements(bus):
    return {
        text(part["Name"]): (part["Dimensions"].ravel().tolist(), text(part["DataType"]))
        for part in bus.fields["Elements"].elements.ravel()
    }


def test_elements_are_assigned_as_a_whole_one_by_one_and_by_property():
    names = variables(BUSES + "B.Elements(3) = Simulink.BusElement; B.Elements(3).name = 'z';")
    assert elements(names["B"]) == {"v": ([3], "double"), "w": ([1], "Bus: C"), "z": ([1], "double")}
    assert elements(names["C"]) == {"x": ([2, 2], "double")}


@pytest.mark.parametrize("description", ["", "'b.h', sprintf(''), ", "'b.h', '', 'Auto', '-1', '0', "])
def test_cells_define_buses_with_any_number_of_descriptions(description):
    code = f"Simulink.Bus.cellToObject({{{{'B', {description}{{{{'v', 3, 'single', -1, 'real', 'Sample'}}}}}}}});"
    assert elements(variables(code)["B"]) == {"v": ([3], "single")}


def test_the_long_form_of_an_element_has_limits_and_unit():
    element = "{'v', 1, 'double', -1, 'real', 'Sample', 'Fixed', 0, 9, 'K', 'd'}"
    fields = variables(f"Simulink.Bus.cellToObject({{{{'B', '', '', {{{element}}}}}}})")["B"].fields["Elements"].fields
    assert (fields["Min"].item(), fields["Max"].item(), text(fields["Unit"])) == (0, 9, "K")


@pytest.mark.parametrize("cells", ["3", "{3}", "{{'B'}}", "{{'B', {{'v', 1}}}}", ""])
def test_cells_of_another_form_are_reported(cells):
    result = run_script(f"K = 1;\nSimulink.Bus.cellToObject({cells});")
    assert [finding.location.line for finding in result.findings] == [2]
    assert list(result.variables) == ["K"]


def test_buses_of_functions_are_variables_of_the_base_workspace():
    code = "outer()\nfunction outer\ninner()\nend\nfunction inner\n{}\nend"
    cells = "Simulink.Bus.cellToObject({{'B', {{'v', 3, 'single'}}}});"
    assert elements(variables(code.format(cells))["B"]) == {"v": ([3], "single")}
    assert set(variables(code.format("assignin('base', 'K', 3);"))) == {"K"}
    # the variables of the caller end with it
    assert not variables(code.format("assignin('caller', 'K', 3);"))


def test_the_struct_of_a_bus_has_zeros_and_the_known_values():
    names = variables(BUSES + "S = Simulink.Bus.createMATLABStruct('B'); "
                      "T = Simulink.Bus.createMATLABStruct('B', struct('w', struct('x', [1 2; 3 4])));")  # fmt: skip
    assert names["S"].fields["v"].tolist() == [[0], [0], [0]]
    assert names["S"].fields["w"].fields["x"].tolist() == [[0, 0], [0, 0]]
    assert names["T"].fields["w"].fields["x"].tolist() == [[1, 2], [3, 4]]
    assert names["T"].fields["v"].tolist() == [[0], [0], [0]]


@pytest.mark.parametrize(
    ("code", "message"),
    [
        ("S = Simulink.Bus.createMATLABStruct('Q');", "the bus Q is not defined"),
        ("S = Simulink.Bus.createMATLABStruct('B', [], [2 1]);", "at most a struct of values are supported"),
        ("w.DataType = 'B'; B.Elements = w; S = Simulink.Bus.createMATLABStruct('B');", "contains itself"),
        ("v.Dimensions = 1e9; B.Elements = v; S = Simulink.Bus.createMATLABStruct('B');", "is too large"),
    ],
)
def test_a_struct_of_a_bus_that_cannot_be_made_is_reported(code, message):
    result = run_script(BUSES + code)
    assert message in result.findings[0].message
    assert "S" in result.undefined


@pytest.mark.parametrize(
    ("arguments", "expected"),
    [
        ("1, 16, 4", {"WordLength": 16, "FractionLength": 4}),
        ("0, 8, 0.5, 2", {"WordLength": 8, "Slope": 0.5, "Bias": 2}),
        ("1, 8, 1.5, -2, 1", {"WordLength": 8, "Slope": 0.375, "Bias": 1}),
        ("[], 8, 3, 'DataTypeOverride', 'Off'", {"WordLength": 8, "FractionLength": 3}),
    ],
)
def test_fixdt_is_an_object_of_a_numeric_type(arguments, expected):
    fields = variables(f"T = fixdt({arguments});")["T"].fields
    assert {name: fields[name].item() for name in expected} == pytest.approx(expected)
    signs = {"1": "Signed", "0": "Unsigned", "[": "Auto"}
    assert text(fields["Signedness"]) == signs[arguments[0]]


@pytest.mark.parametrize("arguments", ["1", "1, 200", "1, 2.5", "1, 8, [1 2]", "1, 8, 1, 2, 3, 4"])
def test_a_fixed_point_type_without_a_valid_size_is_reported(arguments):
    assert "fixdt" in run_script(f"T = fixdt({arguments});").findings[0].message


def test_an_alias_has_the_base_of_its_constructor_or_property():
    names = variables("A = Simulink.AliasType('int8'); B = Simulink.AliasType; B.BaseType = 'A'; C = fixdt('single');")
    assert [text(names[name].fields["BaseType"]) for name in "ABC"] == ["int8", "A", "single"]


def test_an_object_has_its_properties_in_any_case_but_a_struct_its_fields():
    names = variables("e = Simulink.BusElement; e.NAME = 'q'; s.a = 1; s.A = 2;")
    assert text(names["e"].fields["Name"]) == "q"
    assert {name: value.item() for name, value in names["s"].fields.items()} == {"a": 1, "A": 2}
    np.testing.assert_array_equal(names["e"].fields["Dimensions"], [[1.0]])
