import random
import zipfile

import numpy as np
import pytest
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from kennfeld.base.errors import InputError
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from tests.draws import few_or_many
from tests.importers.simulink.simulink_data import entry, mxarray, numbers, sldd, thing
from tests.importers.simulink.simulink_files import zipped
from tests.importers.simulink.simulink_runs import alone, imported


@pytest.fixture
def folder(tmp_path):
    limits = {"Value": entry([[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]), "Min": -1.0, "Max": 9.5, "DocUnits": "Nm"}
    axis = thing("Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[700.0, 1500.0]], Unit="rpm")
    table = thing("Simulink.lookuptable.Table", "Table", Value=[[1.0, 2.0]], Min=0.0, Unit="Nm")
    solver = '<P Name="Components"><Element Class="Simulink.SolverCC"><P Name="SolverName">ode4</P></Element></P>'
    encoded = (b"\0\1IM\0\0\0\0" + numbers([[4.0]])).hex()
    raw = sldd(
        {
            "K": entry(2.5),
            "on": entry(1.0, "logical"),
            "name": entry("turbo"),
            "S": entry({"a": 1.0, "b": {"c": [[1.0, 2.0]]}}),
            "P": thing("Simulink.Parameter", **limits, Description="a < b", DataType="single"),
            "L": thing("Simulink.LookupTable", table=table, axes=axis),
            "C": '<P Name="Value" Class="cell" Dimension="1*2"><Element Class="double">1.0</Element>'
            '<Element Class="char">x</Element></P>',
            "Two": '<P Name="Value" Dimension="2*1"><Element Class="Simulink.Parameter"><P Name="Value" Class="double">'
            '7.0</P></Element><Element Class="Simulink.Parameter"/></P>',
            "Hex": f'<P Name="Value" Class="double" Encoding="hex">{encoded}</P>',
            "Bad": '<P Name="Value" Class="double" Dimension="2*2">1.0 2.0 3.0</P>',
            "Odd": '<P Name="Value" Class="table">x</P>',
            "Im": '<P Name="Value" Class="double" IsComplex="1">1.0+2.0i</P>',
            "Gear": thing("Simulink.data.dictionary.EnumTypeDefinition", Description="x"),
            "Shared": f'<P Name="Value"><Element Class="Simulink.ConfigSet">{solver}</Element></P>',
        },
        references=["further.sldd"],
    )
    (tmp_path / "main.sldd").write_bytes(raw)
    (tmp_path / "further.sldd").write_bytes(sldd({"K": entry(9.0), "F": entry(8.0)}, ["main.sldd", "lost.sldd"]))
    return tmp_path


def test_entries_are_read_with_their_kinds(folder):
    entries = read_dictionary(folder / "main.sldd").data.entries
    assert (entries["K"].value.tolist(), entries["K"].kind) == ([[2.5]], "double")
    assert (entries["on"].value.tolist(), entries["on"].kind) == ([[1.0]], "logical")
    assert (entries["name"].value, entries["name"].kind) == ("turbo", "char")
    assert entries["S"].value["b"]["c"].tolist() == [[1.0, 2.0]]
    assert [getattr(part, "shape", part) for part in entries["C"].value] == [(1, 1), "x"]
    assert entries["Two"].value[0].value.tolist() == [[7.0]]
    assert entries["Hex"].value.tolist() == [[4.0]]


def test_parameters_come_with_limits_units_and_types(folder):
    parameter = read_dictionary(folder / "main.sldd").data.entries["P"]
    assert parameter.value.tolist() == [[1.0, 2.0, 3.0], [4.0, 5.0, 6.0]]
    assert (parameter.kind, parameter.minimum, parameter.maximum) == ("Simulink.Parameter", -1.0, 9.5)
    assert (parameter.unit, parameter.type, parameter.description) == ("Nm", "single", "a < b")


def test_lookup_tables_come_with_their_axes(folder):
    lookup_table = read_dictionary(folder / "main.sldd").data.entries["L"]
    assert (lookup_table.value.tolist(), lookup_table.unit, lookup_table.minimum) == ([[1.0, 2.0]], "Nm", 0.0)
    assert [(axis.unit, axis.value.tolist()) for axis in lookup_table.breakpoints] == [("rpm", [[700.0, 1500.0]])]


def test_breakpoint_objects_hold_their_values_one_level_down(tmp_path):
    inner = thing("Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[700.0, 1500.0]], Unit="rpm", Min=0.0)
    (tmp_path / "d.sldd").write_bytes(sldd({"B": thing("Simulink.Breakpoint", axis=inner)}))
    breakpoints = read_dictionary(tmp_path / "d.sldd").data.entries["B"]
    assert (breakpoints.value.tolist(), breakpoints.unit, breakpoints.minimum) == ([[700.0, 1500.0]], "rpm", 0.0)


def test_unreadable_entries_are_reported_by_name(folder):
    assert read_dictionary(folder / "main.sldd", follow=False).data.unreadable == {
        "Bad": "it has 3 numbers for a size of 2*2",
        "Odd": "its class table is unknown",
        "Im": "it is complex",
    }


def test_configurations_and_types_are_distinguished_from_data(folder):
    dictionary_read = read_dictionary(folder / "main.sldd")
    assert dictionary_read.types == ("Gear",)
    assert dictionary_read.solvers["Shared"].name == "ode4"


def test_references_are_followed_once_and_the_nearest_entry_wins(folder):
    dictionary_read = read_dictionary(folder / "main.sldd")
    assert dictionary_read.references == ("further.sldd",)
    assert (dictionary_read.data.entries["F"].value.item(), dictionary_read.data.entries["K"].value.item()) == (
        8.0,
        2.5,
    )
    assert "not found next to it" in dictionary_read.data.unreadable["lost.sldd"]
    assert "F" not in read_dictionary(folder / "main.sldd", follow=False).data.entries


def test_a_broken_dictionary_does_not_take_the_one_with_it_that_refers_to_it(folder):
    (folder / "lost.sldd").write_bytes(b"PK\3\4cut")
    data = read_dictionary(folder / "main.sldd").data
    assert data.entries["F"].value.item() == 8.0
    assert "is a damaged zip archive" in data.unreadable["lost.sldd"]


def test_a_reference_leads_to_no_file_elsewhere(tmp_path):
    (tmp_path / "a").mkdir()
    (tmp_path / "b.sldd").write_bytes(sldd({"K": entry(1.0)}))
    (tmp_path / "a" / "main.sldd").write_bytes(sldd({}, ["../b.sldd"]))
    assert "K" not in read_dictionary(tmp_path / "a" / "main.sldd").data.entries


@few_or_many(
    values=hnp.arrays(np.float64, hnp.array_shapes(min_dims=2, max_dims=4, max_side=4), elements=st.floats()),
    few=20,
    many=100,
)
def test_numbers_of_any_shape_come_back(values, tmp_path_factory):
    path = tmp_path_factory.mktemp("d") / "a.sldd"
    path.write_bytes(sldd({"A": entry(values)}))
    np.testing.assert_array_equal(read_dictionary(path).data.entries["A"].value, values)


@pytest.mark.parametrize(
    ("raw", "message"),
    [
        (b"K = 1", "is not a data dictionary"),
        (b"PK\3\4cut", "damaged zip archive"),
        (zipped({"a": "b"}), "part data/chunk0.xml is missing"),
        (zipped({"data/chunk0.xml": "<DataSource><Object>"}), "not well-formed XML"),
        (zipped({"data/chunk0.xml": '<!DOCTYPE a [<!ENTITY b "c">]><a>&b;</a>'}), "declares the entity b"),
        (b'{"__MW_TEXT_PARTS__": {}}', "part data/chunk0 is missing"),
    ],
)
def test_a_file_other_than_a_dictionary_is_reported_in_a_sentence(raw, message, tmp_path):
    (tmp_path / "d.sldd").write_bytes(raw)
    with pytest.raises(InputError, match=message):
        read_dictionary(tmp_path / "d.sldd")


def test_a_missing_file_is_reported(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        read_dictionary(tmp_path / "d.sldd")


@pytest.mark.parametrize("count", [60, pytest.param(300, marks=pytest.mark.slow)])
def test_garbled_dictionaries_are_read_or_refused_but_never_crash(folder, count):
    with zipfile.ZipFile(folder / "main.sldd") as archive:
        whole = archive.read("data/chunk0.xml")
    chance, refused = random.Random(5), 0
    for _ in range(count):
        raw = bytearray(whole)
        start = chance.randrange(len(raw))
        if chance.random() < 0.5:
            raw[start] = chance.randrange(32, 127)
        else:
            del raw[start : start + chance.randrange(1, 30)]
        (folder / "g.sldd").write_bytes(zipped({"data/chunk0.xml": bytes(raw)}))
        try:
            read_dictionary(folder / "g.sldd")
        except InputError:
            refused += 1
    assert 0 < refused < count


def test_a_workspace_is_not_a_dictionary(tmp_path):
    (tmp_path / "d.sldd").write_bytes(mxarray({"K": 1.0}))
    with pytest.raises(InputError, match="is not a data dictionary"):
        read_dictionary(tmp_path / "d.sldd")


def test_a_table_object_keeps_the_limits_and_the_unit_of_its_table(tmp_path):
    axis = thing("Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[0.0, 2.0]])
    table = thing("Simulink.lookuptable.Table", "Table", Value=[[1.0, 2.0]], Min=0.0, Max=8.0, Unit="Nm")
    (tmp_path / "data.sldd").write_bytes(sldd({"Eta": thing("Simulink.LookupTable", table=table, axes=axis)}))
    drawn = alone("Lookup_n-D", NumberOfTableDimensions="1", DataSpecification="Lookup table object",
                  LookupTableObject="Eta")  # fmt: skip
    lookup_table = imported(drawn, tmp_path, parameters=[tmp_path / "data.sldd"]).values["Eta"]
    np.testing.assert_array_equal([lookup_table.lower, lookup_table.upper], [[0.0, 0.0], [8.0, 8.0]])
    assert lookup_table.unit == "Nm"


@pytest.mark.parametrize(
    ("scaling", "stored", "expected"),
    [
        ({"FixedExponent": 0.0}, 'Class="int32">-7', [[-7.0]]),
        ({"FixedExponent": -4.0, "SlopeAdjustmentFactor": 1.5, "Bias": 2.0}, 'Class="uint8">16', [[3.5]]),
        ({"FixedExponent": 1.0}, 'Class="int16" Dimension="1*2">1 -2', [[2.0, -4.0]]),
    ],
)
def test_fixed_point_objects_have_their_physical_values(scaling, stored, expected, tmp_path):
    fields = {"DataType": "Fixed", "WordLength": 32.0, "SlopeAdjustmentFactor": 1.0, "Bias": 0.0, **scaling}
    value = thing("embedded.fi", **fields, intarray=f'<P Name="intarray" {stored}</P>')
    (tmp_path / "fixed.sldd").write_bytes(sldd({"K": value}))
    assert read_dictionary(tmp_path / "fixed.sldd").data.entries["K"].value.tolist() == expected


@pytest.mark.parametrize(("field", "why"), [({"WordLength": 64.0}, "64 bits"), ({"DataType": "double"}, "double")])
def test_fixed_point_objects_of_another_kind_are_unreadable(field, why, tmp_path):
    fields = {"DataType": "Fixed", "WordLength": 32.0, "FixedExponent": 0.0, "SlopeAdjustmentFactor": 1.0, "Bias": 0.0}
    value = thing("embedded.fi", **{**fields, **field}, intarray='<P Name="intarray" Class="int32">1</P>')
    (tmp_path / "fixed.sldd").write_bytes(sldd({"K": value}))
    assert why in read_dictionary(tmp_path / "fixed.sldd").data.unreadable["K"]
