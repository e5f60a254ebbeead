"""Data dictionaries that are text: the same content as in the older format."""

import json

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.importing import import_simulink
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from tests.importers.simulink.simulink_files import Model
from tests.importers.simulink.simulink_runs import run


def objects(kind, *several, size=(1, 1)):
    """Objects of a class as an array."""
    elements = [{"_id": str(at), "_properties": one} for at, one in enumerate(several, 1)]
    return {"_array_class": kind, "_dimensions": list(size), "_elements": elements, "_mw_element_type": "MATLABArray"}


def inner(kind, **properties):
    """An object within another one."""
    return {"_id": "9", "_object_class": kind, "_properties": properties}


def structs(*several):
    return {"_array_type": "Struct", "_dimensions": [1, len(several)], "_elements": list(several)}


def written(entries, references=()):
    """The bytes of a dictionary."""
    listed = [{"name": name, "metadata": {"uuid": "x"}, "value": value} for name, value in entries.items()]
    content = {"entries": listed, "Dictionary References": list(references), "AllowAccessBWS": False}
    parts = {"__MW_TEXT_PART__/data/chunk0": {"__MW_TEXT_content": content}}
    return json.dumps({"__MW_TEXT_COREPROPERTIES__": {}, "__MW_TEXT_PARTS__": parts}, indent=1).encode()


ENTRIES = {
    "K": 2.5,
    "n": 3,
    "on": True,
    "name": "turbo",
    "string": ["word"],
    "row": [1, 2.5, 4],
    "empty": [],
    "A": {"_type": "double", "_value": "Matrix(2,3)\n[[1.0, 2.0, 3.0]; [4.0, 5.0, 6e-1]]"},
    "column": {"_type": "double", "_value": "Matrix(3,1)\n[1.0, -2.0, Inf]"},
    "u": {"_type": "uint16", "_value": "60000U"},
    "single": {"_type": "single", "_value": "2.5F"},
    "flags": {"_type": "logical", "_value": "[1, 0, 1]"},
    "S": structs({"a": 1, "b": structs({"c": [1, 2]})}),
    "Several": structs({"v": 1}, {"v": 2}),
    "Cell": {"_array_type": "Cell", "_dimensions": [1, 2], "_elements": [1, "two"]},
    "P": objects("Simulink.Parameter", {"Value": 9.81, "Min": 0, "Max": 100, "DocUnits": "m/s^2", "Description": "g"}),
    "T": objects(
        "Simulink.LookupTable",
        {
            "Table": inner("Simulink.lookuptable.Table", Value=[10, 20], Unit="Nm"),
            "Breakpoints": inner("Simulink.lookuptable.Breakpoint", Value=[700, 1500], Unit="rpm"),
        },
    ),
    "Gear": objects(
        "Simulink.data.dictionary.EnumTypeDefinition",
        {"Enumerals": structs({"Name": "Low", "Value": "1"}, {"Name": "High", "Value": "4"})},
    ),
    "Small": objects("Simulink.VariantExpression", {"Condition": "n == 3"}),
    "Settings": objects(
        "Simulink.ConfigSet",
        {"Components": inner("Simulink.SolverCC", SolverName="ode1", FixedStep="0.25", StopTime="10")},
    ),
    "z": {"_type": "cdata", "_value": "not told"},
}


@pytest.fixture
def path(tmp_path):
    dictionary = tmp_path / "data.sldd"
    dictionary.write_bytes(written(ENTRIES, ["further.sldd"]))
    (tmp_path / "further.sldd").write_bytes(written({"K": 7, "more": 8}))
    return dictionary


def test_values_are_those_of_the_text(path):
    values = {name: one.value for name, one in read_dictionary(path).data.entries.items()}
    numbers = {
        "K": [[2.5]], "n": [[3]], "on": [[1]], "row": [[1, 2.5, 4]], "A": [[1, 2, 3], [4, 5, 0.6]], "u": [[60000]],
        "column": [[1], [-2], [np.inf]], "single": [[2.5]], "flags": [[1, 0, 1]], "P": [[9.81]], "more": [[8]],
        "T": [[10, 20]],
    }  # fmt: skip
    for name, expected in numbers.items():
        np.testing.assert_array_equal(values[name], expected)
    assert (values["name"], values["string"]) == ("turbo", "word")
    assert values["empty"].size == 0
    assert values["S"]["b"]["c"].tolist() == [[1, 2]]
    assert [one["v"].item() for one in values["Several"]] == [1, 2]
    assert (values["Cell"][0].item(), values["Cell"][1]) == (1, "two")


