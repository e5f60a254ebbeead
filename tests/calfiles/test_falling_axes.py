"""Axes that fall in a file are turned around, in any format, and written as they were, into any format."""

import json
import re
from itertools import product

import numpy as np
import pytest
from hypothesis import strategies as st

from kennfeld import ParameterSet, read_parameters
from kennfeld.base.errors import InputError
from kennfeld.calfiles import compare, describe, losses, merge, write
from kennfeld.calfiles.loss_report import find_losses
from kennfeld.domain.axis import Axis
from kennfeld.domain.parameters import Curve, Map, parameter
from tests.calfiles import a2l_files
from tests.calfiles.stored_tables import STORED_IN
from tests.draws import few_or_many

DCM = """\
KONSERVIERUNG_FORMAT 2.0

FESTWERT GAIN
   WERT 2.0
END

STUETZSTELLENVERTEILUNG AXIS_T 3
*SST
   ST/X   -130.0   -140.0   -150.0
END

GRUPPENKENNLINIE CUR_T 3
*SSTX	AXIS_T
   ST/X   -130.0   -140.0   -150.0
   WERT   1.0   2.0   5.0
END

KENNFELD MAP 3 2
   ST/X   3.0   2.0   1.0
   ST/Y   10.0
   WERT   31.0   21.0   11.0
   ST/Y   20.0
   WERT   32.0   22.0   12.0
END
"""


@pytest.fixture
def dcm(tmp_path):
    path = tmp_path / "x.dcm"
    path.write_text(DCM, encoding="utf-8")
    return path


def test_tables_of_a_dcm_file_are_turned(dcm):
    values = read_parameters(dcm)
    assert values["CUR_T"].axes[0].breakpoints.tolist() == [-150.0, -140.0, -130.0]
    assert values["CUR_T"].axes[0].name == "AXIS_T"
    assert values["CUR_T"].values.tolist() == [5.0, 2.0, 1.0]
    assert values["MAP"].axes[0].breakpoints.tolist() == [1.0, 2.0, 3.0]
    assert values["MAP"].values.tolist() == [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]]
    assert values["GAIN"].value == 2.0


def test_a_dcm_file_is_written_back_byte_for_byte(dcm, tmp_path):
    read_parameters(dcm).save(tmp_path / "y.dcm")
    assert (tmp_path / "y.dcm").read_text(encoding="utf-8") == DCM


def test_new_values_go_where_the_old_ones_were(dcm, tmp_path):
    values = read_parameters(dcm)
    table = values["MAP"]
    changed = table.with_values(table.values + np.array([[0.5, 0], [0, 0], [0, 0]]))
    values.with_parameters(changed, values["CUR_T"].with_values([5.0, 2.0, 7.0])).save(tmp_path / "y.dcm")
    text = DCM.replace("21.0   11.0", "21.0   11.5").replace("WERT   1.0   2.0   5.0", "WERT   7.0   2.0   5.0")
    assert (tmp_path / "y.dcm").read_text(encoding="utf-8") == text


def test_new_breakpoints_go_where_the_old_ones_were(dcm, tmp_path):
    values = read_parameters(dcm)
    axis = Axis([-155.0, -140.0, -130.0], name="AXIS_T")
    moved = values["CUR_T"].changed(axes=(axis,))
    values.with_parameters(moved).save(tmp_path / "y.dcm")
    assert (tmp_path / "y.dcm").read_text(encoding="utf-8") == DCM.replace("-150.0", "-155.0")


@pytest.mark.parametrize("points", ["1.0 3.0 2.0", "1.0 1.0 2.0"])
def test_an_axis_that_neither_rises_nor_falls_leaves_out_its_tables_alone(dcm, points):
    dcm.write_text(DCM.replace("-130.0   -140.0   -150.0", points), encoding="utf-8")
    assert set(read_parameters(dcm)) == {"GAIN", "MAP"}
    warnings = [str(finding) for finding in describe(dcm).findings]
    assert len(warnings) == 2
    assert all("neither rises nor falls" in warning for warning in warnings)


