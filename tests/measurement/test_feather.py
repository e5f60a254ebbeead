"""Feather and Arrow streams: units, kinds of numbers, selection, damage."""

from functools import cache

import numpy as np
import pyarrow as pa
import pytest
from pyarrow import feather, ipc

from kennfeld.base.errors import InputError
from kennfeld.measurement import describe, read
from tests.measurement.mutants import few_or_many_copies, refusals


@cache
def table():
    return pa.table(
        [
            np.arange(4) / 10,
            np.array([900, 1000, 1100, 1200], dtype=np.int16),
            ["a", "b", "c", "d"],
            [True, False, None, True],
        ],
        schema=pa.schema(
            [
                pa.field("time", pa.float64()),
                pa.field("Speed", pa.int16(), metadata={"unit": "rpm"}),
                pa.field("note", pa.string()),
                pa.field("on [-]", pa.bool_()),
            ]
        ),
    )


@pytest.fixture(params=["plain", "zstd", "stream"])
def path(request, tmp_path):
    if request.param == "stream":
        with ipc.new_stream(tmp_path / "bench.arrows", table().schema) as writer:
            writer.write_table(table(), max_chunksize=2)
        return tmp_path / "bench.arrows"
    feather.write_feather(
        table(), tmp_path / "bench.feather", compression=request.param.replace("plain", "uncompressed")
    )
    return tmp_path / "bench.feather"


def test_numbers_with_their_units_and_the_time_are_read(path):
    data = read(path)
    assert {name: channel.unit for name, channel in data.items()} == {"Speed": "rpm", "on": "-"}
    assert data.time.tolist() == [0.0, 0.1, 0.2, 0.3]
    np.testing.assert_array_equal(data["on"].values, [1.0, 0.0, np.nan, 1.0])
    assert describe(path).kind == "Feather"


def test_only_requested_channels_are_read(path):
    assert list(read(path, ["Speed"])) == ["Speed"]
    with pytest.raises(InputError, match="the column holds text"):
        read(path, ["note"])
    with pytest.raises(InputError, match=r"Did you mean Speed\?"):
        read(path, ["Sped"])


def test_a_file_without_rows_is_a_finding(tmp_path):
    feather.write_feather(table().slice(0, 0), tmp_path / "empty.feather", compression="uncompressed")
    with pytest.raises(InputError, match="holds no rows"):
        read(tmp_path / "empty.feather")


@few_or_many_copies
def test_damaged_files_are_read_or_refused(path, count):
    assert refusals(path, head=8, count=count) > count / 6
