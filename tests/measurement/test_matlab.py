"""MATLAB files of versions 4 to 7.3: the forms in which people keep channels."""

import numpy as np
import pytest
import scipy
from hypothesis import strategies as st

from kennfeld.base.errors import InputError
from kennfeld.matlab import mat_v73
from kennfeld.measurement import describe, read
from kennfeld.measurement.matlab import holds_samples
from tests.draws import few_or_many
from tests.measurement.matlab_files import array5, element, file5, opaque5, save73

TIME = np.array([0.0, 0.1, 0.2])
SPEED = np.array([1000.0, 1500.0, 2000.0])


def scipy_form(value):
    """The value as scipy's writer wants it: struct arrays and cell arrays of objects."""
    if isinstance(value, dict):
        return {name: scipy_form(inner) for name, inner in value.items()}
    if isinstance(value, list):
        array = np.zeros((1, len(value)), dtype=[(name, object) for name in value[0]])
        for k, one in enumerate(value):
            array[0, k] = tuple(scipy_form(inner) for inner in one.values())
        return array
    if isinstance(value, tuple):
        cells = np.empty((1, len(value)), dtype=object)
        cells[0, :] = [scipy_form(inner) for inner in value]
        return cells
    return value


@pytest.fixture(params=["5", "7", "7.3"])
def mat(request, tmp_path):
    """Writes variables: uncompressed, compressed, and as HDF5."""

    def write(**variables):
        path = tmp_path / "bench.mat"
        if request.param == "7.3":
            save73(path, variables)
        else:
            scipy.io.savemat(path, scipy_form(variables), do_compression=request.param == "7", long_field_names=True)
        return path

    return write


@pytest.fixture
def mat5(tmp_path):
    """Writes bytes."""

    def write(content):
        path = tmp_path / "bench.mat"
        path.write_bytes(content)
        return path

    return write


def findings(path, *args, **options):
    with pytest.raises(InputError) as caught:
        read(path, *args, **options)
    return [str(finding) for finding in caught.value.findings]


def values_by_channel(data):
    return {name: channel.values.tolist() for name, channel in data.items()}


def test_vectors_beside_a_time_are_channels(mat):
    path = mat(time=TIME, Speed=SPEED[:, None], Torque=SPEED / 10, Gear=3.0, note="a test")
    data = read(path)
    assert values_by_channel(data) == {"Speed": SPEED.tolist(), "Torque": (SPEED / 10).tolist()}
    assert data.time.tolist() == TIME.tolist()
    assert describe(path).kind == "MATLAB data"
    assert holds_samples(path)


def test_version_4_is_read(tmp_path):
    scipy.io.savemat(tmp_path / "old.mat", {"t": TIME, "Speed": SPEED}, format="4")
    assert values_by_channel(read(tmp_path / "old.mat")) == {"Speed": SPEED.tolist()}


@pytest.mark.parametrize(("name", "last"), [("time_ms", 2e-4), ("Zeit", 0.2), ("tout", 0.2), ("t_10ms", 0.2)])
def test_time_has_many_names(mat, name, last):
    assert read(mat(**{name: TIME, "Speed": SPEED})).time[-1] == pytest.approx(last)


def test_a_matrix_becomes_a_channel_for_each_column(mat):
    matrix = np.arange(6.0).reshape(3, 2)
    assert values_by_channel(read(mat(time=TIME, A=matrix))) == {"A[0]": [0, 2, 4], "A[1]": [1, 3, 5]}
    assert values_by_channel(read(mat(time=TIME, A=matrix.T))) == {"A[0]": [0, 2, 4], "A[1]": [1, 3, 5]}
    assert values_by_channel(read(mat(time=TIME, A=matrix), ["A[1]"])) == {"A[1]": [1, 3, 5]}


def test_logical_and_whole_numbers_are_held_between_samples(mat):
    data = read(
        mat(time=TIME, on=np.array([False, True, False]), x=np.array([0, 100, 50], dtype=np.int32)), raster=0.05
    )
    assert data["on"].values.tolist() == [0, 0, 1, 1, 0]
    assert data["x"].values.tolist() == [0, 0, 100, 100, 50]


def test_whole_numbers_of_class_double_are_interpolated(mat):
    np.testing.assert_allclose(read(mat(time=TIME, x=SPEED), raster=0.05)["x"].values, [1000, 1250, 1500, 1750, 2000])


def test_a_struct_of_vectors_with_its_time_is_a_group(mat):
    path = mat(log={"time": TIME, "Speed": SPEED, "info": {"by": "Ada"}})
    assert values_by_channel(read(path)) == {"Speed": SPEED.tolist()}
    assert values_by_channel(read(path, ["log.Speed"])) == {"log.Speed": SPEED.tolist()}


def test_structs_within_a_struct_use_the_time_around_them(mat):
    data = read(mat(time=TIME, engine={"Speed": SPEED, "sensor": {"T": SPEED / 100}}, other={"Speed": SPEED + 1}))
    assert list(data) == ["engine.Speed", "T", "other.Speed"]


