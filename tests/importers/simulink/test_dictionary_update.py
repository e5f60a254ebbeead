import io
import zipfile

import numpy as np
import pytest

from kennfeld import Axis, Block, Cube, Curve, InputError, Map, ParameterSet, Scalar, read_parameters
from kennfeld.cli import run
from kennfeld.importers.simulink.variables.data_dictionary import read_dictionary
from kennfeld.importers.simulink.variables.dictionary_update import update_dictionary
from tests.importers.simulink.simulink_data import entry, sldd, thing
from tests.importers.simulink.simulink_files import zipped
from tests.importers.simulink.simulink_runs import alone, imported


@pytest.fixture
def path(tmp_path):
    axis = thing("Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[700.0, 1500.0]], Unit="rpm", Min=0.0)
    table = thing("Simulink.lookuptable.Table", "Table", Value=[[1.0, 2.0]], Min=0.0, Unit="Nm")
    entries = {
        "K": entry(2.5),
        "Count": thing("Simulink.Parameter", Value=entry(3.0, "int16"), Min=-7.0, Description="a < b > c"),
        "Single": thing("Simulink.Parameter", Value=entry(1.0, "single")),
        # 4 x 3: a transposed table would be another one
        "M": entry(np.arange(12.0).reshape(4, 3)),
        "bp_x": entry([[0.0, 1.0, 2.0, 5.0]]),
        "Eta": thing("Simulink.LookupTable", table=table, axes=axis),
        "other": entry("turbo"),
    }
    (tmp_path / "data.sldd").write_bytes(sldd(entries, ["further.sldd"]))
    return tmp_path / "data.sldd"


def values():
    random = np.random.default_rng(1)
    return ParameterSet(
        [
            Scalar("K", -0.1),
            Scalar("Count", 12.0),
            Scalar("Single", 0.1),
            Map("M", Axis([0, 1.5, 2, 5], name="bp_x"), Axis([1, 2, 4], name="bp_y"), random.normal(size=(4, 3))),
            Curve("Eta", [800, 1600], [3.25, np.inf]),
            Scalar("Elsewhere", 1.0),
        ]
    )


def test_values_and_breakpoints_are_read_back_and_all_else_stays(path):
    result = update_dictionary(values(), path)
    (path.parent / "new.sldd").write_bytes(result.raw)
    before, after = read_dictionary(path, follow=False), read_dictionary(path.parent / "new.sldd", follow=False)
    entries = after.data.entries
    for name in ("K", "Count", "M"):
        np.testing.assert_array_equal(np.squeeze(entries[name].value), values()[name].values)
    assert entries["Single"].value.tolist() == [[float(np.float32(0.1))]]
    assert (entries["Count"].minimum, entries["Count"].description) == (-7.0, "a < b > c")
    assert entries["bp_x"].value.tolist() == [[0.0, 1.5, 2.0, 5.0]]
    assert (entries["Eta"].value.tolist(), entries["Eta"].minimum) == ([[3.25, np.inf]], 0.0)
    assert entries["Eta"].breakpoints[0].value.tolist() == [[800.0, 1600.0]]
    assert entries["other"] == before.data.entries["other"]
    assert after.references == before.references == ("further.sldd",)
    with zipfile.ZipFile(path) as old, zipfile.ZipFile(path.parent / "new.sldd") as new:
        assert old.namelist() == new.namelist()
    assert [str(finding) for finding in result.findings] == [
        "data.sldd: the breakpoints of M.y are not written: no entry is known to hold them",
        "data.sldd: has no entry Elsewhere. Change them in the model.",
    ]


def test_the_present_values_give_the_same_numbers(path):
    old = read_dictionary(path, follow=False).data.entries
    same = ParameterSet([Scalar("K", 2.5), Curve("Eta", [700, 1500], [1.0, 2.0])])
    path.with_name("same.sldd").write_bytes(update_dictionary(same, path).raw)
    new = read_dictionary(path.with_name("same.sldd"), follow=False).data.entries
    assert [(name, str(e)) for name, e in old.items()] == [(name, str(e)) for name, e in new.items()]


def test_a_model_computes_with_the_new_values(path, tmp_path):
    drawn = alone(
        "Lookup_n-D", NumberOfTableDimensions="2", Table="M", BreakpointsForDimension1="bp_x",
        BreakpointsForDimension2="[1 2 4]",
    )  # fmt: skip
    new = tmp_path / "new.sldd"
    new.write_bytes(update_dictionary(values(), path).raw)
    table = imported(drawn, tmp_path, parameters=[new]).values["M"]
    np.testing.assert_array_equal(table.values, values()["M"].values)
    np.testing.assert_array_equal(table.axes[0].breakpoints, [0, 1.5, 2, 5])
    assert table.axes[0].name == "bp_x"


@pytest.mark.parametrize(
    ("parameter", "message"),
    [
        (Scalar("Nothing", 1.0), "has none of the parameters"),
        (Scalar("Count", 1.5), "Count is of the class int16, which cannot hold 1.5"),
        (Curve("M", [0, 1], [1, 2]), "M has the size 4 x 3, the new values 2"),
        (Scalar("other", 1.0), "other holds no numbers"),
    ],
)
def test_values_that_the_dictionary_cannot_hold_are_refused(parameter, message, path):
    with pytest.raises(InputError, match=message):
        update_dictionary(ParameterSet([parameter]), path)


def test_the_command_writes_a_calibration_into_a_dictionary(path, capsys):
    values().without(["Elsewhere"]).save(path.with_name("new.json"))
    command = ["convert", str(path.with_name("new.json")), str(path.with_name("new.sldd")), "--image", str(path)]
    assert run(command) == 0
    assert read_dictionary(path.with_name("new.sldd"), follow=False).data.entries["K"].value.tolist() == [[-0.1]]
    assert read_parameters(path.with_name("new.json"))["K"].value == -0.1


def chunked(*chunks):
    """A dictionary whose entries are in several chunks, listed in the order of the archive."""
    members = {}
    for number, entries in enumerate(chunks):
        with zipfile.ZipFile(io.BytesIO(sldd(entries))) as archive:
            members[f"data/chunk{number}.xml"] = archive.read("data/chunk0.xml").decode()
    return zipped(members | {"metadata/mwcoreProperties.xml": "<a/>"})


@pytest.fixture
def written(tmp_path):
    """Write parameters into a dictionary of chunks; return the entries that are read back, and the findings."""

    def write(parameters, *chunks):
        (tmp_path / "old.sldd").write_bytes(chunked(*chunks))
        result = update_dictionary(ParameterSet(parameters), tmp_path / "old.sldd")
        (tmp_path / "new.sldd").write_bytes(result.raw)
        return read_dictionary(tmp_path / "new.sldd").data.entries, [str(finding) for finding in result.findings]

    return write


MAP = np.array([[1.5, 2, 3], [4, 5, 6], [7, 8, 9], [10, 11, -12.25]])


@pytest.mark.parametrize("order", [1, -1])
def test_breakpoints_are_written_that_are_in_another_chunk_than_their_table(order, written):
    chunks = [
        {"M": entry(np.zeros((4, 3))), "N": entry([[0.0, 0.0, 0.0]])},
        {"bp_x": entry([[0.0, 1.0, 2.0, 5.0]]), "bp_y": thing("Simulink.Breakpoint", Breakpoints=thing(
            "Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[1.0, 2.0, 3.0]]))},
    ]  # fmt: skip
    y = Axis([10, 20, 40], name="bp_y")
    parameters = [Map("M", Axis([-1, 0, 3, 7], name="bp_x"), y, MAP), Curve("N", y, [3, 2, 1])]
    entries, findings = written(parameters, *chunks[::order])
    assert entries["M"].value.tolist() == MAP.tolist()
    assert entries["bp_x"].value.tolist() == [[-1, 0, 3, 7]]
    assert entries["bp_y"].value.tolist() == [[10, 20, 40]]
    assert entries["N"].value.tolist() == [[3, 2, 1]]
    assert findings == []


def test_a_table_object_takes_each_axis_by_its_direction(written):
    def points(**properties):
        return f'<Element Class="Simulink.lookuptable.Breakpoint">{"".join(properties.values())}</Element>'

    # the first axis has no values of its own, so that the second one is not the first to be found
    axes = f'<P Name="Breakpoints" Dimension="2*1">{points()}{points(Value=entry([[1.0, 2.0, 3.0]]))}</P>'
    table = thing("Simulink.lookuptable.Table", "Table", Value=np.zeros((3, 3)))
    square = Map("Eta", [7, 8, 9], [10, 20, 40], MAP[:3])
    entries, findings = written([square], {"Eta": thing("Simulink.LookupTable", table=table, axes=axes)})
    assert entries["Eta"].value.tolist() == MAP[:3].tolist()
    assert entries["Eta"].breakpoints[1].value.tolist() == [[10, 20, 40]]
    assert findings == ["old.sldd: the breakpoints of Eta.x are not written: no entry is known to hold them"]


def test_breakpoints_that_table_objects_share_are_written_into_their_object(written, tmp_path):
    axis = thing("Simulink.lookuptable.Breakpoint", "Breakpoints", Value=[[0.0, 1.0, 2.0, 5.0]])
    names = '<P Name="Breakpoints" Class="cell" Dimension="1*2"><Element Class="char">bx</Element>' \
        '<Element Class="char">by</Element></P>'  # fmt: skip
    table = thing("Simulink.lookuptable.Table", "Table", Value=np.zeros((4, 3)))
    entries, findings = written(
        [Map("Eta", [-1, 0, 3, 7], [10, 20, 40], MAP)],
        {"Eta": thing("Simulink.LookupTable", table=table, axes=names)},
        {"bx": thing("Simulink.Breakpoint", axis=axis), "by": entry([[1.0, 2.0, 3.0]])},
    )
    assert entries["bx"].value.tolist() == [[-1, 0, 3, 7]]
    assert entries["by"].value.tolist() == [[10, 20, 40]]
    assert findings == []
    drawn = alone("Lookup_n-D", 2, NumberOfTableDimensions="2", DataSpecification="Lookup table object",
                  LookupTableObject="Eta")  # fmt: skip
    read = imported(drawn, tmp_path, parameters=[tmp_path / "new.sldd"]).values["Eta"]
    assert read.values.tolist() == MAP.tolist()
    assert [(axis.name, axis.breakpoints.tolist()) for axis in read.axes] == [
        ("bx", [-1, 0, 3, 7]),
        ("by", [10, 20, 40]),
    ]


def test_fields_of_structs_and_cubes_are_written_by_their_paths(written):
    fields = {"A": 1.0, "Value": 5.0, "in": {"T": [1.0, 4.0, 9.0], "B": 2.0}}
    cube = np.arange(24.0).reshape(4, 3, 2)
    scalars, curve = [Scalar("P.A", 7.0), Scalar("P.in.B", 8.0)], Curve("Q.in.T", [0, 1, 2], [3, 2, 1])
    parameters = [*scalars, curve, Cube("C", ([0, 1, 2, 3], [0, 1, 2], [0, 1]), cube)]
    chunks = [{"P": thing("Simulink.Parameter", Value=entry(fields))}, {"Q": entry(fields), "C": entry(0 * cube)}]
    entries, _ = written(parameters, *chunks)
    written_struct, plain = entries["P"].value, entries["Q"].value
    assert (written_struct["A"].item(), written_struct["in"]["B"].item(), written_struct["Value"].item()) == (7, 8, 5)
    assert (plain["in"]["T"].tolist(), plain["A"].item()) == ([[3, 2, 1]], 1)
    assert entries["C"].value.tolist() == cube.tolist()


@pytest.mark.parametrize("kind", ["logical", "boolean", "bool"])
@pytest.mark.parametrize(("words", "expected"), [("0 1 1", "1 1 0"), ("false true true", "true true false")])
def test_truths_are_written_as_the_file_writes_them(kind, words, expected, written, tmp_path):
    stored = {"on": f'<P Name="Value" Class="{kind}" Dimension="1*3">{words}</P>'}
    entries, _ = written([Block("on", [1, 1, 0])], stored)
    assert entries["on"].value.tolist() == [[1, 1, 0]]
    with zipfile.ZipFile(tmp_path / "new.sldd") as archive:
        assert f">{expected}<".encode() in archive.read("data/chunk0.xml")


def test_numbers_that_stay_and_all_else_are_the_same_bytes(written, tmp_path):
    kept = '<P Name="Value" Class="double" Dimension="2*2">1e3 -0.0 NaN 2</P>'
    single = '<P Name="Value" Class="single">0.05</P>'
    chunks = [
        {"A": kept, "K": entry(1.0), "F": single},
        {"Motor": thing("Simulink.Bus", Elements=thing("Simulink.BusElement", "Elements", Min=1.0, Max=2.0)),
         "S": entry({"a": "x", "b": [[1.0, 2.0]]}), "Odd": '<P Name="Value" Class="table">é</P>'},
    ]  # fmt: skip
    written([Block("A", [[1000.0, np.nan], [-0.0, 2.0]]), Scalar("K", 2.0), Scalar("F", 0.05)], *chunks)
    with zipfile.ZipFile(tmp_path / "old.sldd") as old, zipfile.ZipFile(tmp_path / "new.sldd") as new:
        first = old.read("data/chunk0.xml").replace(b">1.0<", b">2.0<")
        assert new.read("data/chunk0.xml") == first
        for name in old.namelist()[1:]:
            assert new.read(name) == old.read(name)


@pytest.mark.parametrize(
    ("stored", "value", "message"),
    [
        (entry(1.0, "int16"), np.inf, "of the class int16, which cannot hold inf"),
        (entry(1.0, "int16"), np.nan, "of the class int16, which cannot hold nan"),
        (entry(1.0, "int16"), 32768, "of the class int16, which cannot hold 32768"),
        (entry(1.0, "uint8"), -1, "of the class uint8, which cannot hold -1"),
        (entry(1.0, "logical"), 2, "of the class logical, which cannot hold 2"),
        (entry(1.0, "single"), 1e39, "of the class single, which cannot hold 1e\\+39"),
        (thing("Simulink.Parameter", Value=1.0, DataType="int8"), 1.5, "of the type int8, which cannot hold 1.5"),
        ('<P Name="Value" Class="double" IsComplex="1">1.0+2.0i</P>', 1, "K is complex"),
        ('<P Name="Value" Class="double" Encoding="hex">00</P>', 1, "K is stored as bytes"),
        ('<P Name="Value" Class="double" Dimension="2*1"> <!-- a --> 1 2</P>', 1, "K cannot be read"),
    ],
)
def test_a_class_that_cannot_hold_a_value_is_named(stored, value, message, written):
    with pytest.raises(InputError, match=message):
        written([Scalar("K", value)], {"K": stored})


def test_values_beyond_the_limits_of_an_entry_are_named(written):
    stored = thing("Simulink.Parameter", Value=[[1.0, 2.0]], Min=0.0, Max=9.5)
    _, findings = written([Block("K", [12.0, 3.0])], {"K": stored})
    assert findings == [
        "old.sldd: K is 12, beyond its maximum of 9.5 in the dictionary. "
        "Simulink refuses such a value: change one of them."
    ]


def test_different_breakpoints_for_one_entry_are_refused(written):
    parameters = [Curve("N", Axis([0, 1], name="bp"), [3, 2]), Block("bp", [0, 2])]
    with pytest.raises(InputError, match="bp has two sets of values"):
        written(parameters, {"N": entry([[0.0, 0.0]]), "bp": entry([[0.0, 5.0]])})


def test_the_dictionary_is_named_that_has_the_entry(path):
    path.with_name("further.sldd").write_bytes(sldd({"F": entry(8.0)}))
    findings = update_dictionary(ParameterSet([Scalar("K", 1.0), Scalar("F", 2.0)]), path).findings
    assert [str(finding) for finding in findings] == [
        "data.sldd: has no entry F, but further.sldd does, to which it refers. Write into further.sldd, too."
    ]


def test_a_table_that_the_model_transposes_is_written_as_the_entry_has_it(written, tmp_path):
    drawn = alone("Lookup_n-D", 2, NumberOfTableDimensions="2", Table="M'", BreakpointsForDimension1="[1 2 4]",
                  BreakpointsForDimension2="[0 1 2 5]")  # fmt: skip
    turned = Map("M'", [1, 2, 4], [0, 1, 2, 5], MAP.T)
    entries, _ = written([turned], {"M": entry(np.zeros((4, 3)))})
    assert entries["M"].value.tolist() == MAP.tolist()
    assert imported(drawn, tmp_path, parameters=[tmp_path / "new.sldd"]).values["M'"].values.tolist() == MAP.T.tolist()
