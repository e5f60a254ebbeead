"""HDF5 and netCDF 4: rasters, times, units, tables, frames of pandas, packed numbers, damage."""

import pickle

import h5py
import numpy as np
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies, refusals


@pytest.fixture
def hdf5(tmp_path):
    """Writes datasets, path -> values or (values, attributes), as an HDF5 file."""

    def write(datasets):
        path = tmp_path / "bench.h5"
        with h5py.File(path, "w") as file:
            for name, content in datasets.items():
                values, attributes = content if isinstance(content, tuple) else (content, {})
                file[name] = values
                file[name].attrs.update(attributes)
        return path

    return write


def test_vectors_of_the_root_are_channels(hdf5):
    path = hdf5(
        {
            "time": (np.array([0.0, 10.0, 20.0]), {"units": "ms"}),
            "Speed": (np.array([900, 950, 1000], dtype=np.int16), {"unit": "rpm", "long_name": "crankshaft speed"}),
            "on": np.array([True, False, True]),
            "note": np.array([b"a", b"b", b"c"]),
        }
    )
    data = read(path)
    assert list(data) == ["Speed", "on"]
    assert data.time.tolist() == [0.0, 0.01, 0.02]
    assert (data["Speed"].unit, data["Speed"].description) == ("rpm", "crankshaft speed")
    assert describe(path).tables[0].left_out == ("note",)


def test_groups_and_lengths_are_rasters(hdf5):
    path = hdf5(
        {
            "fast/time": np.arange(21) * 0.1,
            "fast/Speed": np.arange(21.0),
            "slow/t [s]": np.arange(5) * 0.5,
            "slow/Temperature": np.arange(5.0),
        }
    )
    assert [table.name for table in describe(path).tables] == ["fast", "slow"]
    data = read(path, raster=0.5)
    assert data["Temperature"].values.tolist() == [0.0, 1.0, 2.0, 3.0, 4.0]
    np.testing.assert_allclose(data["Speed"].values, [0.0, 5.0, 10.0, 15.0, 20.0])


def test_a_time_above_serves_the_groups_below(hdf5):
    path = hdf5({"time": np.arange(3) * 0.5, "left/Speed": np.arange(3.0), "right/Speed": np.arange(3.0) + 5})
    data = read(path, ["right/Speed"])
    assert data.time.tolist() == [0.0, 0.5, 1.0]
    assert data["right/Speed"].values.tolist() == [5.0, 6.0, 7.0]
    with pytest.raises(InputError, match="2 channels are named Speed"):
        read(path, ["Speed"])


def test_tables_and_named_columns_are_channels(hdf5):
    table = np.array([(0.0, 900), (0.1, 950)], dtype=[("time", float), ("Speed", np.int32)])
    path = hdf5({"log": table, "matrix": (np.array([[1.0, 2.0], [3.0, 4.0]]), {"column_names": ["a", "b"]})})
    assert read(path, ["Speed"])["Speed"].values.tolist() == [900.0, 950.0]
    assert read(path, ["b"])["b"].values.tolist() == [2.0, 4.0]


def test_packed_numbers_of_netcdf_are_unpacked(hdf5):
    attributes = {"_FillValue": np.int16(-1), "scale_factor": 0.5, "add_offset": 10.0, "units": "degC"}
    path = hdf5(
        {
            "time": (np.array([0, 1, 2]), {"units": "seconds since 2026-11-27 10:00:00"}),
            "Temperature": (np.array([2, -1, 4], dtype=np.int16), attributes),
        }
    )
    data = read(path)
    np.testing.assert_array_equal(data["Temperature"].values, [11.0, np.nan, 12.0])
    assert data.time.tolist() == [0.0, 1.0, 2.0]


STAMPS = ["2026-11-27T10:00:00.0", "2026-11-27T10:00:00.5", "2026-11-27T10:00:01.0"]


def ticks(kind):
    return np.array(STAMPS, dtype=kind).astype("int64")


def fixed_frame(file, kind, key="data"):
    """Write a DataFrame as the fixed format of pandas does, which itself needs PyTables."""
    group = file.create_group(key)
    group.attrs.update({"pandas_type": np.bytes_("frame"), "nblocks": 3, "axis1_variety": np.bytes_("regular")})
    group["axis0"] = np.array([b"Speed", b"Torque", b"n", b"note"])
    group["axis1"] = ticks(kind) if kind else np.arange(3)
    group["axis1"].attrs.update({"kind": np.bytes_(kind or "integer"), "name": np.bytes_("N.")})
    blocks = [
        ([b"Speed", b"Torque"], np.array([[900.0, 1.0], [950.0, 2.0], [1000.0, 3.0]])),
        ([b"n"], np.array([[1], [2], [3]])),
        ([b"note"], np.array([b"pickled objects"])),
    ]
    for number, (names, values) in enumerate(blocks):
        group[f"block{number}_items"], group[f"block{number}_values"] = np.array(names), values
    return group