def test_a_table_without_its_skipped_axis_is_skipped(dcm):
    text = DCM.replace("FORMAT 2.0", "FORMAT 1.0").replace("-130.0   -140.0   -150.0", "1 3 2")
    dcm.write_text(text.replace("*SSTX\tAXIS_T\n   ST/X   1 3 2\n", "*SSTX\tAXIS_T\n"), encoding="utf-8")
    assert set(read_parameters(dcm)) == {"GAIN", "MAP"}


def rising(tmp_path, ending):
    """A map written in a format, to be edited into one with a falling axis."""
    path = tmp_path / f"x{ending}"
    table = Map("MAP", Axis([1.0, 2.0, 3.0]), Axis([10.0, 20.0]), [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]])
    ParameterSet([table]).save(path)
    return path, path.read_text(encoding="utf-8")


def test_a_cvx_file_is_turned(tmp_path):
    path, text = rising(tmp_path, ".csv")
    path.write_text(re.sub(r"([\d.]+),([\d.]+),([\d.]+)$", r"\3,\2,\1", text, flags=re.MULTILINE), encoding="utf-8")
    assert_turned(path)


def test_a_cdfx_file_is_turned(tmp_path):
    path, text = rising(tmp_path, ".cdfx")
    value = r"(<V>[\d.]+</V>)"
    path.write_text(re.sub(value * 3, r"\3\2\1", text), encoding="utf-8")
    assert_turned(path)


def test_a_matlab_script_is_turned(tmp_path):
    path = tmp_path / "x.m"
    path.write_text("MAP.x = [3 2 1];\nMAP.y = [10 20];\nMAP.values = [31 32; 21 22; 11 12];\n", encoding="utf-8")
    assert_turned(path)
    path.write_text(
        "K = 1;\nMAP.x = [3 1 2];\nMAP.y = [10 20];\nMAP.values = [31 32; 21 22; 11 12];\n", encoding="utf-8"
    )
    assert set(read_parameters(path)) == {"K"}


def assert_turned(path):
    table = read_parameters(path)["MAP"]
    assert table.axes[0].breakpoints.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(table.values, [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]])


CUBE_FORMATS = (".cdfx", ".m", ".mat", ".xlsx", ".json")


@st.composite
def tables(draw, most):
    """Tables over own and group axes of which some fall, each value another one."""
    points = st.sets(st.integers(-50, 50), min_size=1, max_size=4).map(lambda numbers: np.array(sorted(numbers), float))
    groups = [Axis(draw(points), name=f"G{i}", falling=draw(st.booleans())) for i in range(draw(st.integers(0, 2)))]
    own = st.builds(Axis, points, falling=st.booleans())
    axes = st.lists(st.one_of(st.sampled_from(groups), own) if groups else own, min_size=1, max_size=most)
    members = []
    for number in range(draw(st.integers(1, 3))):
        chosen = draw(axes)
        shape = tuple(map(len, chosen))
        values = draw(st.permutations(range(int(np.prod(shape)))))
        members.append(parameter(f"T{number}", np.reshape(values, shape) + 0.5, chosen))
    return ParameterSet(members, axes=groups)


def assert_stored(path, parameters):
    """Check the bytes of a file by another parser: every value at its breakpoints, which are in the wanted order."""
    stored = STORED_IN[path.suffix](path)
    for name, table in parameters.items():
        axes, values = stored[name]
        points = [axis.breakpoints.tolist() for axis in table.axes]
        wanted = [numbers[::-1] if axis.falling else numbers for numbers, axis in zip(points, table.axes, strict=True)]
        assert list(map(list, axes)) == wanted
        assert values == dict(zip(product(*points), table.values.ravel().tolist(), strict=True))


def falling(parameters):
    """The order of all axes, which does not count when sets are compared."""
    own = {name: [axis.falling for axis in table.axes] for name, table in parameters.items()}
    return own, {axis.name: axis.falling for axis in parameters.axes}


@pytest.mark.parametrize("first", STORED_IN)
@few_or_many(data=st.data(), few=2, many=40)
def test_two_formats_in_a_row_keep_the_order_of_axes(tmp_path_factory, first, data):
    folder, second = tmp_path_factory.mktemp("sets"), data.draw(st.sampled_from([*STORED_IN]))
    start = data.draw(tables(3 if {first, second} <= set(CUBE_FORMATS) else 2))
    values = start
    for number, ending in enumerate((first, second)):
        path = folder / f"{number}{ending}"
        write(values, path)
        assert_stored(path, start)
        values = read_parameters(path)
        assert values == start
        assert falling(values) == falling(start)


