"""HDF5 and netCDF 4: rasters, times, units, tables, frames of pandas, packed numbers, damage."""

import h5py
import numpy as np
import pandas as pd
import pytest
from mutants import refusals

from kennfeld.errors import InputError
from kennfeld.measurement import describe, read


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


def frame_of_pandas(path, frame, kind):
    """Write a frame as the fixed format of pandas does, which itself needs PyTables."""
    with h5py.File(path, "w") as file:
        group = file.create_group("data")
        group.attrs["pandas_type"] = np.bytes_("frame")
        group.attrs["nblocks"] = 1
        group["axis0"] = [name.encode() for name in frame.columns]
        group["axis1"] = frame.index.to_numpy().astype(kind).astype("int64")
        group["axis1"].attrs["kind"] = np.bytes_(kind)
        group["block0_items"] = [name.encode() for name in frame.columns]
        group["block0_values"] = frame.to_numpy()


@pytest.mark.parametrize("kind", ["datetime64[ns]", "datetime64[us]"])
def test_frames_of_pandas_are_read(tmp_path, kind):
    index = pd.to_datetime(["2026-11-27 10:00:00.0", "2026-11-27 10:00:00.5"])
    frame_of_pandas(tmp_path / "frame.h5", pd.DataFrame({"Speed": [1.0, 2.0], "Torque": [3.0, 4.0]}, index=index), kind)
    data = read(tmp_path / "frame.h5")
    assert data.time.tolist() == [0.0, 0.5]
    assert data["Torque"].values.tolist() == [3.0, 4.0]


def test_what_is_no_vector_is_named(hdf5):
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


def test_damaged_files_are_read_or_refused(hdf5):
    path = hdf5({"a/time": np.arange(30) * 0.1, "a/x": (np.arange(30.0), {"units": "rpm"}), "b/y": np.arange(9)})
    assert refusals(path, head=8, raster=0.1) > 100