def stored_table(file, columns, key="data", pickled=None):
    """Write a DataFrame as the table format of pandas does."""
    group = file.create_group(key)
    group.attrs["pandas_type"] = np.bytes_("frame_table")
    table = np.zeros(3, [("index", "<i8"), ("values_block_0", "<f8", (len(columns),)), ("n", "<i4")])
    table["index"], table["n"] = ticks("datetime64[us]"), [1, 2, 3]
    table["values_block_0"] = np.arange(3 * len(columns)).reshape(3, -1)
    group["table"] = table
    names = pickle.dumps(columns, protocol=0) if pickled is None else pickled
    attributes = {"index_kind": np.bytes_("datetime64[us]"), "values_block_0_kind": np.bytes_(names)}
    group["table"].attrs.update(attributes)
    group["_i_table/index/sortedLR"] = np.zeros(131201)


@pytest.mark.parametrize("kind", ["datetime64[ns]", "datetime64[us]", "datetime64[ms]", "datetime64"])
def test_frames_of_the_fixed_format_are_read(tmp_path, kind):
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        index = fixed_frame(file, "datetime64[ns]" if kind == "datetime64" else kind)["axis1"]
        index.attrs["kind"] = np.bytes_(kind)
    data = read(tmp_path / "frame.h5")
    assert list(data) == ["Speed", "Torque", "n"]
    assert data.time.tolist() == [0.0, 0.5, 1.0]
    assert describe(tmp_path / "frame.h5").tables[0].left_out == ("note",)


def test_a_counting_index_is_not_a_channel(tmp_path):
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        fixed_frame(file, "")
    data = read(tmp_path / "frame.h5")
    assert (list(data), data.time) == (["Speed", "Torque", "n"], None)


def test_tables_of_pandas_are_read_without_their_indices(tmp_path):
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        stored_table(file, ["Speed", "Torque"])
    data = read(tmp_path / "frame.h5")
    assert data.time.tolist() == [0.0, 0.5, 1.0]
    assert {name: data[name].values.tolist() for name in data} == {
        "Speed": [0.0, 2.0, 4.0],
        "Torque": [1.0, 3.0, 5.0],
        "n": [1.0, 2.0, 3.0],
    }


@pytest.mark.parametrize("pickled", [b"cos\nsystem\n(Vtouch stolen\ntR.", b"garbage", b"", b"(lp0\nI1\naI2\na."])
def test_names_of_columns_are_never_unpickled(tmp_path, monkeypatch, pickled):
    monkeypatch.chdir(tmp_path)
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        stored_table(file, ["a", "b"], pickled=pickled)
    assert list(read(tmp_path / "frame.h5")) == ["values_block_0[0]", "values_block_0[1]", "n"]
    assert [path.name for path in tmp_path.iterdir()] == ["frame.h5"]


def test_frames_that_start_later_keep_their_dates(tmp_path):
    with h5py.File(tmp_path / "frames.h5", "w") as file:
        fixed_frame(file, "datetime64[ns]", "early")
        later = fixed_frame(file, "datetime64[us]", "late")
        later["axis1"][...] += 500_000
    data = read(tmp_path / "frames.h5", ["early/Speed", "late/n"], raster=0.5)
    assert data.time.tolist() == [0.5, 1.0]
    assert (data["early/Speed"].values.tolist(), data["late/n"].values.tolist()) == ([950.0, 1000.0], [1.0, 2.0])


def test_a_series_is_read(tmp_path):
    with h5py.File(tmp_path / "series.h5", "w") as file:
        group = file.create_group("s")
        group.attrs.update({"pandas_type": np.bytes_("series"), "name": np.bytes_("Speed")})
        group["index"], group["values"] = ticks("datetime64[us]"), np.array([1.0, 2.0, 3.0])
        group["index"].attrs["kind"] = np.bytes_("datetime64[us]")
    data = read(tmp_path / "series.h5")
    assert (data.time.tolist(), data["Speed"].values.tolist()) == ([0.0, 0.5, 1.0], [1.0, 2.0, 3.0])


@pytest.mark.parametrize(
    "attributes",
    [
        {"units": "seconds since 2026-11-27"},
        {"standard_name": "time"},
        {"axis": "T", "units": "s"},
        {"units": "s", "long_name": "elapsed time"},
        {"units": "s"},
    ],
)
def test_attributes_may_name_the_time_vector(hdf5, attributes):
    path = hdf5({"Speed": (np.arange(3.0), {"units": "rpm"}), "x0": (np.arange(3) * 0.5, attributes)})
    assert read(path).time.tolist() == [0.0, 0.5, 1.0]
    assert list(read(path, ["Speed", "x0"])) == ["Speed", "x0"]


def test_a_unit_of_time_alone_is_not_enough_for_several_or_unordered_vectors(hdf5):
    two = {"Speed": np.arange(3.0)} | {name: (np.arange(3.0), {"units": "ms"}) for name in ("u", "v")}
    assert read(hdf5(two)).time is None
    unordered = {"Speed": np.arange(3.0), "u": (np.array([1.0, 3.0, 2.0]), {"units": "ms"})}
    assert read(hdf5(unordered)).time is None