def test_groups_of_several_rasters_are_joined(mat):
    slow = {"time": np.array([0.0, 0.2]), "T": np.array([20.0, 24.0])}
    path = mat(fast={"time": TIME, "Speed": SPEED}, slow=slow)
    assert "different rasters: Speed every 0.1 s from 0 s, T every 0.2 s" in findings(path)[0]
    assert values_by_channel(read(path, raster=0.1)) == {"Speed": SPEED.tolist(), "T": [20, 22, 24]}
    assert values_by_channel(read(path, ["T"])) == {"T": [20, 24]}
    assert [table.name for table in describe(path).tables] == ["fast.time", "slow.time"]


def test_times_of_one_length_go_with_the_names_they_are_like(mat):
    path = mat(A_time=TIME, A_x=SPEED, B_time=TIME + 5, B_x=SPEED + 1)
    assert read(path, ["A_x"]).time[0] == 0
    assert read(path, ["B_x"]).time[0] == 5


def test_simulinks_structure_with_time_is_read(mat):
    signals = [
        {"values": SPEED[:, None], "dimensions": 1.0, "label": "Speed", "blockName": "m/Scope"},
        {"values": np.arange(6.0).reshape(3, 2), "dimensions": 2.0, "label": "", "blockName": "m/Scope"},
    ]
    data = read(mat(ScopeData={"time": TIME[:, None], "signals": signals, "blockName": "m/Scope"}))
    assert values_by_channel(data) == {"Speed": SPEED.tolist(), "signals(2)[0]": [0, 2, 4], "signals(2)[1]": [1, 3, 5]}


def test_a_structure_of_a_single_signal_is_called_after_its_variable(mat):
    one = {"values": SPEED[:, None], "dimensions": 1.0, "label": ""}
    assert list(read(mat(Speed={"time": TIME[:, None], "signals": one}))) == ["Speed"]


def test_signals_of_several_dimensions_have_time_last(mat):
    signals = {"values": np.arange(12.0).reshape(2, 2, 3), "dimensions": np.array([2.0, 2.0]), "label": "M"}
    data = read(mat(out={"time": TIME, "signals": signals}))
    assert values_by_channel(data)["M[0][1]"] == [3, 4, 5]


def test_structs_like_a_timeseries_are_read(mat):
    first = {"Name": "Speed", "Time": TIME[:, None], "Data": SPEED[:, None], "DataInfo": {"Units": "rpm"}}
    second = {"Name": "", "Time": TIME * 1000, "Data": SPEED / 10, "Units": "Nm", "TimeInfo": {"Units": "milliseconds"}}
    data = read(mat(ts1=first, Torque=second))
    assert {c.name: c.unit for c in data.values()} == {"Speed": "rpm", "Torque": "Nm"}
    np.testing.assert_allclose(data.time, TIME)


def test_an_array_of_channel_structs_is_read(mat):
    channels = [{"name": "Speed", "unit": "rpm", "data": SPEED}, {"name": "Torque", "unit": "[Nm]", "data": SPEED / 10}]
    data = read(mat(time=TIME, channels=channels))
    assert {c.name: c.unit for c in data.values()} == {"Speed": "rpm", "Torque": "Nm"}


def test_a_capture_of_controldesk_is_read(mat):
    axes = [{"Name": "Time", "Data": TIME}, {"Name": "Slow", "Data": np.array([0.0, 0.2])}]
    curves = [
        {"Name": "Model Root/Speed", "Data": SPEED, "Unit": "rpm", "XIndex": 1.0},
        {"Name": "T", "Data": np.array([20.0, 24.0]), "Unit": "°C", "XIndex": 2.0},
    ]
    data = read(mat(rec1={"X": axes, "Y": curves}), raster=0.1)
    assert {c.name: (c.unit, c.values.tolist()) for c in data.values()} == {
        "Model Root/Speed": ("rpm", SPEED.tolist()),
        "T": ("°C", [20, 22, 24]),
    }


def test_the_matrix_of_a_to_file_block_has_its_time_first(mat):
    data = read(mat(ans=np.vstack([TIME, SPEED, SPEED / 10])))
    assert values_by_channel(data) == {"ans[1]": SPEED.tolist(), "ans[2]": (SPEED / 10).tolist()}
    assert data.time.tolist() == TIME.tolist()


def test_vectors_of_one_length_without_a_time_are_steady_points(mat):
    path = mat(Speed=SPEED, Torque=SPEED / 10, K=1.0)
    data = read(path)
    assert data.time is None
    assert list(data) == ["Speed", "Torque"]
    assert not holds_samples(path)