def test_a_file_that_is_updated_keeps_its_order(dcm, tmp_path):
    values = read_parameters(dcm)
    rising = [table.changed(axes=tuple(a.changed(falling=False) for a in table.axes)) for table in values.values()]
    added = Curve("NEW", Axis([-150.0, -140.0, -130.0], name="AXIS_T"), [1.0, 2.0, 3.0])
    values.with_parameters(*rising, added).save(tmp_path / "y.dcm")
    text = (tmp_path / "y.dcm").read_text(encoding="utf-8")
    assert text.startswith(DCM)
    assert_stored(tmp_path / "y.dcm", ParameterSet([values["MAP"], values["CUR_T"], added.changed(axes=values.axes)]))


def test_a_block_of_another_size_keeps_the_order_of_its_file(dcm, tmp_path):
    values = read_parameters(dcm)
    x, y = Axis([1.0, 2.0, 3.0, 4.0]), values["MAP"].axes[1]
    larger = Map("MAP", x, y, np.arange(8.0).reshape(4, 2))
    group = Axis([-150.0, -130.0], name="AXIS_T")
    values.with_parameters(larger, Curve("CUR_T", group, [1.0, 2.0])).save(tmp_path / "y.dcm")
    assert "ST/X   -130.0   -150.0" in (tmp_path / "y.dcm").read_text(encoding="utf-8")
    wanted = [larger.changed(axes=(x.changed(falling=True), y)), Curve("CUR_T", group.changed(falling=True), [1, 2])]
    assert_stored(tmp_path / "y.dcm", ParameterSet(wanted))


def test_a_block_that_repeats_another_one_in_the_opposite_order_is_updated_in_its_own(tmp_path):
    block = "KENNLINIE C 2\n   ST/X   {}\n   WERT   {}\nEND\n"
    path = tmp_path / "x.dcm"
    path.write_text(block.format("2 1", "20 10") + block.format("1 2", "10 20"), encoding="utf-8")
    values = read_parameters(path)
    values.with_parameters(values["C"].with_values([10.0, 21.0])).save(path)
    assert path.read_text(encoding="utf-8") == block.format("2 1", "21 10") + block.format("1 2", "10 21")


def test_the_order_is_not_a_difference_of_axes():
    rising, turned = Axis([1.0, 2.0], name="G"), Axis([1.0, 2.0], name="G", falling=True)
    assert rising == turned
    assert hash(rising) == hash(turned)
    assert turned.breakpoints.tolist() == [1.0, 2.0]
    assert turned.changed(unit="rpm").falling
    assert turned.rounded().falling
    assert not Axis([1.0], falling=True).falling
    first, second = (ParameterSet([Curve("C", axis, [3.0, 4.0])]) for axis in (rising, turned))
    assert compare(first, second).equal
    assert merge([("a", second), ("b", first)]).changes == ()


def test_a_group_axis_has_one_order_in_a_set():
    rising, turned = Axis([1.0, 2.0], name="G"), Axis([1.0, 2.0], name="G", falling=True)
    first, second = Curve("A", turned, [3.0, 4.0]), Curve("B", rising, [5.0, 6.0])
    other = Curve("A", rising, [7.0, 8.0], variant="Car=A")
    assert falling(ParameterSet([first, second])) == ({"A": [True], "B": [True]}, {"G": True})
    assert falling(ParameterSet([second, first]))[1] == {"G": False}
    assert falling(ParameterSet([second], axes=[turned])) == ({"B": [True]}, {"G": True})
    assert ParameterSet([first], others=[other]).others[0].axes[0].falling
    later = ParameterSet([first, second]).with_parameters(second)
    assert falling(later)[1] == {"G": False}


def variants(label, *values):
    """A CDFX instance in the variants A and B."""
    parts = "".join(
        f"<SW-INSTANCE-PROPS-VARIANT><SW-VCD-CRITERION-VALUES><SW-VCD-CRITERION-VALUE><VT>{name}</VT>"
        f"</SW-VCD-CRITERION-VALUE></SW-VCD-CRITERION-VALUES>{value}</SW-INSTANCE-PROPS-VARIANT>"
        for name, value in zip("AB", values, strict=True)
    )
    return f"<SW-INSTANCE>{label}<SW-INSTANCE-PROPS-VARIANTS>{parts}</SW-INSTANCE-PROPS-VARIANTS></SW-INSTANCE>"


