"""Parquet: units from the field, kinds of numbers, the index of pandas, damage."""

import contextlib
import datetime
import random

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from kennfeld.base.errors import InputError
from kennfeld.measurement import read


@pytest.fixture
def parquet(tmp_path):
    def write(table):
        pq.write_table(table, tmp_path / "bench.parquet")
        return tmp_path / "bench.parquet"

    return write


def test_numbers_of_all_kinds_and_units_are_read(parquet):
    schema = pa.schema(
        [
            pa.field("time", pa.float64()),
            pa.field("Speed", pa.int16(), metadata={"unit": "rpm"}),
            pa.field("Torque [Nm]", pa.float32()),
            pa.field("on", pa.bool_()),
            pa.field("note", pa.string()),
        ]
    )
    rows = [[0.0, 1.0], [1000, None], [80.5, 90.5], [True, False], ["a", "b"]]
    data = read(parquet(pa.table(rows, schema=schema)))
    assert list(data) == ["Speed", "Torque", "on"]
    assert [c.unit for c in data.values()] == ["rpm", "Nm", ""]
    np.testing.assert_array_equal(data["Speed"].values, [1000, np.nan])
    assert data["on"].values.tolist() == [1, 0]
    assert data.time.tolist() == [0, 1]


def test_dates_are_seconds_since_the_first(parquet):
    start = datetime.datetime(2024, 1, 1)
    stamps = [start + datetime.timedelta(milliseconds=10 * k) for k in range(3)]
    data = read(parquet(pa.table({"timestamp": pa.array(stamps, pa.timestamp("ns")), "a": [1.0, 2.0, 3.0]})))
    assert data.time.tolist() == [0, 0.01, 0.02]


def test_the_index_of_pandas_is_not_a_channel(parquet):
    assert list(read(parquet(pa.table({"a": [1.5, 2.5], "__index_level_0__": [7, 9]})))) == ["a"]


def test_requested_text_and_missing_channels_are_findings(parquet):
    path = parquet(pa.table({"Speed": [1.0], "note": ["x"]}))
    with pytest.raises(InputError) as caught:
        read(path, ["note", "Sped"])
    assert "the column holds text" in str(caught.value)
    assert "Did you mean Speed?" in str(caught.value)


def test_infinite_values_are_missing_and_placed_by_row(parquet):
    data = read(parquet(pa.table({"a": [1.0, np.inf]})))
    np.testing.assert_array_equal(data["a"].values, [1, np.nan])
    assert str(data.findings[0]) == "bench.parquet row 2, column a: 1 of 2 values is infinite and treated as missing"


def test_a_file_without_rows_is_a_finding(parquet):
    with pytest.raises(InputError, match="holds no rows"):
        read(parquet(pa.table({"a": pa.array([], pa.float64())})))


@pytest.mark.parametrize("count", [40, pytest.param(200, marks=pytest.mark.slow)])
def test_a_damaged_file_gives_findings_and_nothing_else(parquet, count):
    path = parquet(pa.table({"time": np.arange(100.0), "a": np.arange(100.0) ** 2}))
    content, generator = path.read_bytes(), random.Random(11)
    for _ in range(count):
        mutant = bytearray(content)
        for _ in range(generator.randint(1, 4)):
            mutant[generator.randrange(4, len(mutant))] = generator.randrange(256)
        path.write_bytes(mutant[: generator.randrange(len(mutant))] if generator.random() < 0.3 else mutant)
        with contextlib.suppress(InputError):
            read(path)


@pytest.mark.parametrize("at_once", [1, 7, 1000])
def test_columns_that_are_read_in_blocks_keep_their_values(parquet, monkeypatch, at_once):
    monkeypatch.setattr("kennfeld.measurement.parquet._AT_ONCE", at_once)
    names = [f"c.{k}" for k in range(20)]
    columns = {name: ["text"] * 2 if k == 3 else [k, k + 0.5] for k, name in enumerate(names)}
    data = read(parquet(pa.table(columns)))
    assert [channel.name for channel in data.channels] == [name for name in names if name != "c.3"]
    assert all(data[f"c.{k}"].values.tolist() == [k, k + 0.5] for k in range(20) if k != 3)


def test_the_columns_are_described_once_per_file(parquet, monkeypatch):
    path = parquet(pa.table({f"c{k}": [0.0, 1.0] for k in range(50)}))
    schemas, schema = [], pq.ParquetFile.schema_arrow.fget
    monkeypatch.setattr(pq.ParquetFile, "schema_arrow", property(lambda file: schemas.append(1) or schema(file)))
    assert len(read(path).channels) == 50
    assert len(schemas) < 5
