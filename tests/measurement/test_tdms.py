"""TDMS: rasters, time stamps, units, scaled and dated channels, damage."""

import sys

import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies, refusals

nptdms = pytest.importorskip("nptdms", reason="nptdms is not installed: pip install kennfeld[tdms]")
START = np.datetime64("2026-11-27T10:00:00")


@pytest.fixture
def tdms(tmp_path):
    """Writes channels (group, name, values, properties) as a TDMS file."""

    def write(*channels):
        path = tmp_path / "bench.tdms"
        with nptdms.TdmsWriter(path) as writer:
            writer.write_segment([nptdms.ChannelObject(*channel) for channel in channels])
        return path

    return write


def even(step, offset=0.0, start=START, **more):
    return {"wf_increment": step, "wf_start_offset": offset, "wf_start_time": start, **more}


def test_time_follows_from_the_increment(tdms):
    values = np.array([1.0, 2.0, 3.0])
    data = read(tdms(("bench", "Speed", values, even(0.5, 1.0, unit_string="rpm", description="crankshaft"))))
    assert data.time.tolist() == [1.0, 1.5, 2.0]
    assert (data["Speed"].unit, data["Speed"].description) == ("rpm", "crankshaft")


def test_groups_are_rasters_whose_starts_differ(tdms):
    later = START + np.timedelta64(500, "ms")
    path = tdms(
        ("fast", "Speed", np.arange(21.0), even(0.1)),
        ("slow", "Temperature", np.arange(3.0), even(0.5, start=later)),
    )
    assert [table.name for table in describe(path).tables] == ["fast", "slow"]
    data = read(path, raster=0.5)
    assert data.time.tolist() == [0.5, 1.0, 1.5]
    assert data["Temperature"].values.tolist() == [0.0, 1.0, 2.0]
    np.testing.assert_allclose(data["Speed"].values, [5.0, 10.0, 15.0])
    with pytest.raises(InputError, match="different rasters"):
        read(path)
    assert read(path, ["Temperature"]).samples == 3


def test_a_channel_may_be_the_time(tdms):
    stamps = START + np.arange(3) * np.timedelta64(20, "ms")
    data = read(tdms(("log", "Timestamp", stamps), ("log", "Speed", np.array([1, 2, 3], dtype=np.int32))))
    assert data.time.tolist() == [0.0, 0.02, 0.04]
    assert data["Speed"].values.tolist() == [1.0, 2.0, 3.0]


def test_dates_of_all_groups_count_from_the_earliest(tdms):
    stamps = START + np.arange(5) * np.timedelta64(500, "ms")
    path = tdms(
        ("early", "Timestamp", stamps),
        ("early", "Speed", np.arange(5.0)),
        ("late", "Timestamp", stamps + np.timedelta64(1, "s")),
        ("late", "Torque", np.arange(5.0)),
    )
    data = read(path, ["Speed", "Torque"], raster=0.5)
    assert data.time.tolist() == [1.0, 1.5, 2.0]
    assert (data["Speed"].values.tolist(), data["Torque"].values.tolist()) == ([2.0, 3.0, 4.0], [0.0, 1.0, 2.0])


def test_dates_and_starts_have_one_origin(tdms):
    stamps = START + np.arange(1, 6) * np.timedelta64(500, "ms")
    path = tdms(
        ("even", "Speed", np.arange(5.0), even(0.5)), ("log", "Date Time", stamps), ("log", "Torque", np.arange(5.0))
    )
    data = read(path, ["Speed", "Torque"], raster=0.5)
    assert (data.time.tolist(), data["Torque"].values.tolist()) == ([0.5, 1.0, 1.5, 2.0], [0.0, 1.0, 2.0, 3.0])


def test_equal_names_are_distinguished_by_their_groups(tdms):
    path = tdms(("left", "Speed", np.arange(3.0)), ("right", "Speed", np.arange(3.0) + 5))
    assert [table.channels[0].name for table in describe(path).tables] == ["left/Speed", "right/Speed"]
    assert read(path, ["right/Speed"])["right/Speed"].values.tolist() == [5.0, 6.0, 7.0]
    with pytest.raises(InputError, match="2 channels are named Speed"):
        read(path, ["Speed"])


def test_texts_are_left_out_and_points_have_no_time(tdms):
    path = tdms(("bench", "Note", ["a", "b"]), ("bench", "Torque", np.array([10.0, np.inf])))
    data = read(path)
    assert list(data) == ["Torque"]
    assert data.time is None
    assert np.isnan(data["Torque"].values[1])


def test_scaled_channels_have_physical_values(tdms):
    scale = {
        "NI_Number_Of_Scales": 1,
        "NI_Scale[0]_Scale_Type": "Linear",
        "NI_Scale[0]_Linear_Slope": 2.0,
        "NI_Scale[0]_Linear_Y_Intercept": 10.0,
        "NI_Scale[0]_Linear_Input_Source": 0xFFFFFFFF,
        "NI_UnitDescription": "Volts",
    }
    data = read(tdms(("bench", "U", np.arange(3, dtype=np.int16), scale)))
    assert (data["U"].values.tolist(), data["U"].unit) == ([10.0, 12.0, 14.0], "Volts")


@pytest.mark.parametrize("unit", ["Hz", "m"])
def test_a_step_other_than_time_gives_points(tdms, unit):
    assert read(tdms(("bench", "U", np.arange(3.0), {"wf_increment": 0.5, "wf_xunit_string": unit}))).time is None


def test_the_step_may_be_in_another_unit_of_time(tdms):
    stated = {"wf_increment": 20.0, "wf_start_offset": 10.0, "wf_xunit_string": "ms"}
    np.testing.assert_allclose(read(tdms(("bench", "U", np.arange(3.0), stated))).time, [0.01, 0.03, 0.05])