def physical(*numbers):
    return f"<SW-VALUES-PHYS>{''.join(f'<V>{number}</V>' for number in numbers)}</SW-VALUES-PHYS>"


def write_cdfx(path, second):
    """Write a curve over a group axis in two variants, of which the second has these breakpoints, and a plain curve."""
    value = "<SW-VALUE-CONT>{}</SW-VALUE-CONT>".format
    axis = "<SW-AXIS-CONTS><SW-AXIS-CONT><CATEGORY>COM_AXIS</CATEGORY><SW-INSTANCE-REF>G</SW-INSTANCE-REF>{}"
    axis += "</SW-AXIS-CONT></SW-AXIS-CONTS>"
    label = "<SHORT-NAME>{}</SHORT-NAME><CATEGORY>{}</CATEGORY>".format
    group = variants(label("G", "COM_AXIS"), value(physical(3, 2, 1)), value(physical(*second)))
    rows = (value(physical(*row)) + axis.format("") for row in ((30, 20, 10), (11, 21, 31)))
    plain = f"{label('D', 'CURVE')}{value(physical(1, 2, 3))}{axis.format(physical(1, 2, 3))}"
    path.write_text(
        "<MSRSW><CATEGORY>CDF20</CATEGORY><SW-SYSTEMS><SW-SYSTEM><SW-INSTANCE-SPEC><SW-INSTANCE-TREE>"
        f"{group}{variants(label('C', 'CURVE'), *rows)}<SW-INSTANCE>{plain}</SW-INSTANCE>"
        "</SW-INSTANCE-TREE></SW-INSTANCE-SPEC></SW-SYSTEM></SW-SYSTEMS></MSRSW>",
        encoding="utf-8",
    )


def test_variants_and_copies_of_a_group_axis_in_another_order_are_read_right_in_cdfx(tmp_path):
    write_cdfx(tmp_path / "a.cdfx", (1, 2, 3))
    assert describe(tmp_path / "a.cdfx").findings == ()
    assert_variants(tmp_path / "a.cdfx", tmp_path)


@pytest.mark.parametrize(("second", "points"), [((7, 8, 9), [7.0, 8.0, 9.0]), ((7, 9, 8), None)])
def test_tables_of_a_variant_with_another_group_axis_have_its_breakpoints_in_cdfx(tmp_path, second, points):
    write_cdfx(tmp_path / "a.cdfx", second)
    values = read_parameters(tmp_path / "a.cdfx")
    assert values["C"].axes[0].breakpoints.tolist() == [1.0, 2.0, 3.0]
    others = {item.variant: item for item in values.others}
    assert (others["B"].axes[0].breakpoints.tolist() if others else None) == points
    [remark] = describe(tmp_path / "a.cdfx").findings
    assert "(G): is the axis in another variant (B)" in str(remark)


def test_variants_of_a_group_axis_in_another_order_are_read_right_in_cvx(tmp_path):
    records = "CALIBRATION VALUES V2.1,.,*\n\n"
    for variant, points, values in (("A", "3,2,1", "30,20,10"), ("B", "1,2,3", "11,21,31")):
        coding = f'VARIANT,,"{variant}"\n\n'
        records += f",G\nAXIS_PTS,,{points}\n{coding},C\nCURVE,G\n,,{values}\n{coding}"
    path = tmp_path / "a.csv"
    path.write_text(records + ",D\nCURVE,G\n,,3,2,1\n", encoding="utf-8")
    assert_variants(path, tmp_path)


def assert_variants(path, folder):
    """Check tables over a group axis that falls in the first of two variants, and a set that is written of them."""
    for file in (path, folder / "again.cdfx", folder / "again.csv"):
        values = read_parameters(file)
        assert values["C", "A"].values.tolist() == [10.0, 20.0, 30.0]
        assert values["C", "B"].values.tolist() == [11.0, 21.0, 31.0]
        assert values["D"].values.tolist() == [1.0, 2.0, 3.0]
        assert falling(values)[1] == {"G": True}
        values.save(folder / "again.csv")
        values.save(folder / "again.cdfx")


