"""netCDF 3: dimensions as rasters, units, packed numbers, damage."""

import numpy as np
import pytest
import scipy

from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies, refusals


@pytest.fixture
def netcdf(tmp_path):
    """Writes variables (name, dimension, values, attributes) as a netCDF 3 file."""

    def write(*variables, version=1):
        path = tmp_path / "bench.nc"
        with scipy.io.netcdf_file(path, "w", version=version) as file:
            for name, dimension, values, attributes in variables:
                if dimension not in file.dimensions:
                    file.createDimension(dimension, len(values))
                variable = file.createVariable(name, values.dtype, (dimension,))
                variable[:] = values
                for key, value in attributes.items():
                    setattr(variable, key, value)
        return path

    return write


@pytest.mark.parametrize("version", [1, 2])
def test_variables_of_a_dimension_are_channels(netcdf, version):
    path = netcdf(
        ("time", "time", np.array([0.0, 0.5, 1.0]), {"units": "seconds since 2026-11-27"}),
        (
            "Speed",
            "time",
            np.array([1, -1, 3], dtype=np.int16),
            {"units": "rpm", "scale_factor": 100.0, "missing_value": -1},
        ),
        version=version,
    )
    data = read(path)
    assert data.time.tolist() == [0.0, 0.5, 1.0]
    np.testing.assert_array_equal(data["Speed"].values, [100.0, np.nan, 300.0])
    assert data["Speed"].unit == "rpm"
    assert describe(path).kind == "netCDF"


def test_dimensions_are_rasters(netcdf):
    path = netcdf(
        ("time", "time", np.arange(3.0), {}),
        ("Speed", "time", np.arange(3.0), {}),
        ("points", "station", np.arange(5.0), {}),
    )
    assert {table.name for table in describe(path).tables} == {"time", "station"}
    assert read(path, ["Speed"]).samples == 3


def test_a_coordinate_of_any_name_is_the_time(netcdf):
    path = netcdf(
        ("obs", "obs", np.array([0.0, 1.0, 2.0]), {"units": "hours since 2026-11-27 10:00"}),
        ("Speed", "obs", np.arange(3.0), {"units": "rpm"}),
    )
    assert read(path).time.tolist() == [0.0, 3600.0, 7200.0]


def test_matrices_are_skipped_and_reported(tmp_path):
    with scipy.io.netcdf_file(tmp_path / "bench.nc", "w") as file:
        for name, length in (("time", 3), ("x", 2), ("one", 1)):
            file.createDimension(name, length)
        for name, dimensions in (("Speed", ("time", "one")), ("map", ("time", "x"))):
            file.createVariable(name, "d", dimensions)[:] = 1.0
    data = read(tmp_path / "bench.nc")
    assert list(data) == ["Speed"]
    assert "channel map: is a matrix of 3 x 2 and is skipped" in str(data.findings[0])


@few_or_many_copies
def test_damaged_files_are_read_or_refused(netcdf, count):
    path = netcdf(
        ("time", "time", np.arange(20.0), {"units": "s"}), ("Speed", "time", np.arange(20.0), {"units": "rpm"})
    )
    assert refusals(path, head=4, count=count) > count / 6