def test_dimensions_of_netcdf_without_values_are_not_channels(hdf5):
    name = np.bytes_("This is a netCDF dimension but not a netCDF variable.         3")
    attributes = {"CLASS": np.bytes_("DIMENSION_SCALE"), "NAME": name}
    assert list(read(hdf5({"rows": (np.zeros(3), attributes), "Speed": np.arange(3.0)}))) == ["Speed"]


def test_time_may_be_in_days(hdf5):
    path = hdf5({"time": (np.array([0.0, 0.5]), {"units": "days since 2026-11-27"}), "Speed": np.arange(2.0)})
    assert read(path).time.tolist() == [0.0, 43200.0]


def test_named_columns_of_a_matrix_have_its_attributes(hdf5):
    stored = np.array([[1, 2], [-1, 4]], dtype=np.int16)
    attributes = {"column_names": ["a", "b"], "units": ["rpm", "Nm"], "scale_factor": 0.5, "_FillValue": np.int16(-1)}
    data = read(hdf5({"matrix": (stored, attributes)}))
    np.testing.assert_array_equal(data["a"].values, [0.5, np.nan])
    assert (data["b"].values.tolist(), data["b"].unit, data["a"].unit) == ([1.0, 2.0], "Nm", "rpm")


def test_vectors_with_a_second_dimension_of_one_are_read(hdf5):
    data = read(hdf5({"time": np.arange(3.0)[:, None], "Speed": np.arange(3.0)[None, :]}))
    assert (data.time.tolist(), data["Speed"].values.tolist()) == ([0.0, 1.0, 2.0], [0.0, 1.0, 2.0])


def test_matrices_are_skipped_with_a_warning_or_refused(hdf5):
    path = hdf5({"time": np.arange(3.0), "Speed": np.arange(3.0), "image": np.zeros((3, 4))})
    (finding,) = read(path).findings
    assert (finding.severity, "channel image: is a matrix of 3 x 4 and is skipped" in str(finding)) == ("warning", True)
    assert not read(path, ["Speed"]).findings
    with pytest.raises(InputError, match="name its columns in an attribute column_names"):
        read(path, ["image"])
    many = {"Speed": np.arange(3.0)} | {f"image{number:02}": np.zeros((3, 4)) for number in range(30)}
    assert "10 more channels cannot be read" in str(read(hdf5(many)).findings[-1])


@pytest.mark.parametrize(
    ("stored", "attributes", "expected"),
    [
        (np.array([-1, 1], dtype=np.int8), {"_Unsigned": "true"}, [255.0, 1.0]),
        (np.array([0.0, 5.0]), {"valid_range": np.array([1.0, 9.0])}, [np.nan, 5.0]),
        (np.array([0.0, 5.0]), {"valid_max": 1.0}, [0.0, np.nan]),
        (np.array([9.96921e36, 5.0], dtype=np.float32), {}, [np.nan, 5.0]),
    ],
)
def test_numbers_are_read_as_netcdf_means_them(hdf5, stored, attributes, expected):
    np.testing.assert_array_equal(read(hdf5({"x": (stored, attributes)}))["x"].values, expected)


def test_arrays_other_than_vectors_are_named(hdf5):
    with pytest.raises(InputError, match=r"holds no vectors: image \(4 x 5\)"):
        read(hdf5({"image": np.zeros((4, 5))}))
    with pytest.raises(InputError, match="holds no data"):
        read(hdf5({}))


def test_links_to_other_files_are_not_followed(tmp_path, hdf5):
    path = hdf5({"Speed": np.arange(3.0)})
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["stolen"] = h5py.ExternalLink(str(path), "/Speed")
    with pytest.raises(InputError, match="holds no data"):
        read(tmp_path / "link.h5")


def test_claims_of_more_numbers_than_a_file_holds_are_refused(tmp_path):
    with h5py.File(tmp_path / "huge.h5", "w") as file:
        file.create_dataset("Speed", shape=(10**12,), chunks=(1000,), dtype=float)
    with pytest.raises(InputError, match="far more numbers than its size allows"):
        read(tmp_path / "huge.h5")


@pytest.mark.parametrize("write", [lambda file: fixed_frame(file, "datetime64[ns]"), lambda f: stored_table(f, ["a"])])
@few_or_many_copies
def test_damaged_frames_are_read_or_refused(tmp_path, write, count):
    with h5py.File(tmp_path / "frame.h5", "w") as file:
        write(file)
    assert refusals(tmp_path / "frame.h5", head=8, count=count, raster=0.1) > count / 8


@few_or_many_copies
def test_damaged_files_are_read_or_refused(hdf5, count):
    path = hdf5({"a/time": np.arange(30) * 0.1, "a/x": (np.arange(30.0), {"units": "rpm"}), "b/y": np.arange(9)})
    assert refusals(path, head=8, count=count, raster=0.1) > count / 3