def test_tables_of_a_variant_with_another_group_axis_have_its_breakpoints(tmp_path):
    records = "CALIBRATION VALUES V2.1,.,*\n\n"
    for variant, points in (("A", "3,2,1"), ("B", "9,8,7")):
        coding = f'VARIANT,,"{variant}"\n\n'
        records += f",G\nAXIS_PTS,,{points}\n{coding},C\nCURVE,G\n,,30,20,10\n{coding}"
    blocks = "KONSERVIERUNG_FORMAT 1.0\n"
    for variant, points in (("A", "3 2 1"), ("B", "9 8 7")):
        blocks += f"STUETZSTELLENVERTEILUNG G 3\n VAR {variant}\n ST/X {points}\nEND\n"
        blocks += f"GRUPPENKENNLINIE C 3\n*SSTX G\n VAR {variant}\n WERT 30 20 10\nEND\n"
    (tmp_path / "a.csv").write_text(records, encoding="utf-8")
    (tmp_path / "a.dcm").write_text(blocks, encoding="utf-8")
    for path in (tmp_path / "a.csv", tmp_path / "a.dcm"):
        values = read_parameters(path)
        for variant, points, name in (("A", [1.0, 2.0, 3.0], "G"), ("B", [7.0, 8.0, 9.0], "")):
            table = values["C", variant]
            assert (table.axes[0].breakpoints.tolist(), table.axes[0].name) == (points, name)
            assert table.values.tolist() == [10.0, 20.0, 30.0]
            assert table.axes[0].falling
    (tmp_path / "a.csv").write_text(records.replace("9,8,7", "9,7,8"), encoding="utf-8")
    assert read_parameters(tmp_path / "a.csv").others == ()
    read_parameters(tmp_path / "a.dcm").save(tmp_path / "b.dcm")
    assert (tmp_path / "b.dcm").read_text(encoding="utf-8") == blocks


def test_a_group_axis_in_both_orders_is_refused_in_cvx(tmp_path):
    path = tmp_path / "a.csv"
    records = ",G\nAXIS_PTS,,1,2\n\n,G\nAXIS_PTS,,2,1\n\n,C\nCURVE,G\n,,3,4\n"
    path.write_text(f"CALIBRATION VALUES V2.1,.,*\n\n{records}", encoding="utf-8")
    with pytest.raises(InputError, match="G is already defined in line 4"):
        read_parameters(path)


PAR = (
    'CANape PAR V3.1: "ecu.a2l" 1 0 ECU\r\nMap [FLOAT(32),(2,3)] 31 ; 31\r\n: 21 ; 21\r\n: 11 ; 11\r\n: 32 ; 32\r\n'
    ": 22 ; 22\r\n: 12 ; 12\r\nX : 3 ; 3\r\nX : 2 ; 2\r\nX : 1 ; 1\r\nY : 10 ; 10\r\nY : 20 ; 20\r\n"
)
ESDL = (
    "package P;\nclass Q {\n\tcharacteristic Unknown Map[3][2] = { { 3.0, 2.0, 1.0 }, { 10.0, 20.0 },"
    " { { 31.0, 32.0 }, { 21.0, 22.0 }, { 11.0, 12.0 } } };\n\tcharacteristic Speeds n[2] = { 5.0, 4.0 };\n"
    "\tcharacteristic Shared C[n] = { 8.0, 9.0 };\n}\n"
)
MSQ = (
    '<?xml version="1.0"?>\n<msq xmlns="http://www.msefi.com/:msq">\n<versionInfo signature="mine"/>\n<page>\n'
    '<constant cols="3" name="veTable" rows="2">31.0 21.0 11.0 32.0 22.0 12.0</constant>\n'
    '<constant cols="1" digits="0" name="rpmBins" rows="3">3.0 2.0 1.0</constant>\n'
    '<constant cols="1" name="fuelLoadBins" rows="2">10.0 20.0</constant>\n</page>\n</msq>\n'
)


