"""Infinite values are missing ones, with a warning, in every format and in Python."""

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
import scipy

from kennfeld.base.errors import InputError
from kennfeld.domain.dataset import Dataset
from kennfeld.measurement import describe, read
from kennfeld.measurement.cache import from_parquet, to_parquet
from tests.measurement.mlg_files import mlg, number, record
from tests.measurement.xls_files import xls

TIME = [0.0, 1.0, 2.0, 3.0]
SPEED = [1.0, np.inf, -np.inf, 4.0]


def text(path):
    path.write_text("time,v\n0,1\n1,inf\n2,-Infinity\n3,4\n")


def overflowing_text(path):
    path.write_text("time;v\n0;1\n1;1e999\n2;-1e999\n3;4\n")


def parquet(path):
    pq.write_table(pa.table({"time": TIME, "v": SPEED}), path)


def matlab(path):
    with path.open("wb") as stream:
        scipy.io.savemat(stream, {"time": np.array(TIME), "v": np.array(SPEED)})


def log(path):
    fields = [number("Time", unit="s"), number("v")]
    path.write_bytes(mlg(fields, [record(fields, row) for row in zip(TIME, SPEED, strict=True)]))


def mdf(path):
    asammdf = pytest.importorskip("asammdf")
    with asammdf.MDF(version="4.10") as file:
        file.append([asammdf.Signal(np.array(SPEED), np.array(TIME), name="v", unit="rpm")])
        file.save(path.with_suffix(".mf4"))
    path.with_suffix(".mf4").replace(path)


def excel(path):
    path.write_bytes(xls({"Data": [["time", "v"], [0, 1], [1, "inf"], [2, "-inf"], [3, 4]]}))


@pytest.mark.filterwarnings("ignore")
@pytest.mark.parametrize("write", [text, overflowing_text, parquet, matlab, log, mdf, excel])
def test_every_reader_takes_infinite_values_as_missing_and_counts_them(tmp_path, write):
    path = tmp_path / "bench.x"
    write(path)
    data = read(path)
    np.testing.assert_array_equal(data["v"].values, [1, np.nan, np.nan, 4])
    (remark,) = data.findings
    assert remark.severity == "warning"
    assert remark.message == "2 of 4 values are infinite and treated as missing"
    assert str(remark.location).startswith("bench.x")
    (table,) = describe(path).tables
    assert table.findings == data.findings
    channel = next(c for c in table.channels if c.name == "v")
    assert (channel.nan_share, channel.minimum, channel.maximum) == (0.5, 1, 4)


def test_warnings_concern_requested_channels_only(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("time,v,w\n0,1,2\n1,inf,3\n2,4,5\n")
    assert read(path, ["w"]).findings == ()
    assert [str(remark) for remark in read(path, ["v"]).findings] == [
        "bench.csv line 3, column v: 1 of 3 values is infinite and treated as missing"
    ]


def test_an_infinite_time_stamp_is_a_missing_one(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("time,v\n0,1\ninf,2\n2,4\n")
    with pytest.raises(InputError, match="line 3, column time: the time stamp is missing"):
        read(path)


def test_nothing_is_interpolated_towards_an_infinite_value(tmp_path):
    path = tmp_path / "bench.csv"
    path.write_text("time,v\n" + "".join(f"{k / 10:.1f},{'inf' if k == 5 else k}\n" for k in range(11)))
    values = read(path, raster=0.05)["v"].values
    assert np.nanmax(np.abs(values)) == 10


def test_arrays_in_python_follow_the_same_convention():
    data = Dataset.of("bench", {"v": SPEED, "w": TIME})
    np.testing.assert_array_equal(data["v"].values, [1, np.nan, np.nan, 4])
    assert [str(remark) for remark in data.findings] == [
        "dataset bench, channel v: 2 of 4 values are infinite and treated as missing"
    ]


def test_the_cache_keeps_the_warnings(tmp_path):
    path = tmp_path / "bench.csv"
    text(path)
    data = read(path)
    assert from_parquet(to_parquet(data), "bench").findings == data.findings