@pytest.mark.parametrize("offset", ["soon", float("nan"), True])
def test_a_nonnumeric_offset_is_ignored(tdms, offset):
    stated = {"wf_increment": 0.5, "wf_start_offset": offset}
    assert read(tdms(("bench", "U", np.arange(2.0), stated))).time[1] >= 0.5


def test_a_group_may_declare_its_first_channel_as_time(tmp_path):
    path = tmp_path / "bench.tdms"
    with nptdms.TdmsWriter(path) as writer:
        step = {"wf_increment": 1.0}
        group = nptdms.GroupObject("g", {"wf_xcolumns": "One"})
        channels = [("Time", np.array([0.0, 0.1, 0.3])), ("Speed", np.arange(3.0))]
        writer.write_segment([group, *(nptdms.ChannelObject("g", name, values, step) for name, values in channels)])
    data = read(path)
    assert (data.time.tolist(), list(data)) == ([0.0, 0.1, 0.3], ["Speed"])


def interrupted(path, kept):
    """Cut a file off, as a logger leaves it that lost its power: the length of the last segment was not written yet."""
    content = bytearray(path.read_bytes())
    content[12:20] = b"\xff" * 8
    path.write_bytes(content[:kept])


def test_interrupted_recordings_are_read_as_far_as_they_go(tdms):
    path = tdms(("log", "Time", np.arange(50) * 0.1), ("log", "Speed", np.arange(50.0)))
    whole = path.stat().st_size
    interrupted(path, whole - 20 * 8)
    data = read(path)
    assert data["Speed"].values.tolist() == list(range(30))
    np.testing.assert_allclose(data.time, np.arange(30) * 0.1)
    (finding,) = data.findings
    assert (finding.severity, "the last segment is incomplete" in str(finding)) == ("warning", True)


@pytest.mark.slow
@pytest.mark.parametrize("step", [11, pytest.param(1, marks=pytest.mark.slow)])  # 11 meets every offset in a number
def test_files_cut_off_at_any_byte_are_read_or_refused(tmp_path, step):
    path = tmp_path / "bench.tdms"
    with nptdms.TdmsWriter(path) as writer:
        for first in (0.0, 9.0):
            values = np.arange(first, first + 9)
            channels = [("x", values), ("y", -values), ("Note", [str(value) for value in values])]
            writer.write_segment([nptdms.ChannelObject("g", name, part, even(0.1)) for name, part in channels])
    content = path.read_bytes()
    samples = set()
    for kept in range(4, len(content), step):
        path.write_bytes(content[:kept])
        try:
            data = read(path)
        except InputError:
            continue
        samples.add(data.samples)
        assert data["x"].values.tolist() == list(range(data.samples))
        assert (-data["y"].values).tolist() == list(range(data.samples))
    assert 9 in samples


def test_an_index_file_names_its_recording(tmp_path):
    (tmp_path / "bench.tdms_index").write_bytes(b"TDSh" + bytes(100))
    with pytest.raises(InputError, match=r"an index of a TDMS file, which holds no samples\. Name the \.tdms file"):
        read(tmp_path / "bench.tdms_index")


def test_without_the_library_its_command_is_named(tdms, monkeypatch):
    path = tdms(("bench", "Torque", np.arange(3.0)))
    monkeypatch.setitem(sys.modules, "nptdms", None)
    with pytest.raises(InputError, match=r'the package nptdms is not installed\. Run: pip install "kennfeld\[tdms\]"'):
        read(path)


@few_or_many_copies
def test_damaged_files_are_read_or_refused(tdms, count):
    path = tdms(
        ("a", "x", np.arange(50.0), even(0.1)), ("a", "y", np.arange(50.0), even(0.1)), ("b", "z", np.arange(5))
    )
    assert refusals(path, head=4, count=count, raster=0.1) > count / 6


RAW = np.arange(6, dtype=np.int16)


def scaled(kind, **parameters):
    names = {f"NI_Scale[0]_{kind}_{name}": value for name, value in parameters.items()}
    return {"NI_Number_Of_Scales": 1, "NI_Scaling_Status": "unscaled", "NI_Scale[0]_Scale_Type": kind} | names


def test_a_table_is_interpolated(tdms):
    points = {"Scaled_Values_Size": 3, "Pre_Scaled_Values_Size": 3, "Input_Source": 0xFFFFFFFF}
    points |= {f"Scaled_Values[{k}]": value for k, value in enumerate((100.0, 120.0, 200.0))}
    points |= {f"Pre_Scaled_Values[{k}]": value for k, value in enumerate((0.0, 2.0, 5.0))}
    data = read(tdms(("g", "x", RAW, even(0.1) | scaled("Table", **points))))
    np.testing.assert_allclose(data["x"].values, np.interp(RAW, [0, 2, 5], [100, 120, 200]))


def test_a_channel_with_an_unknown_scale_is_skipped_with_a_warning(tdms):
    unknown = even(0.1) | scaled("PieceWisePolynomial")
    path = tdms(("g", "x", RAW, unknown), ("g", "y", RAW, even(0.1)))
    data = read(path)
    assert list(data) == ["y"]
    assert str(data.findings[0]) == (
        "bench.tdms channel x: has a scale of the unknown type PieceWisePolynomial and is skipped: its values are raw. "
        "Export it with scaled values."
    )
    for work in (lambda: read(path, ["x"]), lambda: read(tdms(("g", "x", RAW, unknown)))):
        with pytest.raises(InputError, match="unknown type PieceWisePolynomial"):
            work()
    assert read(tdms(("g", "x", RAW, unknown | {"NI_Scaling_Status": "scaled"})))["x"].values.tolist() == RAW.tolist()