def test_other_arrays_are_skipped_and_reported(mat):
    path = mat(time=TIME, Speed=SPEED, MapX=np.arange(12.0).reshape(3, 4)[:2], nothing=np.zeros((0, 0)), c=("a", "b"))
    assert list(read(path)) == ["Speed"]
    assert describe(path).tables[0].details == {"left out": "MapX (2 x 4)"}
    assert findings(path, ["MapX"]) == [
        "bench.mat: MapX is of size 2 x 4, but no time vector has that length. "
        "Save it with a vector `time` of its length."
    ]


def test_vectors_of_different_lengths_without_a_time_are_a_finding(mat):
    message = findings(mat(Speed=SPEED, Torque=np.arange(5.0)))[0]
    assert "found neither a time vector nor vectors of equal length: Speed (1 x 3), Torque (1 x 5)" in message


def test_a_file_of_scalars_and_texts_is_a_finding(mat):
    assert findings(mat(K=1.0, note="x")) == ["bench.mat: holds no vectors. Is it the right file?"]


def test_a_name_that_two_groups_have_is_asked_for_by_its_path(mat):
    path = mat(a={"time": TIME, "n": SPEED}, b={"time": TIME, "n": SPEED + 1})
    assert values_by_channel(read(path)) == {"a.n": SPEED.tolist(), "b.n": (SPEED + 1).tolist()}
    assert findings(path, ["n"]) == ["bench.mat: 2 channels are named n. Name one of them: a.n, b.n."]
    assert "has no channel a.m. Did you mean a.n?" in findings(path, ["a.m"])[0]


def test_infinite_numbers_are_missing(mat):
    values = read(mat(time=TIME, x=np.array([1.0, np.inf, np.nan])))["x"].values
    np.testing.assert_array_equal(values, [1, np.nan, np.nan])


def test_time_that_goes_back_is_a_finding(mat):
    assert "bench.mat sample 3, column time: time goes backwards" in findings(mat(time=TIME[[0, 2, 1]], x=SPEED))[0]


def test_complex_numbers_are_reported_and_not_cut(mat5, tmp_path):
    path = tmp_path / "bench.mat"
    scipy.io.savemat(
        path, {"time": TIME, "z": SPEED + 1j, "s": {"w": SPEED * 1j, "x": SPEED}, "c": scipy_form((SPEED * 1j,))}
    )
    assert list(read(path)) == ["x"]
    assert findings(path, ["z"])[0].startswith("bench.mat: z (complex numbers) can only be read by MATLAB.")


def test_tables_and_objects_are_reported_by_name(mat5):
    vector = element(9, np.arange(3.0).tobytes())
    path = mat5(file5(opaque5(b"log", b"table"), array5(6, vector, b"time", (1, 3)), array5(6, vector, b"x", (1, 3))))
    assert list(read(path)) == ["x"]
    assert describe(path).tables[0].details == {"only for MATLAB": "log (table)"}
    assert "log (table) can only be read by MATLAB. In MATLAB, save its values as plain" in findings(path, ["log"])[0]
    path = mat5(file5(opaque5(b"log", b"timetable")))
    assert "only MATLAB can read its variables: log (timetable)" in findings(path)[0]


@few_or_many(
    st.integers(2, 6).flatmap(
        lambda n: st.dictionaries(
            st.from_regex(r"[A-Za-z][A-Za-z0-9_]{0,20}", fullmatch=True).filter(
                lambda name: "time" not in name.lower() and "zeit" not in name.lower() and name.lower()[:1] != "t"
            ),
            st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=n, max_size=n),
            min_size=1,
            max_size=5,
        )
    ),
    few=8,
    many=40,
)
def test_any_vectors_come_back_as_they_were(mat, channels):
    count = len(next(iter(channels.values())))
    path = mat(time=np.arange(float(count)), **{name: np.array(values) for name, values in channels.items()})
    assert values_by_channel(read(path)) == channels


@pytest.mark.parametrize(
    ("numbers", "message"),
    [
        (1_767_225_600_000 + 100.0 * np.arange(4), "milliseconds since 1970"),
        (739_000 + np.arange(4) / 864_000, "datenum"),
    ],
)
def test_a_time_that_counts_from_a_distant_date_is_read_in_its_unit(mat, numbers, message):
    data = read(mat(time=numbers, a=np.arange(4.0)))
    np.testing.assert_allclose(np.diff(data.time), 0.1, atol=3e-5)
    assert message in data.findings[0].message


def test_real_files_of_simulink_users_are_read(real):
    assert list(read(real("simulink/TargetData_StepStart.mat"))) == ["Pressure", "Flow"]
    assert read(real("simulink/BreathData.mat")).samples == 1002


def test_version_7_3_is_read_in_the_process_of_its_library(tmp_path, monkeypatch):
    save73(tmp_path / "bench.mat", {"time": TIME, "Speed": SPEED})
    monkeypatch.setattr(mat_v73, "load", None)  # of this process
    assert read(tmp_path / "bench.mat")["Speed"].values.tolist() == SPEED.tolist()
    assert describe(tmp_path / "bench.mat")
    assert holds_samples(tmp_path / "bench.mat")