@pytest.mark.parametrize(
    ("ending", "text", "name", "old", "new"),
    [
        (".par", PAR, "Map", ": 21 ; 21", ": 23.5 ; 23.5"),
        (".esdl", ESDL, "Map", "21.0", "23.5"),
        (".msq", MSQ, "veTable", "21.0", "23.5"),
    ],
)
def test_files_that_are_only_updated_keep_all_other_bytes(tmp_path, ending, text, name, old, new):
    path = tmp_path / f"x{ending}"
    path.write_bytes(text.encode())
    values = read_parameters(path)
    table = values[name]
    assert [axis.falling for axis in table.axes] == [True, False]
    assert table.axes[0].breakpoints.tolist() == [1.0, 2.0, 3.0]
    np.testing.assert_array_equal(table.values, [[11.0, 12.0], [21.0, 22.0], [31.0, 32.0]])
    write(values, tmp_path / f"same{ending}")
    assert (tmp_path / f"same{ending}").read_bytes() == path.read_bytes()
    rising = table.changed(axes=tuple(axis.changed(falling=False) for axis in table.axes))
    changed = rising.with_values(table.values + np.array([[0, 0], [2.5, 0], [0, 0]]))
    write(values.with_parameters(changed), tmp_path / f"new{ending}")
    assert (tmp_path / f"new{ending}").read_bytes() == text.replace(old, new).encode()
    write(values, tmp_path / "a.json")
    assert falling(read_parameters(tmp_path / "a.json")) == falling(values)


@pytest.mark.parametrize(
    ("ending", "text", "name", "points", "old", "new"),
    [
        (".par", PAR, "Map", [1, 2, 4], "X : 3 ; 3", "X : 4.0 ; 4.0"),
        (".esdl", ESDL, "Map", [1, 2, 4], "{ 3.0", "{ 4.0"),
        (".esdl", ESDL, "C", [4, 6], "{ 5.0", "{ 6.0"),
        (".msq", MSQ, "veTable", [1, 2, 4], ">3.0", ">4.0"),
    ],
)
def test_moved_breakpoints_stay_where_they_were(tmp_path, ending, text, name, points, old, new):
    path = tmp_path / f"x{ending}"
    path.write_bytes(text.encode())
    values = read_parameters(path)
    table = values[name]
    moved = Axis(points, name=table.axes[0].name)
    write(values.with_parameters(table.changed(axes=(moved, *table.axes[1:]))), path)
    assert path.read_bytes() == text.replace(old, new).encode()


def test_tables_of_an_image_come_out_falling(tmp_path):
    layout = a2l_files.layout("AXIS_PTS_X 1 UBYTE INDEX_INCR DIRECT", "FNC_VALUES 2 UBYTE ROW_DIR DIRECT")
    text = a2l_files.module(layout, a2l_files.label("CURVE", a2l_files.axis("STD_AXIS", 3)))
    values, _ = a2l_files.read(text, bytes([30, 20, 10, 3, 2, 1]))
    values.save(tmp_path / "a.cdfx")
    assert STORED_IN[".cdfx"](tmp_path / "a.cdfx")["L"] == ([[30, 20, 10]], {(30,): 3, (20,): 2, (10,): 1})


@pytest.mark.parametrize("value", [1, "true", None, [True]])
@pytest.mark.parametrize("key", ["x_falling", "falling"])
def test_json_states_the_order_as_true_or_false(tmp_path, key, value):
    entries = {
        "C": {"kind": "curve", "unit": "", "x": [1, 2], "values": [3, 4]},
        "G": {"kind": "axis", "unit": "", "x": [1, 2]},
    }
    entries["C" if key == "x_falling" else "G"][key] = value
    path = tmp_path / "a.json"
    path.write_text(json.dumps(entries), encoding="utf-8")
    with pytest.raises(InputError, match=f"{key}: must be true or false, got "):
        read_parameters(path)


def test_a_format_with_rising_axes_alone_reports_the_loss():
    values = ParameterSet([Curve("C", Axis([1, 2], falling=True), [3, 4]), Curve("D", [1, 2], [3, 4])])
    [loss] = find_losses(values, ("falling axes",), "a.abc")
    assert str(loss) == (
        "a.abc: falling axes are written in rising order: 1 label (C). Write it as .json to keep their order."
    )
    assert all(losses(values, f"a{ending}") == () for ending in STORED_IN)