def test_objects_have_limits_units_and_breakpoints(path):
    read = read_dictionary(path)
    P, T = read.data.entries["P"], read.data.entries["T"]
    assert (P.minimum, P.maximum, P.unit, P.description) == (0, 100, "m/s^2", "g")
    assert (T.unit, T.breakpoints[0].unit, T.breakpoints[0].value.tolist()) == ("Nm", "rpm", [[700, 1500]])
    assert read.enumerations == {"Gear": {"Low": 1.0, "High": 4.0}}
    assert (read.solvers["Settings"].name, read.solvers["Settings"].fixed_step) == ("ode1", "0.25")
    assert read.references == ("further.sldd",)
    assert set(read.data.unreadable) == {"z"}


def test_a_model_takes_values_enumerations_and_its_configuration_from_it(path, tmp_path):
    drawn = Model(solver="", step="", configuration="Settings", dictionary="data.sldd")
    drawn.inport("u")
    drawn.block("Gain", "G", Gain="K*Gear.High")
    drawn.block("Integrator", "I", ports=(1, 1))
    drawn.outport("y")
    drawn.chain("u", "G", "I", "y")
    result = import_simulink(drawn.write(tmp_path))
    assert (result.report.solver, result.report.step) == ("ode1", 0.25)
    np.testing.assert_allclose(run(result.model, {"u": np.ones(3)})["y"], [0, 2.5, 5.0])


@pytest.mark.parametrize(
    ("raw", "reason"),
    [
        (b'{"__MW_TEXT_PARTS__": 3}', "is not a data dictionary"),
        (b'{"__MW_TEXT_PARTS__": {"__MW_TEXT_PART__/data/chunk0": {}}}', "is not a data dictionary"),
        (b'{"__MW_TEXT_PARTS__": ', "is not a data dictionary"),
        (written({"a": 1})[:-20], "is not a data dictionary"),
        (b'{"__MW_TEXT_PARTS__": ' + b"[" * 200_000, "nested too deeply|no data dictionary"),
    ],
)
def test_broken_dictionaries_are_reported(raw, reason, tmp_path):
    path = tmp_path / "x.sldd"
    path.write_bytes(raw)
    with pytest.raises(InputError, match=reason):
        read_dictionary(path)


@pytest.mark.parametrize(
    ("value", "why"),
    [
        ({"_type": "double", "_value": "Matrix(2,2)\n[1, 2, 3]"}, "it has 3 numbers for a size of 2*2"),
        ({"_type": "double", "_value": "Matrix(999999999,999999999)\n[1]"}, "it has 1 numbers for a size"),
        ({"_type": "double", "_value": "nonsense"}, "its numbers cannot be read: nonsense"),
        ({"_type": "double", "_value": "abc 5"}, "its numbers cannot be read: abc 5"),
        ({"_type": "double", "_value": "1 + 2i"}, "it is complex"),
        ({"_type": "double", "_value": "Matrix(1,2)\n[[1 + 2i, 3]]"}, "it is complex"),
        ({"_array_type": "Sparse"}, "its class Sparse is unknown"),
        ({"_other": 1}, "is unknown"),
        ([1, {"b": 2}], "is unknown"),
    ],
)
def test_an_unreadable_value_is_reported_by_name(value, why, tmp_path):
    path = tmp_path / "x.sldd"
    path.write_bytes(written({"a": value, "b": 2}))
    data = read_dictionary(path).data
    assert data.entries["b"].value.item() == 2
    assert why in data.unreadable["a"]
    assert "a" not in data.entries


@pytest.mark.parametrize(
    ("value", "numbers"),
    [
        ({"_type": "double", "_value": "[1, -2.5e3, Inf]"}, [[1, -2500, np.inf]]),
        ({"_type": "int8", "_value": "Matrix(2,2)\n[[1, 2]; [3, 4]]"}, [[1, 2], [3, 4]]),
        ({"_type": "logical", "_value": "true"}, [[1]]),
        ({"_type": "logical", "_value": "Matrix(2,1)\n[[true]; [false]]"}, [[1], [0]]),
        ([1, 2.5], [[1, 2.5]]),
        ([True, False], [[1, 0]]),
    ],
)
def test_numbers_are_read_in_all_forms(value, numbers, tmp_path):
    path = tmp_path / "x.sldd"
    path.write_bytes(written({"a": value}))
    np.testing.assert_array_equal(read_dictionary(path).data.entries["a"].value, numbers)


def test_a_list_of_several_kinds_is_a_cell_array(tmp_path):
    path = tmp_path / "x.sldd"
    path.write_bytes(written({"a": [1, "two", [3, 4]], "b": 2}))
    entries = read_dictionary(path).data.entries
    first, second, third = entries["a"].value
    assert (first.item(), second, third.tolist(), entries["b"].value.item()) == (1, "two", [[3, 4]], 2)
